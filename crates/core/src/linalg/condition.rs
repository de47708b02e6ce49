//! Condition numbers of symmetric positive definite matrices, such as Gram matrices: by their extreme eigenvalues, and
//! smooth ones by norms.

use crate::error::{Error, expect_length};
use crate::linalg::square::{Square, invert, multiply, tridiagonal};
use crate::simd::dispatch::{Backend, dispatched};
use crate::simd::lane::{Lane, MAX_WIDTH};
use crate::simd::token::Simd;

/// More passes than 53 bits take, from intervals of the length of the matrix.
const MOST_PASSES: usize = 40;
/// Places of the points in an interval.
static STEPS: [f64; MAX_WIDTH] = [1., 2., 3., 4., 5., 6., 7., 8.];
/// Product of the traces of C and its inverse below which the inverse has digits enough.
const INVERTIBLE: f64 = 1e12;

/// The smallest and the largest eigenvalue of a symmetric n x n matrix, to rounding of the larger in magnitude; NaN where
/// an entry is not finite, or there is none.
///
/// # Example
///
/// ```
/// use haptid_core::{Backend, extreme_eigenvalues};
/// let [low, high] = extreme_eigenvalues(Backend::best(), &[2., 1., 1., 2.], 2)?;
/// assert!((low - 1.).abs() < 1e-15 && (high - 3.).abs() < 1e-15);
/// # Ok::<(), haptid_core::Error>(())
/// ```
pub fn extreme_eigenvalues(backend: Backend, matrix: &[f64], n: usize) -> Result<[f64; 2], Error> {
    expect_length("matrix", matrix.len(), n * n)?;
    if n == 0 || !matrix.iter().all(|x| x.is_finite()) {
        return Ok([f64::NAN; 2]);
    }
    let unit = unit(matrix);
    let (mut diagonal, mut beside) = (vec![0.0; n], vec![0.0; n]);
    tridiagonal(backend, &mut Square::of(matrix, n, 1.0 / unit), &mut diagonal, &mut beside);
    Ok(extremes(backend, &diagonal, &beside).map(|x| x * unit))
}

/// A power of two near the largest entry: in this unit squares neither overflow nor vanish, and nothing is rounded.
fn unit(matrix: &[f64]) -> f64 {
    let size = matrix.iter().fold(f64::MIN_POSITIVE, |size: f64, x| size.max(x.abs()));
    2.0_f64.powi(size.log2().floor().clamp(-1000.0, 1000.0) as i32)
}

/// Extreme eigenvalues of a tridiagonal matrix; `beside` ends with a zero.
fn extremes(backend: Backend, diagonal: &[f64], beside: &[f64]) -> [f64; 2] {
    let mut least = [f64::INFINITY; 2];
    let mut most = [f64::NEG_INFINITY; 2];
    let mut before = 0.0;
    for (&d, &e) in diagonal.iter().zip(beside) {
        // Gershgorin's discs on one side, an entry of the diagonal on the other.
        let radius = e.abs() + before;
        least = [least[0].min(d - radius), least[1].min(d)];
        most = [most[0].max(d), most[1].max(d + radius)];
        before = e.abs();
    }
    let mut found = [least, most];
    // No more is known of the eigenvalues than rounding leaves; each pass divides the intervals by 5 or 9.
    for _ in 0..MOST_PASSES {
        if found.iter().all(|[low, high]| high - low <= f64::EPSILON * most[1].abs().max(least[0].abs())) {
            break;
        }
        divide(backend, diagonal, beside, &mut found);
    }
    found.map(|[low, high]| 0.5 * (low + high))
}

dispatched! {
    /// Divide the intervals of the smallest and of the largest eigenvalue at as many points as a lane has: the pivots of
    /// the matrix less a point are all positive below the smallest, and all negative above the largest (Sturm's
    /// sequence: Golub and Van Loan 2013, section 8.4.1).
    fn divide = divide_in_lanes(diagonal: &[f64], beside: &[f64], intervals: &mut [[f64; 2]; 2])
}

