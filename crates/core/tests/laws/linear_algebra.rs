//! Laws of the R factor.

use crate::{below, few};
use haptid_core::{Backend, r_factor};
use proptest::collection::vec;
use proptest::prelude::*;

/// Rows of some columns, row-major; the columns' lengths differ by powers of two.
#[derive(Debug, Clone)]
struct Matrix {
    numbers: Vec<f64>,
    columns: usize,
}

impl Matrix {
    fn rows(&self) -> usize {
        self.numbers.len() / self.columns
    }

    /// R, row-major.
    fn r(&self, backend: Backend) -> Vec<f64> {
        let mut r = vec![f64::NAN; self.columns * self.columns];
        r_factor(backend, &self.numbers, self.columns, &mut r).expect("shapes");
        r
    }

    /// The matrix with each number changed, given its row and column.
    fn map(&self, f: impl Fn(usize, usize, f64) -> f64) -> Matrix {
        let p = self.columns;
        Matrix { numbers: self.numbers.iter().enumerate().map(|(k, &x)| f(k / p, k % p, x)).collect(), columns: p }
    }

    fn entry(&self, row: usize, column: usize) -> f64 {
        self.numbers[row * self.columns + column]
    }

    /// Column `c` of a matrix with as many columns, as numbers.
    fn column(&self, of: &[f64], c: usize) -> Vec<f64> {
        of.iter().skip(c).step_by(self.columns).copied().collect()
    }

    /// Largest error of the inner products of R's columns, relative to the lengths of A's.
    fn error(&self, r: &[f64]) -> f64 {
        let inner =
            |of: &[f64], i, j| -> f64 { self.column(of, i).iter().zip(self.column(of, j)).map(|(x, y)| x * y).sum() };
        let mut worst = 0.0_f64;
        for j in 0..self.columns {
            for i in 0..=j {
                let size = (inner(&self.numbers, i, i) * inner(&self.numbers, j, j)).sqrt();
                let difference = (inner(r, i, j) - inner(&self.numbers, i, j)).abs();
                assert!(!difference.is_nan(), "R has no numbers");
                worst = worst.max(if difference == 0.0 { 0.0 } else { difference / size });
            }
        }
        worst
    }

    /// What rounding may do: a few units for every number that is added, and for every reflection.
    fn rounding(&self) -> f64 {
        8.0 * f64::EPSILON * (self.rows() + self.columns + 8) as f64
    }
}

/// 2^k, exactly: Miri rounds `powi` as a bad library might.
fn power_of_two(k: i32) -> f64 {
    f64::from_bits(((1023 + k) as u64) << 52)
}

fn matrix() -> impl Strategy<Value = Matrix> {
    (1..below(14, 6), 1..below(80, 12)).prop_flat_map(|(columns, rows)| {
        (vec(-1.0..1.0, rows * columns), vec(-30..30_i32, columns))
            .prop_map(move |(numbers, sizes)| Matrix { numbers, columns }.map(|_, c, x| x * power_of_two(sizes[c])))
    })
}

/// A matrix, and one of its columns.
fn with_column() -> impl Strategy<Value = (Matrix, usize)> {
    (matrix(), any::<prop::sample::Index>()).prop_map(|(a, at)| {
        let at = at.index(a.columns);
        (a, at)
    })
}

/// The rows of triangles, one below the other, as a matrix.
fn stacked(triangles: &[Vec<f64>], columns: usize) -> Matrix {
    Matrix { numbers: triangles.concat(), columns }
}

