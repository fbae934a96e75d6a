// What the generated substep and the solver share: constants of the model, and the state at hand.

struct Softness {
  float stiffness, damping;  // K and B
  float start, rise, per_width, midpoint, below, above;  // the impedance's curve
};
struct LimitData {
  int dof;
  float weight;  // approximate inverse inertia
  Softness soft;
};
struct GeomData {
  float radius, half_length;
  int carriers;  // bits of the dofs that move it
};
struct CandidateData {
  int first, second;  // geoms
  int sensor;         // of the contact's force; -1: none
  bool capsules;      // both: they may be parallel
  float end;          // 0: nearest points; otherwise which end of the second touches the plane
  float turn;         // -1 where the sensor names the geoms in the other order
  float friction, weight;
  Softness soft;
};

// What a control step says of each simulation beside its state.
struct Report {
  int flags[W] = {};   // OVERFLOWED and UNSETTLED, added up
  int effort[W] = {};  // what the solver had to do, roughly: see `EFFORT_OF_CONTACT`
};

// Without limits or pairs some arrays would have no element.
#define AT_LEAST_1(n) ((n) > 0 ? (n) : 1)

struct Stage {
  mask acts;  // lanes in which some limit is passed or some geoms touch
  real q[NV], qd[NV], lo[NV], hi[NV];
  real inertia[NM], force[NV];
  real motion[NV][6];  // each joint's axis and moment, about its tree's origin
  real geom[AT_LEAST_1(NGEOM)][6];
  real gap[AT_LEAST_1(NCANDIDATE)];
};
