//! Small least-squares problems by Householder QR, for the loop-closure equations: solution, conditioning, and the sign
//! of the determinant relative to a reference.

use crate::simd::real::{Number, Real};

/// Inner product.
#[inline(always)]
pub(crate) fn dot<N: Real>(token: N::Token, x: &[N], y: &[N]) -> N {
    sum(token, x, y, N::add_product)
}

/// Sum of `plus` over pairs, in four partial sums: the latency of dependent additions would exceed the time of the
/// products.
#[inline(always)]
fn sum<N: Real, Y: Copy>(token: N::Token, x: &[N], y: &[Y], plus: impl Fn(N, N, Y) -> N) -> N {
    let ((fours, rest), (others, last)) = (x.as_chunks::<4>(), y.as_chunks::<4>());
    let mut sums = [N::constant(token, 0.0); 4];
    for (x, y) in fours.iter().zip(others) {
        for ((sum, &x), &y) in sums.iter_mut().zip(x).zip(y) {
            *sum = plus(*sum, x, y);
        }
    }
    let mut left = N::constant(token, 0.0);
    for (&x, &y) in rest.iter().zip(last) {
        left = plus(left, x, y);
    }
    (sums[0] + sums[2]) + (sums[1] + sums[3]) + left
}

/// Householder QR A = Q R of a tall matrix, stored by columns; the reflection vectors stand below the diagonal.
#[derive(Debug, Clone)]
pub(crate) struct QrFactor<N: Number> {
    token: N::Token,
    rows: usize,
    columns: usize,
    entries: Vec<N>,
    diagonal: Vec<N>,
    /// Reciprocals of the diagonal of R.
    inverse: Vec<N>,
    /// 2 / |v|^2 of each reflection vector v.
    weights: Vec<N>,
}

impl<N: Real> QrFactor<N> {
    pub(crate) fn new(token: N::Token, rows: usize, columns: usize) -> QrFactor<N> {
        let zeros = |len| vec![N::constant(token, 0.0); len];
        QrFactor {
            token,
            rows,
            columns,
            entries: zeros(rows * columns),
            diagonal: zeros(columns),
            inverse: zeros(columns),
            weights: zeros(columns),
        }
    }

    /// Decompose a matrix given by columns.
    #[inline(always)]
    pub(crate) fn decompose(&mut self, matrix: &[N]) {
        let (m, token) = (self.rows, self.token);
        let none = N::constant(token, 0.0);
        self.entries.copy_from_slice(matrix);
        for k in 0..self.columns {
            let (done, after) = self.entries.split_at_mut((k + 1) * m);
            let vector = &mut done[k * m + k..];
            let length = dot(token, vector, vector).sqrt();
            let diagonal = N::select(vector[0], none, none - length, length);
            vector[0] = vector[0] - diagonal;
            let both = (diagonal * vector[0]).recip();
            (self.diagonal[k], self.inverse[k]) = (diagonal, both * vector[0]);
            self.weights[k] = N::select(length, none, none - both, none);
            for column in after.chunks_exact_mut(m) {
                reflect(token, vector, self.weights[k], &mut column[k..]);
            }
        }
    }

    /// Least-squares solution of A x = right, written to the first entries of `right`. Not finite where A is singular.
    #[inline(always)]
    pub(crate) fn solve(&self, right: &mut [N]) {
        let (m, n) = (self.rows, self.columns);
        for k in 0..n {
            reflect(self.token, &self.entries[k * m + k..(k + 1) * m], self.weights[k], &mut right[k..]);
        }
        for k in (0..n).rev() {
            right[k] = right[k] * self.inverse[k];
            let (above, known) = right.split_at_mut(k);
            for (x, &entry) in above.iter_mut().zip(&self.entries[k * m..]) {
                *x = x.sub_product(entry, known[0]);
            }
        }
    }

    /// Whether the smallest singular value of A, its columns scaled to unit length, exceeds a limit: whether the Gram
    /// matrix remains positive definite after its diagonal is reduced by the limit squared. `gram` is scratch, n x n.
    #[inline(always)]
    pub(crate) fn is_well_conditioned(&self, limit: f64, gram: &mut [N]) -> bool {
        let n = self.columns;
        for i in 0..n {
            for k in 0..=i {
                let (one, other) = (self.column(i), self.column(k));
                let last = if i == k { self.diagonal[k] } else { one[k] };
                gram[i * n + k] = dot(self.token, &one[..k], &other[..k]).add_product(last, self.diagonal[k]);
            }
            gram[i * n + i] = gram[i * n + i].scale(1.0 - limit * limit);
        }
        is_positive_definite(self.token, gram, n)
    }

    #[inline(always)]
    fn column(&self, k: usize) -> &[N] {
        &self.entries[k * self.rows..][..self.rows]
    }
}

