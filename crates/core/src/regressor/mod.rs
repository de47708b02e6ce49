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
use crate::simd::lane::MAX_WIDTH;
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
    motion.check(mechanism)?;
    let layout = mechanism.column_layout(motion.sets(), columns)?;
    let n = motion.samples;
    expect_length("out", out.len(), layout.entries * n)?;
    if columns.is_empty() {
        return Ok(());
    }
    let shared = SharedOutput::new(out);
    if layout.entries * n <= CACHED {
        for_each_part(mechanism, n, |part, workspace| {
            let whole = part.len() - part.len() % MAX_WIDTH;
            // SAFETY: parts are disjoint ranges of samples, inside every entry; these are whole lanes of one.
            unsafe {
                let runs = EntryRuns { first: shared.at(part.start), apart: n };
                rows(mechanism, motion, part.start, whole, &layout.in_place, runs, workspace);
                layout.zero.iter().for_each(|&entry| runs.at(entry).write_bytes(0, whole));
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mechanism::Joint;
    use crate::mechanism::closure::Closure;
    use crate::simd::dispatch::Backend;

    /// Four joints, one of them prismatic and one with its axis through the parent's origin, with all constant
    /// rotations.
    fn mechanism(backend: Backend) -> Mechanism {
        let (s, c) = 0.4_f64.sin_cos();
        let turns = [
            [c, -s, 0.0, s, c, 0.0, 0.0, 0.0, 1.0],
            [1.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 1.0, 0.0],
            [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, -1.0, 0.0],
            [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        ];
        let parents = [None, Some(0), Some(1), Some(1)];
        let joints: Vec<Joint> = (0..4)
            .map(|i| Joint {
                parent: parents[i],
                rotation: turns[i],
                translation: if i == 2 { [0.0; 3] } else { [0.1, -0.2, 0.3] },
                prismatic: i == 1,
            })
            .collect();
        Mechanism::new(&joints, &Closure::open(4), [0.0, 1.0, -9.81], &[], backend).expect("a tree")
    }

    /// Columns of the regressor at some samples; sample k is the same in every motion.
    fn columns(mechanism: &Mechanism, samples: Range<usize>, accelerations: bool, chosen: &[usize]) -> Vec<f64> {
        let number = |order: usize| -> Vec<f64> {
            let at = |a: usize, k: usize| ((7 * k + 11 * a) as f64 * 0.37 + order as f64).sin();
            (0..4).flat_map(|a| samples.clone().map(move |k| at(a, k))).collect()
        };
        let (position, velocity, acceleration) = (number(0), number(1), number(2));
        let motion = Motion {
            samples: samples.len(),
            position: &position,
            velocity: &velocity,
            acceleration: accelerations.then_some(&acceleration),
            external: &[],
            loops: &[],
        };
        let mut out = vec![f64::NAN; motion.sets() * 4 * chosen.len() * samples.len()];
        regressor(mechanism, &motion, chosen, &mut out).expect("shapes");
        out
    }

    #[test]
    fn a_column_is_the_same_whichever_others_are_wanted() {
        for backend in Backend::available() {
            let (mechanism, n) = (mechanism(backend), 37);
            let all: Vec<usize> = (0..40).collect();
            let sets = [vec![0, 1, 2, 4, 5, 6, 7], vec![5, 6, 7], vec![7, 6], vec![9, 0, 3], vec![8]];
            for accelerations in [true, false] {
                let whole = columns(&mechanism, 0..n, accelerations, &all);
                for set in &sets {
                    let chosen: Vec<usize> = (0..4).flat_map(|i| set.iter().map(move |p| 10 * i + p)).collect();
                    let some = columns(&mechanism, 0..n, accelerations, &chosen);
                    for (entry, run) in some.chunks_exact(n).enumerate() {
                        let (row, column) = (entry / chosen.len(), chosen[entry % chosen.len()]);
                        assert_eq!(run, &whole[(row * 40 + column) * n..][..n], "{backend:?} {row} {column}");
                    }
                }
            }
        }
    }

    #[test]
    fn a_sample_is_the_same_in_a_short_and_in_a_long_motion() {
        let (mechanism, long, short) = (mechanism(Backend::best()), 7001, 2999);
        let all: Vec<usize> = (0..40).collect();
        assert!(4 * all.len() * long > CACHED && 4 * all.len() * short <= CACHED);
        let whole = columns(&mechanism, 0..long, true, &all);
        for from in [0, 1234, long - short] {
            let part = columns(&mechanism, from..from + short, true, &all);
            for (part, whole) in part.chunks_exact(short).zip(whole.chunks_exact(long)) {
                assert_eq!(part, &whole[from..from + short]);
            }
        }
    }
}
