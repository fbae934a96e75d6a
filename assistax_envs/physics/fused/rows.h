// Constraint rows of active joint limits and contacts: MuJoCo's soft constraints.
//
// A row with Jacobian J asks for the acceleration J a = aref = -B J v - K i(r) r; r < 0 is how
// far the constraint is violated and i(r), its impedance, says how hard it is; it may be missed, by
// R times the row's force (MuJoCo, Computation: Solver parameters). A contact has four rows, the
// edges of a pyramid about the friction cone: normal +- friction times each tangent.
//
// With M = L^T D L, each Jacobian is kept as z = D^-1/2 L^-T J^T, so that J1 M^-1 J2^T = z1 . z2.

struct Rows {
  int limits, contacts;  // slots in use
  real base[NLIMIT + 3 * MAX_CONTACTS][NV];  // z of limits, then of normal and tangents of contacts
  real frame[MAX_CONTACTS][2][3];  // normal and first tangent of contacts
  real free[MAX_ROWS];   // J a - aref where no constraint acts
  real slack[MAX_ROWS];  // R
  real guess[MAX_ROWS];  // acts at first, where below 0
};

// The joint-space inertia's factor, and the forces seen through it.
struct Factored {
  real entries[NM];  // L and 1 / D, see factor_inertia
  real root[NV];     // D^-1/2
  real force[NV];    // D^-1/2 L^-T f: a row's J M^-1 f is z . force
};

FN real impedance(real violation, const Softness* soft[W]) {
  Gathered start, rise, per_width, midpoint, below, above;
  LANES(l) {
    start.at[l] = soft[l]->start;
    rise.at[l] = soft[l]->rise;
    per_width.at[l] = soft[l]->per_width;
    midpoint.at[l] = soft[l]->midpoint;
    below.at[l] = soft[l]->below;
    above.at[l] = soft[l]->above;
  }
  real x = minimum(absolute(violation) * all(per_width), 1.0f), z = 1.0f - x;
  real y = select(x < all(midpoint), all(below) * x * x, 1.0f - all(above) * z * z);
  return all(start) + y * all(rise);
}

FN void factor(const Stage& now, Factored& f) {
  factor_inertia(now.inertia, f.entries);
  UNROLL for (int i = 0; i < NV; ++i) f.force[i] = now.force[i];
  solve_transposed(f.entries, f.force);
  inverse_diagonal(f.entries, f.root);
  UNROLL for (int i = 0; i < NV; ++i) {
    f.root[i] = square_root(f.root[i]);
    f.force[i] = f.force[i] * f.root[i];
  }
}

// Turn a Jacobian into z, in place, and return z . force.
FN real through_inertia(const Factored& f, real* jacobian) {
  solve_transposed(f.entries, jacobian);
  real d = splat(0.0f);
  UNROLL for (int i = 0; i < NV; ++i) {
    jacobian[i] = jacobian[i] * f.root[i];
    d = d + jacobian[i] * f.force[i];
  }
  return d;
}

// Return for each lane the limits that are passed, as bits, and the most that any lane has.
FN integer passed_limits(const Stage& now, int& most) {
  integer passed = splat(0), count = splat(0);
  UNROLL for (int k = 0; k < NLIMIT; ++k) {
    int i = LIMIT[k].dof;
    real inside = minimum(now.q[i] - now.lo[i], now.hi[i] - now.q[i]);
    passed |= where(inside < 0.0f, (int)(1u << k));
    count += where(inside < 0.0f, 1);
  }
  most = 0;
  LANES(l) most = lane(count, l) > most ? lane(count, l) : most;
  return passed;
}

FN void add_limits(const Stage& now, const Factored& f, Rows& rows) {
  integer passed = passed_limits(now, rows.limits);
  unsigned left[W];
  LANES(l) left[l] = lane(passed, l);
  KEEP_LOOP for (int k = 0; k < rows.limits; ++k) {
    Gathered sign, violation, rate, stiffness, damping, weight, none;
    const Softness* soft[W];
    real jacobian[NV];
    UNROLL for (int i = 0; i < NV; ++i) jacobian[i] = splat(0.0f);
    LANES(l) {
      bool has = left[l] != 0;
      const LimitData& limit = LIMIT[has ? first_bit(left[l]) : 0];
      left[l] &= left[l] - 1;
      float x = lane(now.q[limit.dof], l), lo = lane(now.lo[limit.dof], l);
      bool low = x < lo;
      sign.at[l] = !has ? 0.0f : low ? 1.0f : -1.0f;
      violation.at[l] = !has ? -0.01f : low ? x - lo : lane(now.hi[limit.dof], l) - x;
      rate.at[l] = sign.at[l] * lane(now.qd[limit.dof], l);
      stiffness.at[l] = limit.soft.stiffness;
      damping.at[l] = limit.soft.damping;
      weight.at[l] = limit.weight;
      none.at[l] = has ? 0.0f : 1.0f;
      soft[l] = &limit.soft;
#if W == 1
      UNROLL for (int i = 0; i < NV; ++i) jacobian[i] = i == limit.dof ? sign.at[0] : 0.0f;
#else
      lane(jacobian[limit.dof], l) = sign.at[l];
#endif
    }
    real imp = impedance(all(violation), soft), free = through_inertia(f, jacobian);
    free = free + all(damping) * all(rate) + all(stiffness) * imp * all(violation);
    UNROLL for (int i = 0; i < NV; ++i) rows.base[k][i] = jacobian[i];
    rows.free[k] = select(all(none) > 0.5f, splat(1.0f), free);
    rows.slack[k] = (1.0f - imp) / imp * all(weight);
    rows.guess[k] = rows.free[k];
  }
}

