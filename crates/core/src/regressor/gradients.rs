//! Gradients with respect to every channel of a motion, sample by sample: of torques, and of quadratic forms in the
//! rows.
//!
//! A sample's rows depend on its own channels only, so that one reverse sweep gives all gradients (see
//! [`crate::regressor::adjoint`]).

use crate::batch::Batch;
use crate::batch::sink::EntryRuns;
use crate::error::{Error, expect_length};
use crate::mechanism::Mechanism;
use crate::mechanism::layout::check_columns;
use crate::mechanism::motion::Motion;
use crate::memory::shared::SharedOutput;
use crate::memory::slot::BATCH;
use crate::regressor::adjoint::{Weights, constant_axes, forward_sweep, reverse_sweep};
use crate::regressor::for_each_part;
use crate::regressor::gram::NonzeroEntries;
use crate::regressor::quadratic_forms::{QuadraticForm, quadratic_form_weights};
use crate::regressor::rows::{Kept, Workspace, torques};
use std::ops::Range;

/// Gradients of the torques of the chosen columns' parameters `chi`: `out[(r * channels + c) * samples + k]` of row r
/// with respect to channel c. Channels are in the order of [`Motion`]'s fields; the motion must have accelerations.
///
/// # Example
///
/// ```
/// # use haptid_core::*;
/// # let joint = Joint { parent: None, rotation: [1., 0., 0., 0., 1., 0., 0., 0., 1.], translation: [0.; 3], prismatic: false };
/// # let pendulum = Mechanism::new(&[joint], &Closure::open(1), [0., -9.81, 0.], &[], Backend::best())?;
/// # let motion = Motion {
/// #     samples: 3,
/// #     position: &[0., 1., 2.],
/// #     velocity: &[0., 0.5, 1.],
/// #     acceleration: Some(&[1., 0., -1.]),
/// #     external: &[],
/// #     loops: &[],
/// # };
/// // A pendulum of 2 kg at 0.5 m: ZZ = 0.5 kg m^2, MX = 1 kg m. Gravity acts along -y.
/// let mut out = [0.; 9];
/// torque_gradients(&pendulum, &motion, &[5, 6], &[0.5, 1.], &mut out)?;
/// // With respect to the acceleration, the last of three channels, it is ZZ.
/// assert!((out[6] - 0.5).abs() < 1e-12);
/// # Ok::<(), haptid_core::Error>(())
/// ```
pub fn torque_gradients(
    mechanism: &Mechanism,
    motion: &Motion,
    columns: &[usize],
    chi: &[f64],
    out: &mut [f64],
) -> Result<(), Error> {
    check(mechanism, motion, columns)?;
    expect_length("chi", chi.len(), columns.len())?;
    let (n, na, channels) = (motion.samples, mechanism.coordinates, mechanism.channels());
    expect_length("out", out.len(), na * channels * n)?;
    let mut run = vec![0; mechanism.columns()];
    columns.iter().enumerate().for_each(|(c, &column)| run[column] = c + 1);
    let of_row = |row: usize| Weights::new(mechanism, |a, column| if a == row { run[column] } else { 0 });
    let weights: Vec<Weights> = (0..na).map(of_row).collect();
    let shared = SharedOutput::new(out);
    for_each_part(mechanism, n, |part, workspace| {
        let tile = workspace.tile((columns.len() + 1) * BATCH);
        // SAFETY: the tile has just been given this size, and is initialised.
        let runs = unsafe { core::slice::from_raw_parts_mut(tile, (columns.len() + 1) * BATCH) };
        for (run, &weight) in runs.chunks_exact_mut(BATCH).zip([0.0].iter().chain(chi)) {
            run.fill(weight);
        }
        for samples in batches(part) {
            let Workspace { channels: at, slots, adjoint, .. } = &mut *workspace;
            at.advance_to(mechanism, motion, samples.start, samples.len());
            let batch = Batch { mechanism, channels: at, samples: samples.len() };
            // SAFETY: every run of weights has a batch; parts are disjoint ranges of samples, which only this call
            // writes.
            unsafe {
                forward_sweep(mechanism.backend, batch, slots);
                for (row, weights) in weights.iter().enumerate() {
                    reverse_sweep(batch, weights, tile, slots, adjoint);
                    adjoint.copy(mechanism, row * channels, shared, n, samples.clone());
                }
            }
        }
    });
    Ok(())
}

