// MuJoCo's convex problem, solved to convergence by Newton's method in the space of the rows.
//
// Find the acceleration a that minimises
//   1/2 (a - a0)^T M (a - a0) + sum over rows s_r(x_r),  x = J a - aref,
// with s(x) = x^2 / 2 R for x < 0, else 0: a row acts where x < 0, with the force -x / R. With
// a = a0 + M^-1 J^T y and A = J M^-1 J^T, x = b + A y with b = `Rows::free`. If the rows that act
// were known, (A + R) y = -b on them and y = 0 elsewhere would be the solution; Newton's method
// takes the rows that act now, goes towards that solution as far as the cost falls (an exact line
// search, for the cost is piecewise quadratic), and is done when the same rows act as before.
//
// All lanes iterate together. A lane that is done is masked: nothing of it changes any more, so
// that its result does not depend on its neighbours.

// Inner products of two vectors of z.
FN real product_of(const real* a, const real* b) {
  real d = splat(0.0f);
  UNROLL for (int i = 0; i < NV; ++i) d = d + a[i] * b[i];
  return d;
}

// The rows of contact k against limit s: edges are normal +- tangents.
FN void products_with_limit(const Rows& rows, int k, int s, real* products) {
  const real(*z)[NV] = rows.base + rows.limits + 3 * k;
  int r = rows.limits + 4 * k;
  real p[3];
  UNROLL for (int d = 0; d < 3; ++d) p[d] = product_of(z[d], rows.base[s]);
  products[packed(r, s)] = p[0] + p[1];
  products[packed(r + 1, s)] = p[0] - p[1];
  products[packed(r + 2, s)] = p[0] + p[2];
  products[packed(r + 3, s)] = p[0] - p[2];
}

// The rows of contact k against those of contact c <= k.
FN void products_with_contact(const Rows& rows, int k, int c, real* products) {
  const real(*zk)[NV] = rows.base + rows.limits + 3 * k;
  const real(*zc)[NV] = rows.base + rows.limits + 3 * c;
  int r = rows.limits + 4 * k, s = rows.limits + 4 * c;
  real p[3][3];
  UNROLL for (int d = 0; d < 3; ++d) UNROLL for (int e = 0; e < 3; ++e) p[d][e] = splat(0.0f);
  UNROLL for (int i = 0; i < NV; ++i)
    UNROLL for (int d = 0; d < 3; ++d)
      UNROLL for (int e = 0; e < 3; ++e) p[d][e] = p[d][e] + zk[d][i] * zc[e][i];
  UNROLL for (int a = 0; a < 4; ++a) UNROLL for (int b = 0; b < 4; ++b) {
    if (c == k && b > a) continue;
    real normal = p[0][1 + b / 2], tangent = p[1 + a / 2][0], mixed = p[1 + a / 2][1 + b / 2];
    real sum = b % 2 ? p[0][0] - normal : p[0][0] + normal;
    sum = a % 2 ? sum - tangent : sum + tangent;
    products[packed(r + a, s + b)] = (a + b) % 2 ? sum - mixed : sum + mixed;
  }
}

// A = J M^-1 J^T of all rows, packed lower triangle.
FN void row_products(const Rows& rows, real* products) {
  KEEP_LOOP for (int r = 0; r < rows.limits; ++r)
    KEEP_LOOP for (int s = 0; s <= r; ++s)
      products[packed(r, s)] = product_of(rows.base[r], rows.base[s]);
  KEEP_LOOP for (int k = 0; k < rows.contacts; ++k) {
    KEEP_LOOP for (int s = 0; s < rows.limits; ++s) products_with_limit(rows, k, s, products);
    KEEP_LOOP for (int c = 0; c <= k; ++c) products_with_contact(rows, k, c, products);
  }
}

// The cost's derivatives along a step of the line search, without the rows' part.
struct Slope {
  real at_start, per_step;
  real whole;  // what `per_step` would be for a step from no force at all
};