#[inline(always)]
fn divide_in_lanes<T: Lane>(simd: Simd<T>, diagonal: &[f64], beside: &[f64], intervals: &mut [[f64; 2]; 2]) {
    // SAFETY: there are as many steps as the widest lane has numbers.
    let steps = unsafe { simd.load(STEPS.as_ptr()) };
    let points = |[low, high]: [f64; 2]| {
        let step = simd.splat((high - low) / (T::WIDTH + 1) as f64);
        steps.fma(step, simd.splat(low))
    };
    let [low, high] = [points(intervals[0]), points(intervals[1])];
    let [mut below, mut above] = [simd.splat(1.0), simd.splat(1.0)];
    let (mut least, mut most) = (simd.splat(f64::INFINITY), simd.splat(f64::NEG_INFINITY));
    let mut square = simd.splat(0.0);
    for (&d, &e) in diagonal.iter().zip(beside) {
        let d = simd.splat(d);
        (below, above) = (d.sub(low).sub(square.div(below)), d.sub(high).sub(square.div(above)));
        least = T::select_gt(least, below, below, least);
        most = T::select_gt(above, most, above, most);
        // A pivot of zero gives an infinite one, which is right; zero over zero would not be a number.
        square = simd.splat((e * e).max(f64::MIN_POSITIVE));
    }
    let passed = [
        (low, T::select_gt(simd.splat(0.0), least, simd.splat(1.0), simd.splat(0.0))),
        (high, T::select_gt(simd.splat(0.0), most, simd.splat(1.0), simd.splat(0.0))),
    ];
    for (interval, (points, passed)) in intervals.iter_mut().zip(passed) {
        let (mut at, mut is) = ([0.0; MAX_WIDTH], [0.0; MAX_WIDTH]);
        // SAFETY: the arrays have room for the widest lane.
        unsafe {
            points.store(at.as_mut_ptr());
            passed.store(is.as_mut_ptr());
        }
        let first = is[..T::WIDTH].iter().position(|&is| is == 1.0);
        let [low, high] = *interval;
        *interval = match first {
            Some(0) => [low, at[0]],
            Some(k) => [at[k - 1], at[k]],
            None => [at[T::WIDTH - 1], high],
        };
    }
}

/// Logarithm of a smooth condition number of W from C = W'W: half of that of the norms of C and of its inverse,
/// `(tr C^power tr C^-power)^(1 / power)`; and its derivative with respect to C, n x n, to `slope`. None where C is not
/// positive definite, or nearly singular.
///
/// # Example
///
/// ```
/// use haptid_core::{Backend, smooth_condition};
/// let mut slope = [0.; 4];
/// let cost = smooth_condition(Backend::best(), &[1., 0., 0., 4.], 2, 1, &mut slope)?;
/// // Traces of 5 and 1.25.
/// assert!((cost.unwrap() - 6.25_f64.ln() / 2.).abs() < 1e-15 && slope[1] == 0.);
/// # Ok::<(), haptid_core::Error>(())
/// ```
pub fn smooth_condition(
    backend: Backend,
    matrix: &[f64],
    n: usize,
    power: usize,
    slope: &mut [f64],
) -> Result<Option<f64>, Error> {
    expect_length("matrix", matrix.len(), n * n)?;
    expect_length("slope", slope.len(), n * n)?;
    if power == 0 {
        return Err(Error::Value { name: "power", got: 0.0, wanted: "at least 1" });
    }
    let unit = unit(matrix);
    let (c, mut inverse, mut definite) = (Square::of(matrix, n, 1.0 / unit), Square::of(matrix, n, 1.0 / unit), true);
    invert(backend, &mut inverse, &mut definite);
    let spread = c.trace() * inverse.trace();
    if !definite || spread.is_nan() || spread >= INVERTIBLE {
        return Ok(None);
    }
    let (up, down) = (raised(backend, &c, power - 1), raised(backend, &inverse, power - 1));
    let (large, small) = (up.inner(&c), down.inner(&inverse));
    // The trace of C^-power changes with C as -power C^-(power + 1) does.
    let [mut once, mut twice] = [Square::zeros(n), Square::zeros(n)];
    multiply(backend, &down, &inverse, &mut once);
    multiply(backend, &once, &inverse, &mut twice);
    let (above, below) = (0.5 / large / unit, 0.5 / small / unit);
    let columns = up.columns().zip(twice.columns());
    for (slope, (up, down)) in slope.chunks_exact_mut(n.max(1)).zip(columns) {
        for (slope, (up, down)) in slope.iter_mut().zip(up.iter().zip(down)) {
            *slope = up * above - down * below;
        }
    }
    Ok(Some((large * small).ln() / (2 * power) as f64))
}

