//! R factors from Gram matrices of preconditioned columns.
//!
//! A = B S with S unit upper triangular. Columns of A that are nearly dependent on those before them, as an R factor of
//! a few rows tells, are made nearly orthogonal to those in place, from the first to the last (a triangular solve: an
//! explicit inverse loses digits). Then R = chol(B'B) S. The condition number of the Cholesky factor with unit columns
//! bounds what is lost: the error of R's columns is some multiple of `eps * condition`, its square at worst. Where it
//! exceeds a limit, or is no number, there is no R, and the rows must be reflected (see [`crate::linalg::tsqr`]).
//! Orthogonal columns stay as they are, so that few of them cost more than plain normal equations.

use crate::simd::dispatch::{Backend, dispatched};
use crate::simd::inlined;
use crate::simd::lane::{Lane, MAX_WIDTH};
use crate::simd::token::Simd;

/// Largest condition number (Frobenius norm) of the scaled factor of B that is accepted.
const WORST: f64 = 1e3;
/// Largest one that the few rows may predict: the others differ from them.
const WORST_PREDICTED: f64 = 600.0;
/// Part of a column orthogonal to those before it, relative to the column, below which it is transformed: the first of
/// these with which the few rows predict a good factor.
const NEAR: [f64; 4] = [0.03, 0.1, 0.3, f64::INFINITY];
/// Orthogonal part of a column of the few rows that is rounding, relative to the column.
const ROUNDING: f64 = 1e-11;
/// Squared length of a transformed column, relative to what was subtracted, that is rounding.
const ROUNDING_SQUARED: f64 = 2e-28;
/// Columns transformed together.
const GROUP: usize = 4;
/// Rows are transformed in multiples of this many: four of the widest lanes.
pub(crate) const ROWS_TOGETHER: usize = 4 * MAX_WIDTH;

/// The transformation from A to B.
#[derive(Debug, Clone)]
pub(crate) struct Preconditioner {
    columns: usize,
    chosen: Vec<usize>,
    /// Share of each column of B in each chosen one of A, column-major.
    shares: Vec<f64>,
    groups: Vec<Group>,
}

/// Chosen columns that are transformed together.
#[derive(Debug, Clone)]
struct Group {
    chosen: [usize; GROUP],
    many: usize,
    /// Columns that are subtracted, and their shares, `many` for each.
    others: Vec<usize>,
    shares: Vec<f64>,
    /// Shares of the group's own columns in later ones.
    own: [[f64; GROUP]; GROUP],
}

impl Preconditioner {
    /// From the R factor of a few rows, column-major; `None` if no choice of columns promises a good factor.
    pub(crate) fn new(r: &[f64], columns: usize) -> Option<Preconditioner> {
        NEAR.iter().find_map(|&near| Preconditioner::with(r, columns, near))
    }

    fn with(r: &[f64], n: usize, near: f64) -> Option<Preconditioner> {
        let norm: Vec<f64> = r.chunks_exact(n).map(|column| column.iter().map(|x| x * x).sum::<f64>().sqrt()).collect();
        let diagonal = |k: usize| r[k * n + k].abs();
        let dead: Vec<bool> = (0..n).map(|k| diagonal(k) <= ROUNDING * norm[k]).collect();
        // The R factor of B at the few rows: chosen columns are orthogonal to those before them.
        let (mut b, mut shares) = (r.to_vec(), vec![0.0; n * n]);
        let chosen: Vec<usize> = (1..n).filter(|&k| norm[k] > 0.0 && diagonal(k) < near * norm[k]).collect();
        for &k in &chosen {
            let (before, column) = b.split_at_mut(k * n);
            for i in (0..k).rev().filter(|&i| !dead[i]) {
                let share = column[i] / before[i * n + i];
                shares[k * n + i] = share;
                column.iter_mut().zip(&before[i * n..][..=i]).for_each(|(x, y)| *x -= share * y);
                column[i] = 0.0;
            }
        }
        let scaled: Vec<f64> = (0..n * n)
            .map(|e| {
                let (k, i) = (e / n, e % n);
                let length = b[k * n..=k * n + k].iter().map(|x| x * x).sum::<f64>().sqrt();
                if dead[k] || length == 0.0 || i > k { 0.0 } else { b[e] / length }
            })
            .collect();
        let good = condition(&scaled, n) < WORST_PREDICTED;
        good.then(|| {
            let groups = chosen.chunks(GROUP).map(|some| Group::new(some, &shares, n)).collect();
            Preconditioner { columns: n, chosen, shares, groups }
        })
    }