// Where rows r..r+B-1 would be with the forces y, and what the line search needs of them.
template <int B>
FN void step_rows(const Rows& rows, int n, const Acting& on, int r, const real* forces, real* next,
                  mask& changed, Slope& slope) {
  real d[B];
  UNROLL for (int b = 0; b < B; ++b) d[b] = rows.free[r + b];
  KEEP_LOOP for (int s = 0; s < r; ++s)
    UNROLL for (int b = 0; b < B; ++b) d[b] = d[b] + on.products[row_start(r + b) + s] * on.y[s];
  UNROLL for (int b = 0; b < B; ++b)
    UNROLL for (int s = r; s < r + B; ++s) d[b] = d[b] + on.products[packed(r + b, s)] * on.y[s];
  KEEP_LOOP for (int s = r + B; s < n; ++s)
    UNROLL for (int b = 0; b < B; ++b) d[b] = d[b] + on.products[row_start(s) + r + b] * on.y[s];
  UNROLL for (int b = 0; b < B; ++b) {
    real x = on.x[r + b], y = on.y[r + b];
    // On rows that act this is -R y, of which rounding leaves more.
    next[r + b] = select(x < 0.0f, -rows.slack[r + b] * y, d[b]);
    changed = either(changed, differ(next[r + b] < 0.0f, x < 0.0f));
    real step = y - forces[r + b];
    slope.at_start = slope.at_start + step * (x - rows.free[r + b]);
    slope.per_step = slope.per_step + step * (next[r + b] - x);
    slope.whole = slope.whole + y * (next[r + b] - rows.free[r + b]);
  }
}

// Return the share of the step from x to next at which the cost is least; 1 where not `searching`.
// Near the end rounding hides the slope, and Newton's method on it could go anywhere: it is held
// between the largest share known to be too small and the smallest known to be too large.
FN real line_search(const Rows& rows, int n, const real* x, const real* next, Slope slope,
                    mask searching) {
  real share = splat(1.0f), low = splat(0.0f), high = splat(2.0f);
  KEEP_LOOP for (int k = 0; k < MAX_SEARCHES && any(searching); ++k) {
    real first = slope.at_start + share * slope.per_step, second = slope.per_step;
    READ_AHEAD for (int r = 0; r < n; ++r) {
      real step = next[r] - x[r], there = x[r] + share * step;
      real weighted = select(there < 0.0f, step / rows.slack[r], splat(0.0f));
      first = first + weighted * there;
      second = second + weighted * step;
    }
    high = select(first > 0.0f, share, high);
    low = select(first < 0.0f, share, low);
    real better = maximum(low, minimum(high, share - first / maximum(second, 1e-20f)));
    searching = both(searching, absolute(better - share) > 1e-4f);
    share = select(searching, better, share);
  }
  return share;
}

// Find the rows' forces; lanes in which the iteration does not settle are flagged.
FN void newton(const Rows& rows, int n, const real* products, real* forces, Report& report) {
  real lower[MAX_ROWS * (MAX_ROWS + 1) / 2], x[MAX_ROWS], y[MAX_ROWS], next[MAX_ROWS];
  Acting on = {products, x, lower, y};
  KEEP_LOOP for (int r = 0; r < n; ++r) {
    forces[r] = splat(0.0f);
    x[r] = rows.guess[r];
  }
  mask open = splat(0.0f) < 1.0f;
  KEEP_LOOP for (int iteration = 0; iteration < MAX_ITERATIONS && any(open); ++iteration) {
    LANES(l) report.effort[l] += lane_is_set(open, l);
    solve_acting(rows, n, on);
    mask changed = splat(0.0f) > 1.0f;
    Slope slope = {splat(0.0f), splat(0.0f), splat(0.0f)};
    KEEP_LOOP for (int r = 0; r < rows.limits; ++r)
      step_rows<1>(rows, n, on, r, forces, next, changed, slope);
    KEEP_LOOP for (int r = rows.limits; r < n; r += 4)
      step_rows<4>(rows, n, on, r, forces, next, changed, slope);
    // Where rounding decides on which side a row is, rows may change sides for ever: after some
    // iterations, a step that changes accelerations by less than SETTLED of what all rows do to
    // them is the last.
    if (iteration >= PATIENCE)
      changed = both(changed, slope.per_step > SETTLED * SETTLED * slope.whole);
    // The first x is a guess, no acceleration: its solution is where to start.
    mask whole = iteration == 0 ? open : both(open, invert(changed));
    mask partly = both(open, invert(whole));
    real share = splat(1.0f);
    if (any(partly)) share = line_search(rows, n, x, next, slope, partly);
    // No share of a small step lowers the cost: x is where it is least, as far as rounding shows.
    mask stuck = both(partly, both(share <= 0.0f, slope.per_step < STUCK * STUCK * slope.whole));
    changed = both(changed, invert(stuck));
    KEEP_LOOP for (int r = 0; r < n; ++r) {
      real force = select(partly, forces[r] + share * (y[r] - forces[r]), forces[r]);
      forces[r] = select(whole, y[r], force);
      x[r] = select(whole, next[r], select(partly, x[r] + share * (next[r] - x[r]), x[r]));
    }
    open = both(open, changed);
  }
  KEEP_LOOP for (int r = 0; r < n; ++r)
    forces[r] = maximum(select(open, -x[r] / rows.slack[r], forces[r]), 0.0f);
  LANES(l) report.flags[l] += lane_is_set(open, l) ? UNSETTLED : 0;
}