/// A power of a matrix.
fn raised(backend: Backend, matrix: &Square, power: usize) -> Square {
    let mut made = if power == 0 { Square::diagonal(matrix.size(), 1.0) } else { matrix.clone() };
    let mut next = Square::zeros(matrix.size());
    for _ in 1..power {
        multiply(backend, &made, matrix, &mut next);
        core::mem::swap(&mut made, &mut next);
    }
    made
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::linalg::draws;
    use proptest::prelude::*;

    /// Reflections of a diagonal matrix, one after the other: its eigenvalues are known.
    fn turned(eigenvalues: &[f64], seed: u64) -> Vec<f64> {
        let n = eigenvalues.len();
        let mut draw = draws(seed);
        let mut a: Vec<f64> = (0..n * n).map(|k| if k % (n + 1) == 0 { eigenvalues[k / n] } else { 0.0 }).collect();
        for _ in 0..3 {
            let v: Vec<f64> = (0..n).map(|_| draw()).collect();
            let weight = 2.0 / v.iter().map(|x| x * x).sum::<f64>();
            let product = |a: &[f64], k: usize| -> f64 { (0..n).map(|i| a[k * n + i] * v[i]).sum() };
            let p: Vec<f64> = (0..n).map(|k| weight * product(&a, k)).collect();
            let along = 0.5 * weight * p.iter().zip(&v).map(|(p, v)| p * v).sum::<f64>();
            let w: Vec<f64> = p.iter().zip(&v).map(|(p, v)| p - along * v).collect();
            (0..n * n).for_each(|k| a[k] -= v[k / n] * w[k % n] + w[k / n] * v[k % n]);
        }
        a
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: 24, failure_persistence: None, ..ProptestConfig::default() })]

        /// Of any sizes and signs, some of them equal.
        #[test]
        fn extreme_eigenvalues_are_those_that_were_turned(
            digits in prop::collection::vec((-12..1_i32, any::<bool>()), 1..50),
            scale in prop::sample::select(vec![-150, 0, 150]),
            seed in any::<u64>(),
        ) {
            let unit = 10_f64.powi(scale);
            let known: Vec<f64> =
                digits.iter().map(|&(d, minus)| unit * 10_f64.powi(d) * if minus { -1.0 } else { 1.0 }).collect();
            let a = turned(&known, seed);
            let wanted = [known.iter().copied().fold(f64::INFINITY, f64::min), known.iter().copied().fold(f64::NEG_INFINITY, f64::max)];
            let size = wanted[0].abs().max(wanted[1].abs());
            for backend in Backend::available() {
                let found = extreme_eigenvalues(backend, &a, known.len()).expect("shapes");
                for (found, wanted) in found.iter().zip(wanted) {
                    prop_assert!((found - wanted).abs() < 2e-15 * known.len() as f64 * size, "{:?} {} {}", backend, found, wanted);
                }
            }
        }

        /// The traces of powers of known eigenvalues, and differences of the cost along a matrix.
        #[test]
        fn smooth_conditions_are_those_of_the_eigenvalues(
            digits in prop::collection::vec(-2.0..2.0, 1..50),
            power in prop::sample::select(vec![1_usize, 2, 3, 4, 8]),
            seed in any::<u64>(),
        ) {
            let (n, known) = (digits.len(), digits.iter().map(|&d: &f64| 10_f64.powf(d)).collect::<Vec<_>>());
            let (a, along) = (turned(&known, seed), turned(&vec![1.0; n], seed ^ 1));
            let trace = |sign: i32| -> f64 { known.iter().map(|x| x.powi(sign * power as i32)).sum() };
            let wanted = (trace(1) * trace(-1)).ln() / (2 * power) as f64;
            let least = known.iter().copied().fold(f64::INFINITY, f64::min);
            for backend in Backend::available() {
                let mut slope = vec![f64::NAN; n * n];
                let cost = smooth_condition(backend, &a, n, power, &mut slope).expect("shapes").expect("far from singular");
                prop_assert!((cost - wanted).abs() < 1e-10, "{:?} {} {}", backend, cost, wanted);
                let moved = |by: f64| {
                    let near: Vec<f64> = a.iter().zip(&along).map(|(a, along)| a + by * along).collect();
                    smooth_condition(backend, &near, n, power, &mut vec![0.0; n * n]).expect("shapes").expect("near")
                };
                let step = 1e-4 * least;
                let got: f64 = slope.iter().zip(&along).map(|(slope, along)| slope * along).sum();
                let difference = (moved(step) - moved(-step)) / (2.0 * step);
                prop_assert!((got - difference).abs() < 1e-5 * (1.0 / least), "{:?} {} {}", backend, got, difference);
            }
        }
    }

    #[test]
    fn entries_that_are_next_to_nothing_change_no_eigenvalue() {
        for (backend, digits) in Backend::available().into_iter().flat_map(|b| (50..200).map(move |d| (b, -d))) {
            let e = 10_f64.powi(digits);
            let [low, high] = extreme_eigenvalues(backend, &[1., e, 0., e, 2., e, 0., e, 5.], 3).expect("shapes");
            assert!((low - 1.0).abs() < 1e-14 && (high - 5.0).abs() < 1e-14, "{backend:?} {e} {low} {high}");
        }
    }

    #[test]
    fn smooth_conditions_are_the_same_in_all_units() {
        let cost = |backend, unit: f64, slope: &mut [f64]| {
            let matrix = [2.0, 1.0, 1.0, 3.0].map(|x| x * unit);
            smooth_condition(backend, &matrix, 2, 8, slope).expect("shapes").expect("far from singular")
        };
        for backend in Backend::available() {
            let (mut wanted, mut slope) = ([0.0; 4], [0.0; 4]);
            let plain = cost(backend, 1.0, &mut wanted);
            for exponent in [-600, 600] {
                let unit = 2.0_f64.powi(exponent);
                assert_eq!(cost(backend, unit, &mut slope), plain);
                assert_eq!(slope.map(|x| x * unit), wanted);
            }
        }
    }

    #[test]
    fn what_has_no_condition_is_told() {
        for backend in Backend::available() {
            let [low, high] = extreme_eigenvalues(backend, &[1.0, f64::NAN, f64::NAN, 1.0], 2).expect("shapes");
            assert!(low.is_nan() && high.is_nan());
            assert_eq!(extreme_eigenvalues(backend, &[0.0; 4], 2), Ok([0.0; 2]));
            for singular in [[1.0, 1.0, 1.0, 1.0], [1.0, 2.0, 2.0, 1.0], [1.0, f64::NAN, f64::NAN, 1.0], [0.0; 4]] {
                assert_eq!(smooth_condition(backend, &singular, 2, 2, &mut [0.0; 4]), Ok(None));
            }
        }
    }
}