    /// Transform rows in place. Column c begins at `a[c * stride]`; rows up to the next multiple of [`ROWS_TOGETHER`] are
    /// transformed too.
    ///
    /// # Panics
    ///
    /// If `a` is shorter than its shape requires.
    pub(crate) fn apply(&self, backend: Backend, a: &mut [f64], rows: usize, stride: usize) {
        let padded = rows.next_multiple_of(ROWS_TOGETHER);
        assert!(padded <= stride && a.len() >= self.columns * stride);
        if !self.groups.is_empty() {
            // SAFETY: the assertion above keeps all columns inside A.
            unsafe { transform(backend, &self.groups, a.as_mut_ptr(), stride, padded) }
        }
    }

    /// The R factor of A, column-major, from the upper triangle of B'B; `None` if it could be wrong.
    pub(crate) fn r_factor(&self, gram: &[f64]) -> Option<Vec<f64>> {
        let n = self.columns;
        let length: Vec<f64> = (0..n).map(|k| gram[k * n + k].sqrt()).collect();
        // A transformed column that is rounding has no direction.
        let rounding = |k: usize| {
            let taken: f64 = (0..k).map(|i| self.shares[k * n + i].powi(2) * gram[i * n + i]).sum();
            gram[k * n + k] < ROUNDING_SQUARED * taken
        };
        let rounding: Vec<bool> = (0..n).map(rounding).collect();
        // Row by row, rows being contiguous: what is left of the scaled matrix becomes the factor.
        let unit =
            |x: f64, i: usize, j: usize| if length[i] * length[j] == 0.0 { 0.0 } else { x / (length[i] * length[j]) };
        let mut rows: Vec<f64> =
            (0..n * n).map(|e| if e % n < e / n { 0.0 } else { unit(gram[e % n * n + e / n], e / n, e % n) }).collect();
        for i in (0..n).filter(|&i| length[i] != 0.0) {
            let (row, below) = rows[i * n..].split_at_mut(n);
            if rounding[i] {
                row.fill(0.0);
                row[i] = 1.0;
                continue;
            }
            let pivot = row[i].sqrt();
            row[i..].iter_mut().for_each(|x| *x /= pivot);
            for (k, other) in (i + 1..n).zip(below.chunks_exact_mut(n)) {
                let share = row[k];
                other[k..].iter_mut().zip(&row[k..]).for_each(|(x, y)| *x -= share * y);
            }
        }
        let mut r: Vec<f64> = (0..n * n).map(|e| rows[e % n * n + e / n]).collect();
        if gram.iter().any(|x| !x.is_finite()) || condition(&r, n) >= WORST || r.iter().any(|x| x.is_nan()) {
            return None;
        }
        for (column, length) in r.chunks_exact_mut(n).zip(&length) {
            column.iter_mut().for_each(|x| *x *= length);
        }
        for &k in self.chosen.iter().rev() {
            let (before, column) = r.split_at_mut(k * n);
            for i in (0..k).filter(|&i| self.shares[k * n + i] != 0.0) {
                let share = self.shares[k * n + i];
                column.iter_mut().zip(&before[i * n..][..=i]).for_each(|(x, y)| *x += share * y);
            }
        }
        Some(r)
    }
}

