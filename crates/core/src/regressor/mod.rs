//! Regressor: its rows over whole motions, their gradients and Gram matrices.

pub(crate) mod adjoint;
pub(crate) mod gradients;
pub(crate) mod gram;
pub(crate) mod momentum;
pub(crate) mod quadratic_forms;
pub(crate) mod rows;

use crate::batch::sink::EntryRuns;
use crate::error::{Error, expect_length};
use crate::mechanism::Mechanism;
use crate::mechanism::layout::ColumnLayout;
use crate::mechanism::motion::{Motion, PART};
use crate::memory::shared::SharedOutput;
use crate::memory::stream;
use crate::regressor::rows::{Workspace, rows};
use crate::simd::dispatch::dispatched;
use crate::simd::lane::{Lane, MAX_WIDTH};
use crate::simd::token::Simd;
use core::mem::MaybeUninit;
use rayon::prelude::*;
use std::ops::Range;

/// The regressor of every sample, `out[(r * chosen + c) * samples + k]`, for row r (coordinates, set after set, see
/// [`Motion::sets`]), chosen column c and sample k.
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
/// // A pendulum; its columns ZZ and MX at three samples. Gravity acts along -y.
/// let mut out = [0.; 6];
/// regressor(&pendulum, &motion, &[5, 6], &mut out)?;
/// assert!((out[0] - 1.).abs() < 1e-12 && (out[3] - 9.81).abs() < 1e-12);
/// # Ok::<(), haptid_core::Error>(())
/// ```
pub fn regressor(mechanism: &Mechanism, motion: &Motion, columns: &[usize], out: &mut [f64]) -> Result<(), Error> {
    let numbers = out.len();
    write(mechanism, motion, columns, (SharedOutput::new(out), numbers), true)
}

/// As [`regressor`], into memory that need not be initialised: every number is written, and none is read.
///
/// # Example
///
/// ```
/// # use haptid_core::*;
/// # let joint = Joint { parent: None, rotation: [1., 0., 0., 0., 1., 0., 0., 0., 1.], translation: [0.; 3], prismatic: false };
/// # let pendulum = Mechanism::new(&[joint], &Closure::open(1), [0., -9.81, 0.], &[], Backend::best())?;
/// # let motion =
/// #     Motion { samples: 1, position: &[0.], velocity: &[0.], acceleration: Some(&[1.]), external: &[], loops: &[] };
/// let mut out = Vec::with_capacity(2);
/// new_regressor(&pendulum, &motion, &[5, 6], &mut out.spare_capacity_mut()[..2])?;
/// // SAFETY: both numbers have been written.
/// unsafe { out.set_len(2) };
/// assert_eq!(out, [1., 9.81]);
/// # Ok::<(), haptid_core::Error>(())
/// ```
pub fn new_regressor(
    mechanism: &Mechanism,
    motion: &Motion,
    columns: &[usize],
    out: &mut [MaybeUninit<f64>],
) -> Result<(), Error> {
    let numbers = out.len();
    write(mechanism, motion, columns, (SharedOutput::new_uninitialised(out), numbers), false)
}

/// Write the regressor; `filled` tells that the output is initialised.
fn write(
    mechanism: &Mechanism,
    motion: &Motion,
    columns: &[usize],
    (shared, numbers): (SharedOutput, usize),
    filled: bool,
) -> Result<(), Error> {
    motion.check(mechanism)?;
    let layout = mechanism.column_layout(motion.sets(), columns)?;
    let n = motion.samples;
    expect_length("out", numbers, layout.entries * n)?;
    if columns.is_empty() {
        return Ok(());
    }
    if layout.entries * n <= CACHED {
        for_each_part(mechanism, n, |part, workspace| {
            let whole = part.len() - part.len() % MAX_WIDTH;
            // SAFETY: parts are disjoint ranges of samples, inside every entry; these are whole lanes of one.
            unsafe {
                let runs = EntryRuns { first: shared.at(part.start), apart: n };
                rows(mechanism, motion, part.start, whole, &layout.in_place, runs, workspace);
                match filled {
                    true => clear(mechanism.backend, &layout.zero, runs, whole),
                    false => layout.zero.iter().for_each(|&entry| runs.at(entry).write_bytes(0, whole)),
                }
                tiled(mechanism, motion, &layout, part.start + whole..part.end, shared, workspace);
            }
        });
    } else {
        for_each_part(mechanism, n, |part, workspace| {
            // SAFETY: parts are disjoint ranges of samples, inside every entry.
            unsafe { tiled(mechanism, motion, &layout, part, shared, workspace) };
        });
    }
    Ok(())
}

