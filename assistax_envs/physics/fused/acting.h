// The rows that act, once these are chosen: (A + R) y = -b on them, y = 0 on the others.
//
// A Cholesky factorisation in which the others are rows of the identity. Limits are factorised row
// by row and contacts in blocks of their four rows, of which numbers that are read serve four sums:
// on a GPU reading takes longer than computing. Each number is the sum of the same terms in the same
// order as without blocks.

FN int row_start(int r) { return r * (r + 1) / 2; }  // of a packed lower triangle
FN int packed(int r, int s) { return r >= s ? row_start(r) + s : row_start(s) + r; }

struct Acting {
  const real* products;  // A, packed
  const real* x;
  real* lower;  // the factor, packed; reciprocals on its diagonal
  real* y;      // solves the lower triangle alone, until `solve_upper`
};

FN real product_of_acting(const Acting& on, int r, int s) {
  return select(maximum(on.x[r], on.x[s]) < 0.0f, on.products[row_start(r) + s], splat(0.0f));
}

// What is left of -b and of the diagonal of B rows while the factor's columns are taken off.
template <int B>
struct Remainder {
  real right[B], pivot[B];
};

// Write number b of rows r.. and column s of the factor, and take it off.
template <int B>
FN void take_off(const Acting& on, int r, int s, int b, real number, Remainder<B>& left) {
  on.lower[row_start(r + b) + s] = number;
  left.right[b] = left.right[b] - number * on.y[s];
  left.pivot[b] = left.pivot[b] - number * number;
}

// The factor's columns s..s+C-1 of rows r..r+B-1, which are below them.
template <int B, int C>
FN void factor_columns(const Acting& on, int r, int s, Remainder<B>& left) {
  real d[B][C];
  UNROLL for (int b = 0; b < B; ++b)
    UNROLL for (int c = 0; c < C; ++c) d[b][c] = product_of_acting(on, r + b, s + c);
  KEEP_LOOP for (int t = 0; t < s; ++t) {
    real below[B], above[C];
    UNROLL for (int b = 0; b < B; ++b) below[b] = on.lower[row_start(r + b) + t];
    UNROLL for (int c = 0; c < C; ++c) above[c] = on.lower[row_start(s + c) + t];
    UNROLL for (int b = 0; b < B; ++b)
      UNROLL for (int c = 0; c < C; ++c) d[b][c] = d[b][c] - below[b] * above[c];
  }
  UNROLL for (int c = 0; c < C; ++c) {
    const real* above = on.lower + row_start(s + c) + s;
    UNROLL for (int b = 0; b < B; ++b) {
      UNROLL for (int t = 0; t < c; ++t) d[b][c] = d[b][c] - d[b][t] * above[t];
      d[b][c] = d[b][c] * above[c];
      take_off<B>(on, r, s + c, b, d[b][c], left);
    }
  }
}

// Rows r..r+B-1 among themselves, and their y.
template <int B>
FN void factor_diagonal(const Acting& on, int r, Remainder<B>& left) {
  real d[B][B];
  UNROLL for (int b = 0; b < B; ++b)
    UNROLL for (int c = 0; c < b; ++c) d[b][c] = product_of_acting(on, r + b, r + c);
  if (B > 1) KEEP_LOOP for (int t = 0; t < r; ++t) {
    real row[B];
    UNROLL for (int b = 0; b < B; ++b) row[b] = on.lower[row_start(r + b) + t];
    UNROLL for (int b = 0; b < B; ++b)
      UNROLL for (int c = 0; c < b; ++c) d[b][c] = d[b][c] - row[b] * row[c];
  }
  UNROLL for (int b = 0; b < B; ++b) {
    UNROLL for (int c = 0; c < b; ++c) {
      UNROLL for (int t = 0; t < c; ++t) d[b][c] = d[b][c] - d[b][t] * d[c][t];
      d[b][c] = d[b][c] * d[c][c];
      take_off<B>(on, r, r + c, b, d[b][c], left);
    }
    d[b][b] = 1.0f / square_root(maximum(left.pivot[b], 1e-12f));
    on.lower[row_start(r + b) + r + b] = d[b][b];
    on.y[r + b] = left.right[b] * d[b][b];
  }
}

template <int B>
FN void start_rows(const Rows& rows, const Acting& on, int r, Remainder<B>& left) {
  UNROLL for (int b = 0; b < B; ++b) {
    mask acts = on.x[r + b] < 0.0f;
    real diagonal = on.products[row_start(r + b) + r + b] + rows.slack[r + b];
    left.right[b] = select(acts, -rows.free[r + b], splat(0.0f));
    left.pivot[b] = select(acts, diagonal, splat(1.0f));
  }
}

FN void solve_upper(const Acting& on, int n) {
  KEEP_LOOP for (int r = n - 1; r >= 0; --r) {
    real d = on.y[r];
    READ_AHEAD for (int s = r + 1; s < n; ++s) d = d - on.lower[row_start(s) + r] * on.y[s];
    on.y[r] = d * on.lower[row_start(r) + r];
  }
}

FN void solve_acting(const Rows& rows, int n, const Acting& on) {
  KEEP_LOOP for (int r = 0; r < rows.limits; ++r) {
    Remainder<1> left;
    start_rows<1>(rows, on, r, left);
    KEEP_LOOP for (int s = 0; s < r; ++s) factor_columns<1, 1>(on, r, s, left);
    factor_diagonal<1>(on, r, left);
  }
  KEEP_LOOP for (int r = rows.limits; r < n; r += 4) {
    Remainder<4> left;
    start_rows<4>(rows, on, r, left);
    KEEP_LOOP for (int s = 0; s < rows.limits; ++s) factor_columns<4, 1>(on, r, s, left);
    KEEP_LOOP for (int s = rows.limits; s < r; s += 4) factor_columns<4, 4>(on, r, s, left);
    factor_diagonal<4>(on, r, left);
  }
  solve_upper(on, n);
}