impl Group {
    fn new(some: &[usize], shares: &[f64], n: usize) -> Group {
        let (many, last) = (some.len(), some[some.len() - 1]);
        let mut chosen = [0; GROUP];
        chosen[..many].copy_from_slice(some);
        let taken = |i: &usize| !some.contains(i) && some.iter().any(|&k| shares[k * n + i] != 0.0);
        let others: Vec<usize> = (0..last).filter(taken).collect();
        let of_others = others.iter().flat_map(|&i| some.iter().map(move |&k| shares[k * n + i])).collect();
        let mut own = [[0.0; GROUP]; GROUP];
        for (c, &k) in some.iter().enumerate() {
            (0..c).for_each(|before| own[before][c] = shares[k * n + some[before]]);
        }
        Group { chosen, many, others, shares: of_others, own }
    }
}

/// Condition number, Frobenius norm, of an upper triangle with columns of unit length, column-major; columns of zeros do
/// not count. It is NaN where a number is.
fn condition(r: &[f64], n: usize) -> f64 {
    let alive: Vec<usize> = (0..n).filter(|&k| r[k * n..][..n].iter().any(|&x| x != 0.0)).collect();
    let (mut inverse, mut unit) = (0.0, vec![0.0; n]);
    for &k in &alive {
        unit.fill(0.0);
        unit[k] = 1.0;
        for &i in alive.iter().rev().filter(|&&i| i <= k) {
            let share = unit[i] / r[i * n + i];
            inverse += share * share;
            unit[..i].iter_mut().zip(&r[i * n..][..i]).for_each(|(x, y)| *x -= share * y);
        }
    }
    (alive.len() as f64 * inverse).sqrt()
}

dispatched! {
    unsafe fn transform = transform_in_lanes(groups: &[Group], a: *mut f64, stride: usize, rows: usize)
}

#[inline(always)]
unsafe fn transform_in_lanes<T: Lane>(simd: Simd<T>, groups: &[Group], a: *mut f64, stride: usize, rows: usize) {
    // Lanes of a column that stay in registers: 16 of 32 are sums with the widest ones, 8 of 16 otherwise.
    // SAFETY: the caller's promise, passed on.
    unsafe {
        match T::PANEL {
            4 => transform_rows::<T, 4>(simd, groups, a, stride, rows),
            _ => transform_rows::<T, 2>(simd, groups, a, stride, rows),
        }
    }
}

#[inline(always)]
unsafe fn transform_rows<T: Lane, const L: usize>(
    simd: Simd<T>,
    groups: &[Group],
    a: *mut f64,
    stride: usize,
    rows: usize,
) {
    for k in (0..rows).step_by(L * T::WIDTH) {
        for group in groups {
            // SAFETY: the rows are a multiple of L lanes, so that these are inside every column.
            unsafe {
                match group.many {
                    1 => transform_group::<T, L, 1>(simd, group, a.add(k), stride),
                    2 => transform_group::<T, L, 2>(simd, group, a.add(k), stride),
                    3 => transform_group::<T, L, 3>(simd, group, a.add(k), stride),
                    _ => transform_group::<T, L, GROUP>(simd, group, a.add(k), stride),
                }
            }
        }
    }
}

#[inline(always)]
fn subtract<T: Lane, const L: usize>(simd: Simd<T>, sums: &mut [T; L], lanes: [T; L], share: f64) {
    let share = simd.splat(share);
    for (sum, lane) in sums.iter_mut().zip(lanes) {
        *sum = lane.fnma(share, *sum);
    }
}