dispatched! {
    /// Make `count` numbers of each of these runs zero. An output that an earlier call has filled has zeros there, and to
    /// read them takes half the time of writing them.
    ///
    /// # Safety
    ///
    /// Every run has this many numbers, all initialised, and nobody else uses them meanwhile.
    unsafe fn clear = clear_in_lanes(zero: &[usize], runs: EntryRuns, count: usize)
}

#[inline(always)]
unsafe fn clear_in_lanes<T: Lane>(_: Simd<T>, zero: &[usize], runs: EntryRuns, count: usize) {
    for &entry in zero {
        // SAFETY: the caller's promise.
        let run = unsafe { core::slice::from_raw_parts_mut(runs.at(entry), count) };
        // Without a branch in the loop it takes one instruction for a lane; -0 and NaN have bits.
        let mut bits = 0;
        for x in run.iter() {
            bits |= x.to_bits();
        }
        if bits != 0 {
            run.fill(0.0);
        }
    }
}

/// A regressor of at most this many numbers stays in the caches and is written in place; a larger one is written
/// through a tile.
const CACHED: usize = 1 << 20;

/// Compute some samples of the regressor in a tile, and copy them to memory in long runs.
///
/// # Safety
///
/// `out` has `motion.samples` numbers for every entry, and nobody else uses those of these samples.
unsafe fn tiled(
    mechanism: &Mechanism,
    motion: &Motion,
    layout: &ColumnLayout,
    samples: Range<usize>,
    out: SharedOutput,
    workspace: &mut Workspace,
) {
    if samples.is_empty() {
        return;
    }
    let tile = EntryRuns { first: workspace.tile(layout.nonzero.len() * RUN), apart: RUN };
    for from in samples.clone().step_by(TILE) {
        let count = TILE.min(samples.end - from);
        // SAFETY: every run of the tile has room for a tile and a lane; the caller promises those of `out`.
        unsafe {
            rows(mechanism, motion, from, count, &layout.packed, tile, workspace);
            let send = |run: *const f64, entry: usize| {
                stream::copy(mechanism.backend, run, out.at(entry * motion.samples + from), count);
            };
            layout.nonzero.iter().enumerate().for_each(|(index, &entry)| send(tile.at(index), entry));
            layout.zero.iter().for_each(|&entry| send(ZEROS.as_ptr(), entry));
        }
    }
    stream::fence();
}

/// Do the work for every part of some samples, on one thread where they are few.
pub(crate) fn for_each_part(mechanism: &Mechanism, samples: usize, work: impl Fn(Range<usize>, &mut Workspace) + Sync) {
    let part = |k: usize| k * PART..samples.min((k + 1) * PART);
    let parts = samples.div_ceil(PART);
    if parts <= 2 {
        Workspace::with(mechanism, |workspace| (0..parts).for_each(|k| work(part(k), workspace)));
    } else {
        (0..parts).into_par_iter().for_each(|k| Workspace::with(mechanism, |workspace| work(part(k), workspace)));
    }
}

/// Samples per tile, and the distance of its runs: a multiple of 4 KiB would map them to the same cache sets.
const TILE: usize = 128;
const RUN: usize = TILE + MAX_WIDTH;
static ZEROS: [f64; TILE] = [0.0; TILE];
