//! Weights of the entries y of a row in the gradient of the quadratic form `y' F y`: `(F + F') y`.

use crate::memory::slot::BATCH;
use crate::simd::dispatch::dispatched;
use crate::simd::lane::Lane;
use crate::simd::token::Simd;

/// Weights, and lanes of each, that are computed together: as many as stay in sixteen registers, with the entries and a
/// factor.
const PANEL: usize = 6;
const LANES: usize = 2;

/// `F + F'` for the nonzero columns of a row, in panels of its rows, column after column.
pub(crate) struct QuadraticForm {
    columns: usize,
    panels: Vec<[f64; PANEL]>,
}

impl QuadraticForm {
    /// From `F + F'` of all columns, row-major, and the factors of their entries.
    pub(crate) fn new(both: &[f64], factors: &[f64], nonzero: &[usize]) -> QuadraticForm {
        let (all, count) = (factors.len(), nonzero.len());
        let mut panels = vec![[0.0; PANEL]; nonzero.chunks(PANEL).len() * count];
        for (rows, panel) in nonzero.chunks(PANEL).zip(panels.chunks_exact_mut(count.max(1))) {
            for (e, &r) in rows.iter().enumerate() {
                let (row, own) = (&both[r * all..][..all], factors[r]);
                panel.iter_mut().zip(nonzero).for_each(|(panel, &c)| panel[e] = own * factors[c] * row[c]);
            }
        }
        QuadraticForm { columns: count, panels }
    }
}

dispatched! {
    /// Weights of a batch of a row's entries, run after run.
    ///
    /// # Safety
    ///
    /// `entries` and `weights` have [`BATCH`] numbers for each of the form's columns, do not overlap, and nobody else
    /// uses the weights.
    pub(crate) unsafe fn quadratic_form_weights = quadratic_form_weights_in_lanes(form: &QuadraticForm, entries: *const f64, weights: *mut f64)
}

#[inline(always)]
unsafe fn quadratic_form_weights_in_lanes<T: Lane>(
    simd: Simd<T>,
    form: &QuadraticForm,
    entries: *const f64,
    weights: *mut f64,
) {
    let columns = form.columns.max(1);
    for (first, panel) in form.panels.chunks_exact(columns).enumerate() {
        for k in (0..BATCH).step_by(LANES * T::WIDTH) {
            let mut sums = [[simd.splat(0.0); LANES]; PANEL];
            for (c, factors) in panel.iter().enumerate() {
                // SAFETY: column c and samples below BATCH are inside the entries that the caller promises.
                let run = unsafe { entries.add(c * BATCH + k) };
                // SAFETY: as above; BATCH is a multiple of LANES widths.
                let y: [T; LANES] = core::array::from_fn(|lane| unsafe { simd.load(run.add(lane * T::WIDTH)) });
                for (sums, &factor) in sums.iter_mut().zip(factors) {
                    let factor = simd.splat(factor);
                    for (sum, y) in sums.iter_mut().zip(y) {
                        *sum = y.fma(factor, *sum);
                    }
                }
            }
            for (column, sums) in (first * PANEL..form.columns).zip(sums) {
                for (lane, sum) in sums.into_iter().enumerate() {
                    // SAFETY: column and samples are inside the weights that the caller promises.
                    unsafe { sum.store(weights.add(column * BATCH + k + lane * T::WIDTH)) };
                }
            }
        }
    }
}