#[inline(always)]
unsafe fn transform_group<T: Lane, const L: usize, const N: usize>(
    simd: Simd<T>,
    group: &Group,
    a: *mut f64,
    stride: usize,
) {
    // SAFETY: the group's columns are below the preconditioner's, and L lanes of each are inside A.
    unsafe {
        let at = |column: usize, lane: usize| a.add(column * stride + lane * T::WIDTH);
        let mut sums: [[T; L]; N] = inlined::from_fn(|c| inlined::from_fn(|l| simd.load(at(group.chosen[c], l))));
        for (&other, shares) in group.others.iter().zip(group.shares.as_chunks::<N>().0) {
            let lanes: [T; L] = inlined::from_fn(|l| simd.load(at(other, l)));
            for (sums, &share) in sums.iter_mut().zip(shares) {
                subtract(simd, sums, lanes, share);
            }
        }
        for c in 1..N {
            for before in 0..c {
                let lanes = sums[before];
                subtract(simd, &mut sums[c], lanes, group.own[before][c]);
            }
        }
        for (c, sums) in sums.iter().enumerate() {
            for (l, lane) in sums.iter().enumerate() {
                lane.store(at(group.chosen[c], l));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::linalg::draws;
    use crate::linalg::lane_gram::LaneGram;
    use crate::linalg::tsqr::fold;
    use proptest::prelude::*;

    const ROWS: usize = 1024;
    const STRIDE: usize = ROWS + MAX_WIDTH;

    /// Columns of a length each: those of `near` are a combination of the ones before them and, with this weight, a
    /// direction of their own.
    fn columns(near: &[(f64, f64)], seed: u64) -> Vec<f64> {
        let mut draw = draws(seed);
        let mut a = vec![0.0; near.len() * STRIDE];
        for (c, &(weight, length)) in near.iter().enumerate() {
            let shares: Vec<f64> = (0..c).map(|_| draw()).collect();
            for k in 0..ROWS {
                let others: f64 = (0..c).map(|i| shares[i] * a[i * STRIDE + k] / near[i].1.max(1e-300)).sum();
                let part = if weight == 1.0 { 0.0 } else { others };
                a[c * STRIDE + k] = length * (part + weight * draw());
            }
        }
        a
    }

    fn reflected(backend: Backend, a: &[f64], n: usize, rows: &[usize]) -> Vec<f64> {
        let stride = rows.len().next_multiple_of(MAX_WIDTH);
        let (mut some, mut r) = (vec![0.0; n * stride], vec![0.0; n * n]);
        for c in 0..n {
            rows.iter().enumerate().for_each(|(k, row)| some[c * stride + k] = a[c * STRIDE + row]);
        }
        fold(backend, &mut r, n, (&mut some, rows.len(), stride), &mut Vec::new());
        r
    }

    /// R by reflections of all rows; and by the preconditioned Gram matrix, if it is accepted.
    fn both(backend: Backend, a: &[f64], n: usize) -> (Vec<f64>, Option<Vec<f64>>) {
        let all: Vec<usize> = (0..ROWS).collect();
        let few: Vec<usize> =
            (0..128).map(|k| (k as f64 * 0.618_034).fract() * ROWS as f64).map(|x| x as usize).collect();
        let transformed = Preconditioner::new(&reflected(backend, a, n, &few), n).and_then(|preconditioner| {
            let (mut sums, mut b, mut gram) = (LaneGram::default(), a.to_vec(), vec![0.0; n * n]);
            sums.clear(n);
            preconditioner.apply(backend, &mut b, ROWS, STRIDE);
            sums.add(backend, &b, n, ROWS, STRIDE);
            sums.drain(backend, n, &mut gram);
            preconditioner.r_factor(&gram)
        });
        (reflected(backend, a, n, &all), transformed)
    }

    /// The inner product of two columns, rounded once (Ogita, Rump and Oishi 2005, SIAM J. Sci. Comput. 26(6), alg. 5.3).
    fn inner(a: &[f64], i: usize, j: usize) -> f64 {
        let (mut sum, mut error) = (0.0_f64, 0.0);
        for k in 0..ROWS {
            let (x, y) = (a[i * STRIDE + k], a[j * STRIDE + k]);
            let product = x * y;
            let next = sum + product;
            let back = next - sum;
            error += x.mul_add(y, -product) + ((sum - (next - back)) + (product - back));
            sum = next;
        }
        sum + error
    }

    /// Largest error of R'R, relative to the columns' lengths.
    fn error(a: &[f64], r: &[f64], n: usize) -> f64 {
        let mut worst: f64 = 0.0;
        for j in 0..n {
            for i in 0..=j {
                let size = (inner(a, i, i) * inner(a, j, j)).sqrt();
                let got: f64 = (0..=i).map(|k| r[i * n + k] * r[j * n + k]).sum();
                let apart = (got - inner(a, i, j)).abs();
                worst = worst.max(if apart == 0.0 { 0.0 } else { apart / size });
            }
        }
        worst
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: 24, failure_persistence: None, ..ProptestConfig::default() })]

        /// Both ways have the same errors of R'R, and R's columns agree as well as their condition allows, up to signs.
        #[test]
        fn accuracy_is_that_of_reflections(
            n in 2_usize..14,
            digits in prop::sample::select(vec![2, 6, 9]),
            sizes in prop::collection::vec(-8..9_i32, 14),
            nearly in prop::collection::vec(any::<bool>(), 14),
            seed in any::<u64>(),
        ) {
            let weight = 10_f64.powi(-digits);
            let near: Vec<(f64, f64)> =
                (0..n).map(|k| (if k > 0 && nearly[k] { weight } else { 1.0 }, 10_f64.powi(sizes[k]))).collect();
            let a = columns(&near, seed);
            for backend in Backend::available() {
                let (wanted, got) = both(backend, &a, n);
                let got = got.expect("a few rows tell these columns");
                prop_assert!(error(&a, &got, n) < 4.0 * error(&a, &wanted, n) + 1e-14);
                for k in 0..n {
                    let length = inner(&a, k, k).sqrt();
                    for i in 0..=k {
                        let sign = |r: &[f64]| r[i * n + i].signum();
                        let apart = (sign(&got) * got[k * n + i] - sign(&wanted) * wanted[k * n + i]).abs();
                        prop_assert!(apart < 1e-14 / weight * length, "{} {} {}", i, k, apart / length);
                    }
                }
            }
        }

        /// A column that is zero or dependent has no direction of its own, and the others are as without it.
        #[test]
        fn columns_without_direction_stay_without(n in 3_usize..10, at in 1_usize..9, dead: bool, seed in any::<u64>()) {
            let at = at.min(n - 1);
            let near: Vec<(f64, f64)> =
                (0..n).map(|k| if k == at { (0.0, if dead { 0.0 } else { 1.0 }) } else { (1.0, 1.0) }).collect();
            let a = columns(&near, seed);
            for backend in Backend::available() {
                let (_, got) = both(backend, &a, n);
                let got = got.expect("a few rows tell these columns");
                prop_assert!(got[at * n + at].abs() <= 1e-13 * inner(&a, at, at).sqrt());
                prop_assert!(error(&a, &got, n) < 1e-13);
            }
        }

        /// Rows unlike the few, or no numbers, are told or do no harm.
        #[test]
        fn bursts_are_told_or_harmless(n in 2_usize..10, row in 0..ROWS, digits in 0..14_i32, seed in any::<u64>()) {
            let mut a = columns(&vec![(1e-3, 1.0); n], seed);
            (0..n).for_each(|c| a[c * STRIDE + row] += 10_f64.powi(digits));
            for backend in Backend::available() {
                let (wanted, got) = both(backend, &a, n);
                if let Some(got) = got {
                    prop_assert!(error(&a, &got, n) < 10.0 * error(&a, &wanted, n) + 1e-13);
                }
                let mut broken = a.clone();
                broken[(n - 1) * STRIDE + row] = f64::NAN;
                prop_assert!(both(backend, &broken, n).1.is_none());
            }
        }
    }
}