// Write the Jacobians of normal and tangents of the contact in slot k; return the velocities there.
FN void contact_jacobian(const Stage& now, const ContactList& list, int k, const Contact& contact,
                         real friction, real jacobian[3][NV], real velocity[3]) {
  GatheredBits first, second;
  LANES(l) {
    int c = list.candidate[k][l];
    first.at[l] = c < 0 ? 0 : GEOM[CANDIDATE[c].first].carriers;
    second.at[l] = c < 0 ? 0 : GEOM[CANDIDATE[c].second].carriers;
  }
  integer moves_first = all(first), moves_second = all(second);
  UNROLL for (int d = 0; d < 3; ++d) velocity[d] = splat(0.0f);
  UNROLL for (int i = 0; i < NV; ++i) {
    const real* m = now.motion[i];
    real x = contact.point[0] + TREE_SHIFT[TREE_OF[i]][0];
    real y = contact.point[1] + TREE_SHIFT[TREE_OF[i]][1];
    real z = contact.point[2] + TREE_SHIFT[TREE_OF[i]][2];
    real sign = to_real(((moves_second >> i) & 1) - ((moves_first >> i) & 1));
    real moved[3] = {sign * (m[1] * z - m[2] * y + m[3]), sign * (m[2] * x - m[0] * z + m[4]),
                     sign * (m[0] * y - m[1] * x + m[5])};
    jacobian[0][i] = dot3(contact.frame[0], moved);
    jacobian[1][i] = friction * dot3(contact.frame[1], moved);
    jacobian[2][i] = friction * dot3(contact.frame[2], moved);
    UNROLL for (int d = 0; d < 3; ++d) velocity[d] = velocity[d] + jacobian[d][i] * now.qd[i];
  }
}

// Guess that those edges of the contact in slot k act that did in the substep before, if any did.
FN void guess_edges(const ContactList& list, int k, const unsigned* warm, Rows& rows) {
  Gathered sign[4];
  LANES(l) {
    int c = list.candidate[k][l];
    unsigned acted = c < 0 ? 0u : warm[c / 8 * W + l] >> (4 * (c % 8)) & 15u;
    for (int e = 0; e < 4; ++e) sign[e].at[l] = !acted ? 0.0f : acted >> e & 1u ? -1.0f : 1.0f;
  }
  int r = rows.limits + 4 * k;
  UNROLL for (int e = 0; e < 4; ++e) {
    real s = all(sign[e]);
    rows.guess[r + e] = select(absolute(s) > 0.5f, s, rows.free[r + e]);
  }
}

FN void add_contacts(const Stage& now, const Factored& f, const ContactList& list,
                     const unsigned* warm, Rows& rows) {
  rows.contacts = list.slots;
  KEEP_LOOP for (int k = 0; k < list.slots; ++k) {
    Contact contact;
    place_contact(now, list, k, contact);
    UNROLL for (int j = 0; j < 3; ++j) {
      rows.frame[k][0][j] = contact.frame[0][j];
      rows.frame[k][1][j] = contact.frame[1][j];
    }
    Gathered frictions, stiffness, damping, weight, none;
    const Softness* soft[W];
    LANES(l) {
      int c = list.candidate[k][l];
      const CandidateData& data = CANDIDATE[c < 0 ? 0 : c];
      frictions.at[l] = data.friction;
      stiffness.at[l] = data.soft.stiffness;
      damping.at[l] = data.soft.damping;
      weight.at[l] = data.weight;
      none.at[l] = c < 0 ? 1.0f : 0.0f;
      soft[l] = &data.soft;
    }
    real jacobian[3][NV], velocity[3], free[3], friction = all(frictions);
    contact_jacobian(now, list, k, contact, friction, jacobian, velocity);
    real imp = impedance(contact.distance, soft);
    UNROLL for (int d = 0; d < 3; ++d) {
      free[d] = through_inertia(f, jacobian[d]) + all(damping) * velocity[d];
      real* base = rows.base[rows.limits + 3 * k + d];
      UNROLL for (int i = 0; i < NV; ++i) base[i] = jacobian[d][i];
    }
    free[0] = free[0] + all(stiffness) * imp * contact.distance;
    // of all four edges alike (MuJoCo, Computation: Constraint model, pyramidal cones)
    real square = friction * friction;
    real slack = (1.0f - imp) / imp * all(weight) * (1.0f + square) * (2.0f * square / IMPRATIO);
    mask empty = all(none) > 0.5f;
    int r = rows.limits + 4 * k;
    UNROLL for (int e = 0; e < 4; ++e) {
      real edge = e % 2 ? free[0] - free[1 + e / 2] : free[0] + free[1 + e / 2];
      rows.free[r + e] = select(empty, splat(1.0f), edge);
      rows.slack[r + e] = select(empty, splat(1.0f), slack);
    }
    guess_edges(list, k, warm, rows);
  }
}
