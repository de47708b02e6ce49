//! Small least squares by Householder reflections: what the gaps of cuts settle, how well, and on which side.

/// Sum of products, four at a time: additions that wait for each other take longer than the products.
pub(crate) fn dot(x: &[f64], y: &[f64]) -> f64 {
    let ((fours, rest), (others, last)) = (x.as_chunks::<4>(), y.as_chunks::<4>());
    let mut sums = [0.0; 4];
    for (x, y) in fours.iter().zip(others) {
        (0..4).for_each(|e| sums[e] += x[e] * y[e]);
    }
    let rest: f64 = rest.iter().zip(last).map(|(x, y)| x * y).sum();
    (sums[0] + sums[2]) + (sums[1] + sums[3]) + rest
}

/// A tall matrix A = Q R, column by column; the reflections stand below the diagonal.
#[derive(Debug, Clone)]
pub(crate) struct Factor {
    rows: usize,
    columns: usize,
    entries: Vec<f64>,
    diagonal: Vec<f64>,
    /// One over each of the diagonal.
    inverse: Vec<f64>,
    /// Two over the squared length of each reflection's vector.
    weights: Vec<f64>,
}

impl Factor {
    pub(crate) fn new(rows: usize, columns: usize) -> Factor {
        let zeros = |len| vec![0.0; len];
        Factor {
            rows,
            columns,
            entries: zeros(rows * columns),
            diagonal: zeros(columns),
            inverse: zeros(columns),
            weights: zeros(columns),
        }
    }

    /// Decompose a matrix given column by column.
    pub(crate) fn decompose(&mut self, matrix: &[f64]) {
        let m = self.rows;
        self.entries.copy_from_slice(matrix);
        for k in 0..self.columns {
            let (done, after) = self.entries.split_at_mut((k + 1) * m);
            let vector = &mut done[k * m + k..];
            let length = dot(vector, vector).sqrt();
            self.diagonal[k] = if vector[0] > 0.0 { -length } else { length };
            self.inverse[k] = 1.0 / self.diagonal[k];
            vector[0] -= self.diagonal[k];
            self.weights[k] = if length > 0.0 { -self.inverse[k] / vector[0] } else { 0.0 };
            after.chunks_exact_mut(m).for_each(|column| reflect(vector, self.weights[k], &mut column[k..]));
        }
    }

    /// The x for which A x is nearest to the right side; it takes the first places there. Not finite where A is singular.
    pub(crate) fn solve(&self, right: &mut [f64]) {
        let (m, n) = (self.rows, self.columns);
        for k in 0..n {
            reflect(&self.entries[k * m + k..(k + 1) * m], self.weights[k], &mut right[k..]);
        }
        for k in (0..n).rev() {
            right[k] *= self.inverse[k];
            let (above, known) = right.split_at_mut(k);
            above.iter_mut().zip(&self.entries[k * m..]).for_each(|(x, entry)| *x -= entry * known[0]);
        }
    }

    /// Whether the least singular value of A, its columns scaled to unit length, is above a limit: whether the Gram matrix
    /// stays positive definite with its diagonal reduced by the limit squared. The matrix is n x n of scratch.
    pub(crate) fn is_open(&self, limit: f64, gram: &mut [f64]) -> bool {
        let n = self.columns;
        for i in 0..n {
            for k in 0..=i {
                let (one, other) = (self.column(i), self.column(k));
                let last = if i == k { self.diagonal[k] } else { one[k] };
                gram[i * n + k] = dot(&one[..k], &other[..k]) + last * self.diagonal[k];
            }
            gram[i * n + i] *= 1.0 - limit * limit;
        }
        is_positive(gram, n)
    }

    fn column(&self, k: usize) -> &[f64] {
        &self.entries[k * self.rows..][..self.rows]
    }
}

fn reflect(vector: &[f64], weight: f64, x: &mut [f64]) {
    let along = weight * dot(vector, x);
    x.iter_mut().zip(vector).for_each(|(x, v)| *x -= along * v);
}

/// Whether a symmetric matrix, its lower triangle given, is positive definite: by Cholesky, in place.
fn is_positive(matrix: &mut [f64], n: usize) -> bool {
    for i in 0..n {
        let (before, row) = matrix.split_at_mut(i * n);
        for k in 0..i {
            let other = &before[k * n..];
            row[k] = (row[k] - dot(&row[..k], &other[..k])) / other[k];
        }
        let pivot = row[i] - dot(&row[..i], &row[..i]);
        // Not a number is not positive either.
        if pivot.is_nan() || pivot <= 0.0 {
            return false;
        }
        row[i] = pivot.sqrt();
    }
    true
}

/// Whether det(A' B) is positive, of matrices given column by column; `product` is n x n of scratch.
pub(crate) fn same_side(a: &[f64], b: &[f64], rows: usize, product: &mut [f64]) -> bool {
    let n = a.len() / rows;
    for (i, a) in a.chunks_exact(rows).enumerate() {
        for (k, b) in b.chunks_exact(rows).enumerate() {
            product[i * n + k] = dot(a, b);
        }
    }
    let mut positive = true;
    for k in 0..n {
        let size = |i: &usize| product[i * n + k].abs();
        let pivot = (k..n).max_by(|i, j| size(i).total_cmp(&size(j))).unwrap_or(k);
        (0..n).for_each(|e| product.swap(k * n + e, pivot * n + e));
        let (above, below) = product.split_at_mut((k + 1) * n);
        let row = &above[k * n..];
        if row[k] == 0.0 || row[k].is_nan() {
            return false;
        }
        positive ^= (row[k] < 0.0) ^ (pivot != k);
        for other in below.chunks_exact_mut(n) {
            let share = other[k] / row[k];
            other[k..].iter_mut().zip(&row[k..]).for_each(|(x, y)| *x -= share * y);
        }
    }
    positive
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Three columns of length five.
    const A: [f64; 15] = [1., 2., 0., -1., 3., 0.5, -1., 2., 0., 1., 0., 0., 1., 4., -2.];

    #[test]
    fn least_squares_leave_what_is_across_all_columns() {
        let mut factor = Factor::new(5, 3);
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
    fn openness_is_the_least_singular_value_of_unit_columns() {
        // Two columns at an angle: singular values sqrt(1 +- cos).
        let (angle, mut gram) = (0.1_f64, [0.0; 4]);
        let mut factor = Factor::new(3, 2);
        factor.decompose(&[2., 0., 0., 5. * angle.cos(), 0., 5. * angle.sin()]);
        let least = (1.0 - angle.cos()).sqrt();
        assert!(factor.is_open(least * (1.0 - 1e-9), &mut gram) && !factor.is_open(least * (1.0 + 1e-9), &mut gram));
        factor.decompose(&[1., 0., 0., 1., 0., 0.]);
        assert!(!factor.is_open(1e-6, &mut gram));
        factor.decompose(&[0., 0., 0., 1., 0., 0.]);
        assert!(!factor.is_open(1e-6, &mut gram));
    }

    #[test]
    fn sides_change_with_the_sign_of_a_column_and_with_an_exchange() {
        let mut product = [0.0; 9];
        assert!(same_side(&A, &A, 5, &mut product));
        let mut other = A;
        other[5..10].iter_mut().for_each(|x| *x = -*x);
        assert!(!same_side(&A, &other, 5, &mut product));
        (0..5).for_each(|e| other.swap(e, 10 + e));
        assert!(same_side(&A, &other, 5, &mut product));
        other[..5].fill(0.0);
        assert!(!same_side(&A, &other, 5, &mut product));
    }
}
