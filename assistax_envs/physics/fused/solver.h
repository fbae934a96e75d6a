// What joint limits and contacts do in one substep: their rows, their forces, the torques of these.

// Remember which edges of a contact acted, for the next substep's first guess, and report its force
// (and its frame) where a sensor asks for it: of several contacts of a pair, the strongest.
FN void report_contact(const Rows& rows, const ContactList& list, int k, const real* edge,
                       const real* force, unsigned* warm, real* strongest, real* sensed) {
  LANES(l) {
    int c = list.candidate[k][l];
    if (c < 0) continue;
    unsigned acted = 0;
    for (int e = 0; e < 4; ++e) acted |= lane(edge[e], l) > 0.0f ? 1u << e : 0u;
    warm[c / 8 * W + l] |= acted << (4 * (c % 8));
    const CandidateData& data = CANDIDATE[c];
    if (data.sensor < 0) continue;
    float f[3] = {lane(force[0], l), data.friction * lane(force[1], l),
                  data.friction * data.turn * lane(force[2], l)};
    float square = dot_lane(f, f);
    if (square <= lane(strongest[data.sensor], l)) continue;
    lane(strongest[data.sensor], l) = square;
    const real(*frame)[3] = rows.frame[k];
    for (int j = 0; j < 3; ++j) {
      lane(sensed[9 * data.sensor + j], l) = f[j];
      lane(sensed[9 * data.sensor + 3 + j], l) = data.turn * lane(frame[0][j], l);
      lane(sensed[9 * data.sensor + 6 + j], l) = data.turn * lane(frame[1][j], l);
    }
  }
}

// Keep the largest force of each sensor so far, from the squares of this substep's, and the largest
// sum of forces that act at once.
FN void raise_peaks(const real* strongest, real* peaks) {
  real sum = splat(0.0f);
  UNROLL for (int s = 0; s < NPEAK - 1; ++s) {
    real size = square_root(strongest[s]);
    peaks[s] = maximum(peaks[s], size);
    sum = sum + size;
  }
  if (NPEAK) peaks[NPEAK - 1] = maximum(peaks[NPEAK - 1], sum);
}

// Add J^T times the rows' forces to `torque`, in lanes that have rows.
FN void apply_forces(const Stage& now, const Factored& f, const Rows& rows,
                     const ContactList& list, const real* forces, unsigned* warm, real* torque,
                     real* sensed, real* peaks) {
  real sum[NV], strongest[NFORCE + 1];
  UNROLL for (int i = 0; i < NV; ++i) sum[i] = splat(0.0f);
  UNROLL for (int s = 0; s < NFORCE; ++s) strongest[s] = splat(0.0f);
  for (int w = 0; w < NWARM * W; ++w) warm[w] = 0;
  KEEP_LOOP for (int k = 0; k < rows.limits; ++k)
    UNROLL for (int i = 0; i < NV; ++i) sum[i] = sum[i] + forces[k] * rows.base[k][i];
  KEEP_LOOP for (int k = 0; k < rows.contacts; ++k) {
    const real(*z)[NV] = rows.base + rows.limits + 3 * k;
    const real* edge = forces + rows.limits + 4 * k;
    real force[3] = {edge[0] + edge[1] + edge[2] + edge[3], edge[0] - edge[1], edge[2] - edge[3]};
    UNROLL for (int i = 0; i < NV; ++i)
      sum[i] = sum[i] + force[0] * z[0][i] + force[1] * z[1][i] + force[2] * z[2][i];
    report_contact(rows, list, k, edge, force, warm, strongest, sensed);
  }
  UNROLL for (int i = 0; i < NV; ++i) sum[i] = sum[i] / f.root[i];
  raise_peaks(strongest, peaks);
  multiply_transposed(f.entries, sum);
  UNROLL for (int i = 0; i < NV; ++i) torque[i] = select(now.acts, torque[i] + sum[i], torque[i]);
}

// Add to `torque` what limits and contacts do; write the contact forces that sensors ask for.
FN_CALLED void solve_constraints(const Stage& now, real* torque, real* sensed, real* peaks,
                                 unsigned* warm, Report& report) {
  Factored f;
  Rows rows;
  ContactList list;
  real products[MAX_ROWS * (MAX_ROWS + 1) / 2], forces[MAX_ROWS];
  factor(now, f);
  add_limits(now, f, rows);
  list_contacts(now, list, report);
  add_contacts(now, f, list, warm, rows);
  row_products(rows, products);
  newton(rows, rows.limits + 4 * rows.contacts, products, forces, report);
  apply_forces(now, f, rows, list, forces, warm, torque, sensed, peaks);
}