#[inline(always)]
fn reflect<N: Real>(token: N::Token, vector: &[N], weight: N, x: &mut [N]) {
    let along = weight * dot(token, vector, x);
    for (x, &v) in x.iter_mut().zip(vector) {
        *x = x.sub_product(along, v);
    }
}

/// Whether a symmetric matrix, given by its lower triangle, is positive definite: Cholesky in place. After a pivot that
/// is not positive all later ones are -inf or NaN, so that the last one decides.
#[inline(always)]
fn is_positive_definite<N: Real>(token: N::Token, matrix: &mut [N], n: usize) -> bool {
    let mut pivot = N::constant(token, 1.0);
    for i in 0..n {
        let (before, row) = matrix.split_at_mut(i * n);
        for k in 0..i {
            let other = &before[k * n..];
            row[k] = (row[k] - dot(token, &row[..k], &other[..k])) * other[k];
        }
        pivot = row[i] - dot(token, &row[..i], &row[..i]);
        row[i] = pivot.sqrt().recip();
    }
    pivot.all_greater(0.0)
}

/// Whether B lies on the same side of the singular matrices as A, and close to it: all leading minors of A' B, and so
/// its determinant, are positive. This holds where B differs from A by less than the smallest singular value, whatever
/// the column lengths. Both are given by columns; `product` is scratch, n x n.
#[inline(always)]
pub(crate) fn same_orientation<N: Real>(token: N::Token, a: &[f64], b: &[N], rows: usize, product: &mut [N]) -> bool {
    let n = a.len() / rows;
    let product = &mut product[..n * n];
    for (i, a) in a.chunks_exact(rows).enumerate() {
        for (k, b) in b.chunks_exact(rows).enumerate() {
            product[i * n + k] = sum(token, b, a, N::add_scaled);
        }
    }
    let (mut good, none) = (N::constant(token, 1.0), N::constant(token, 0.0));
    for k in 0..n {
        let (above, below) = product.split_at_mut((k + 1) * n);
        let row = &above[k * n..];
        good = N::select(row[k], none, good, none);
        let inverse = row[k].recip();
        for other in below.chunks_exact_mut(n) {
            let share = other[k] * inverse;
            for (x, &y) in other[k..].iter_mut().zip(&row[k..]) {
                *x = x.sub_product(share, y);
            }
        }
    }
    good.all_greater(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Three columns of length five.
    const A: [f64; 15] = [1., 2., 0., -1., 3., 0.5, -1., 2., 0., 1., 0., 0., 1., 4., -2.];

    #[test]
    fn least_squares_residuals_are_orthogonal_to_all_columns() {
        let mut factor = QrFactor::new((), 5, 3);
        factor.decompose(&A);
        let right = [1., -2., 0.3, 0.7, 2.];
        let mut x = right;
        factor.solve(&mut x);
        for column in A.chunks_exact(5) {
            let left = (0..5).map(|e| column[e] * (right[e] - (0..3).map(|k| A[5 * k + e] * x[k]).sum::<f64>()));
            assert!(left.sum::<f64>().abs() < 1e-14);
        }
    }

    #[test]
    fn the_condition_is_the_smallest_singular_value_of_unit_columns() {
        // Two columns at an angle: the singular values are sqrt(1 +- cos).
        let (angle, mut gram) = (0.1_f64, [0.0; 4]);
        let mut factor = QrFactor::new((), 3, 2);
        factor.decompose(&[2., 0., 0., 5. * angle.cos(), 0., 5. * angle.sin()]);
        let least = (1.0 - angle.cos()).sqrt();
        assert!(
            factor.is_well_conditioned(least * (1.0 - 1e-9), &mut gram)
                && !factor.is_well_conditioned(least * (1.0 + 1e-9), &mut gram)
        );
        factor.decompose(&[1., 0., 0., 1., 0., 0.]);
        assert!(!factor.is_well_conditioned(1e-6, &mut gram));
        factor.decompose(&[0., 0., 0., 1., 0., 0.]);
        assert!(!factor.is_well_conditioned(1e-6, &mut gram));
    }

    #[test]
    fn the_orientation_changes_with_the_sign_of_a_column_and_with_an_exchange() {
        // Larger than needed.
        let mut product = [0.0; 12];
        assert!(same_orientation((), &A, &A, 5, &mut product));
        let (s, c) = 0.5_f64.sin_cos();
        let mut other = A;
        for e in 0..5 {
            (other[5 + e], other[10 + e]) = (c * A[5 + e] - s * A[10 + e], s * A[5 + e] + c * A[10 + e]);
        }
        assert!(same_orientation((), &A, &other, 5, &mut product));
        other[5..10].iter_mut().for_each(|x| *x = -*x);
        assert!(!same_orientation((), &A, &other, 5, &mut product));
        other = A;
        (0..5).for_each(|e| other.swap(e, 10 + e));
        assert!(!same_orientation((), &A, &other, 5, &mut product));
        other[..5].fill(0.0);
        assert!(!same_orientation((), &A, &other, 5, &mut product));
    }
}
