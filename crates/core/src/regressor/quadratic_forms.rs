//! Weights of the entries y of a row in the gradient of the quadratic form `y' F y`: `(F + F') y`.

use crate::memory::slot::BATCH;
use crate::simd::dispatch::dispatched;
use crate::simd::inlined;
use crate::simd::lane::Lane;
use crate::simd::token::Simd;

/// A form in the nonzero entries of a row, each multiplied by its factor.
pub(crate) struct QuadraticForm<'a> {
    /// `F + F'` of all columns, row-major.
    both: &'a [f64],
    /// Factors of all columns.
    factors: &'a [f64],
    /// Those columns that are not zero.
    nonzero: &'a [usize],
}

impl<'a> QuadraticForm<'a> {
    /// From `F + F'` of all columns, row-major, the factors of their entries, and which are not zero.
    pub(crate) fn new(both: &'a [f64], factors: &'a [f64], nonzero: &'a [usize]) -> QuadraticForm<'a> {
        assert!(both.len() == factors.len().pow(2) && nonzero.iter().all(|&c| c < factors.len()));
        QuadraticForm { both, factors, nonzero }
    }
}

dispatched! {
    /// Weights of a batch of a row's entries, run after run. The entries are multiplied by their factors.
    ///
    /// # Safety
    ///
    /// `entries` and `weights` have [`BATCH`] numbers for each of the form's nonzero columns, do not overlap, and nobody
    /// else uses them.
    pub(crate) unsafe fn quadratic_form_weights = quadratic_form_weights_in_lanes(form: &QuadraticForm, entries: *mut f64, weights: *mut f64)
}

#[inline(always)]
unsafe fn quadratic_form_weights_in_lanes<T: Lane>(
    simd: Simd<T>,
    form: &QuadraticForm,
    entries: *mut f64,
    weights: *mut f64,
) {
    for (run, &column) in form.nonzero.iter().enumerate() {
        let factor = form.factors[column];
        if factor == 1.0 {
            continue;
        }
        for k in (0..BATCH).step_by(T::WIDTH) {
            // SAFETY: the run is inside the entries that the caller promises.
            unsafe {
                let to = entries.add(run * BATCH + k);
                simd.load(to).mul(simd.splat(factor)).store(to);
            }
        }
    }
    // Weights, and lanes of each, that are computed together: as many as stay in sixteen registers, with the entries and
    // a number of the form. To spread that over a short lane takes as long as its products: there are more lanes for each.
    // SAFETY: the caller's promise, passed on.
    unsafe {
        match T::WIDTH {
            2 => weights_in_tiles::<T, 3, 4>(simd, form, entries, weights),
            _ => weights_in_tiles::<T, 6, 2>(simd, form, entries, weights),
        }
    }
}

#[inline(always)]
unsafe fn weights_in_tiles<T: Lane, const WEIGHTS: usize, const LANES: usize>(
    simd: Simd<T>,
    form: &QuadraticForm,
    entries: *const f64,
    weights: *mut f64,
) {
    let all = form.factors.len();
    for (first, own) in form.nonzero.chunks(WEIGHTS).enumerate() {
        // After the last column stands the first one of the tile, whose sums are discarded.
        let rows: [&[f64]; WEIGHTS] = inlined::from_fn(|e| &form.both[own.get(e).unwrap_or(&own[0]) * all..][..all]);
        for k in (0..BATCH).step_by(LANES * T::WIDTH) {
            let mut sums = [[simd.splat(0.0); LANES]; WEIGHTS];
            for (c, &column) in form.nonzero.iter().enumerate() {
                // SAFETY: run c and samples below BATCH are inside the entries that the caller promises.
                let run = unsafe { entries.add(c * BATCH + k) };
                // SAFETY: as above; BATCH is a multiple of LANES widths.
                let y: [T; LANES] = inlined::from_fn(|lane| unsafe { simd.load(run.add(lane * T::WIDTH)) });
                for (sums, row) in sums.iter_mut().zip(rows) {
                    // SAFETY: `new` has checked the columns.
                    let number = simd.splat(unsafe { *row.get_unchecked(column) });
                    for (sum, y) in sums.iter_mut().zip(y) {
                        *sum = y.fma(number, *sum);
                    }
                }
            }
            for (e, (&column, sums)) in own.iter().zip(sums).enumerate() {
                let factor = simd.splat(form.factors[column]);
                for (lane, sum) in sums.into_iter().enumerate() {
                    let to = (first * WEIGHTS + e) * BATCH + k + lane * T::WIDTH;
                    // SAFETY: column and samples are inside the weights that the caller promises.
                    unsafe { sum.mul(factor).store(weights.add(to)) };
                }
            }
        }
    }
}