/// Gradients of the sum over rows and samples of `y' F y`: `out[c * samples + k]` with respect to channel c at sample
/// k. y are the chosen entries of a row at a sample, each multiplied by its factor, of coordinates x chosen; the form F
/// is chosen x chosen, row-major. The motion must have accelerations.
///
/// # Example
///
/// ```
/// # use haptid_core::*;
/// # let joint = Joint { parent: None, rotation: [1., 0., 0., 0., 1., 0., 0., 0., 1.], translation: [0.; 3], prismatic: false };
/// # let pendulum = Mechanism::new(&[joint], &Closure::open(1), [0., -9.81, 0.], &[], Backend::best())?;
/// # let motion = Motion {
/// #     samples: 3,
/// #     position: &[0., 1., 2.],
/// #     velocity: &[0., 0.5, 1.],
/// #     acceleration: Some(&[1., 0., -1.]),
/// #     external: &[],
/// #     loops: &[],
/// # };
/// // A pendulum; the form is the square of its column ZZ, which is the acceleration.
/// let mut out = [0.; 9];
/// quadratic_form_gradients(&pendulum, &motion, &[5], &[1.], &[1.], &mut out)?;
/// assert!((out[6] - 2.).abs() < 1e-12 && out[0] == 0.);
/// # Ok::<(), haptid_core::Error>(())
/// ```
pub fn quadratic_form_gradients(
    mechanism: &Mechanism,
    motion: &Motion,
    columns: &[usize],
    form: &[f64],
    factors: &[f64],
    out: &mut [f64],
) -> Result<(), Error> {
    check(mechanism, motion, columns)?;
    let (n, na, p) = (motion.samples, mechanism.coordinates, columns.len());
    expect_length("form", form.len(), p * p)?;
    expect_length("factors", factors.len(), na * p)?;
    expect_length("out", out.len(), mechanism.channels() * n)?;
    let entries = NonzeroEntries::new(mechanism, columns, factors);
    let weights = Weights::new(mechanism, |a, column| entries.run(a, column));
    let places = entries.entry_map(mechanism);
    let both: Vec<f64> = (0..p * p).map(|at| form[at] + form[at % p * p + at / p]).collect();
    let of_row = |row: usize| QuadraticForm::new(&both, &factors[row * p..][..p], &entries.nonzero[row]);
    let forms: Vec<QuadraticForm> = (0..na).map(of_row).collect();
    let shared = SharedOutput::new(out);
    for_each_part(mechanism, n, |part, workspace| {
        let tile = workspace.tile(2 * entries.count() * BATCH);
        for samples in batches(part) {
            // SAFETY: the tile has room for all runs of entries, and then of weights; parts are disjoint ranges of
            // samples.
            unsafe {
                let first = tile.add(entries.count() * BATCH);
                first.write_bytes(0, BATCH);
                let runs = EntryRuns { first: tile, apart: BATCH };
                let Workspace { channels: at, slots, adjoint, .. } = &mut *workspace;
                at.advance_to(mechanism, motion, samples.start, samples.len());
                let batch = Batch { mechanism, channels: at, samples: samples.len() };
                torques(mechanism.backend, batch, Kept::All, &places, runs, slots);
                for (row, form) in forms.iter().enumerate() {
                    let at = entries.row_runs(row).start * BATCH;
                    quadratic_form_weights(mechanism.backend, form, tile.add(at), first.add(at));
                }
                constant_axes(mechanism.backend, batch, slots);
                reverse_sweep(batch, &weights, first, slots, adjoint);
                adjoint.copy(mechanism, 0, shared, n, samples);
            }
        }
    });
    Ok(())
}

fn check(mechanism: &Mechanism, motion: &Motion, columns: &[usize]) -> Result<(), Error> {
    motion.check_accelerations(mechanism)?;
    check_columns(mechanism, columns)
}

/// Split samples into batches.
fn batches(samples: Range<usize>) -> impl Iterator<Item = Range<usize>> {
    samples.clone().step_by(BATCH).map(move |from| from..samples.end.min(from + BATCH))
}