proptest! {
    #![proptest_config(few())]

    /// R is upper, and R'R = A'A, for columns of any lengths.
    #[test]
    fn the_r_factor_keeps_inner_products(a in matrix()) {
        for backend in Backend::available() {
            let r = a.r(backend);
            prop_assert!((0..r.len()).all(|k| k / a.columns <= k % a.columns || r[k] == 0.0), "{:?}", backend);
            prop_assert!(a.error(&r) <= a.rounding(), "{:?}: {}", backend, a.error(&r));
        }
    }

    /// The factor of the blocks' factors is one of all rows.
    #[test]
    fn blocks_agree_with_one_reduction(a in matrix(), block in 1_usize..40) {
        for backend in Backend::available() {
            let of = |rows: &[f64]| Matrix { numbers: rows.to_vec(), columns: a.columns }.r(backend);
            let blocks: Vec<Vec<f64>> = a.numbers.chunks(block * a.columns).map(of).collect();
            let (merged, whole) = (stacked(&blocks, a.columns).r(backend), a.r(backend));
            let most = a.rounding() * (1 + blocks.len()) as f64;
            prop_assert!(a.error(&merged) <= most, "{:?}: {}", backend, a.error(&merged));
            prop_assert!(a.error(&whole) <= most, "{:?}: {}", backend, a.error(&whole));
        }
    }

    /// Columns multiplied by powers of two multiply those of R, bit by bit; so does the whole.
    #[test]
    fn lengths_of_columns_pass_through(a in matrix(), powers in vec(-40..40_i32, 14)) {
        let scale = |c: usize| power_of_two(powers[c]);
        for backend in Backend::available() {
            let scaled = a.map(|_, c, x| x * scale(c)).r(backend);
            for (k, (x, y)) in scaled.iter().zip(a.r(backend)).enumerate() {
                prop_assert_eq!(*x, y * scale(k % a.columns), "{:?}, entry {}", backend, k);
            }
        }
    }

    /// Inner products do not depend on the order of columns or of rows.
    #[test]
    fn order_does_not_matter(a in matrix(), by in any::<prop::sample::Index>(), down in any::<prop::sample::Index>()) {
        let (p, n) = (a.columns, a.rows());
        let (by, down) = (by.index(p), down.index(n));
        let turned = a.map(|row, c, _| a.entry((row + down) % n, (c + by) % p));
        for backend in Backend::available() {
            let r = turned.r(backend);
            let back: Vec<f64> = (0..p * p).map(|k| r[k / p * p + (k % p + p - by) % p]).collect();
            prop_assert!(a.error(&back) <= a.rounding(), "{:?}: {}", backend, a.error(&back));
        }
    }

    /// NaN and infinity are told in their column, and leave the columns before it as they were.
    #[test]
    fn what_is_no_number_is_told_in_its_column(
        (a, at) in with_column(),
        row in any::<prop::sample::Index>(),
        bad in prop::sample::select(vec![f64::NAN, f64::INFINITY, f64::NEG_INFINITY]),
    ) {
        let row = row.index(a.rows());
        let spoilt = a.map(|k, c, x| if (k, c) == (row, at) { bad } else { x });
        for backend in Backend::available() {
            let (got, clean) = (spoilt.r(backend), a.r(backend));
            prop_assert!(a.column(&got, at).iter().any(|x| !x.is_finite()), "{:?}", backend);
            for before in 0..at {
                prop_assert_eq!(a.column(&got, before), a.column(&clean, before), "{:?}, column {}", backend, before);
            }
        }
    }

    /// A column of zeros is zero in R; a repeated one has no direction of its own; the others keep their products.
    #[test]
    fn dead_columns_stay_dead((a, at) in with_column()) {
        for backend in Backend::available() {
            let dead = a.map(|_, c, x| if c == at { 0.0 } else { x });
            let r = dead.r(backend);
            prop_assert!(a.column(&r, at).iter().all(|&x| x == 0.0), "{:?}", backend);
            prop_assert!(dead.error(&r) <= a.rounding(), "{:?}: {}", backend, dead.error(&r));
            if at > 0 {
                let repeated = a.map(|row, c, x| if c == at { a.entry(row, 0) } else { x });
                let r = repeated.r(backend);
                prop_assert!(repeated.error(&r) <= a.rounding(), "{:?}: {}", backend, repeated.error(&r));
                let own = r[at * a.columns + at].abs() / r[0].abs();
                prop_assert!(own <= a.rounding() * a.columns as f64, "{:?}: {}", backend, own);
            }
        }
    }
}
