//! Reduction: rows are computed, filtered, decimated and folded into one triangle per motor and time block, in one
//! pass.

use crate::error::{Error, expect_length};
use crate::linalg::preconditioned_gram::Preconditioner;
use crate::linalg::tsqr::merge;
use crate::mechanism::Mechanism;
use crate::mechanism::layout::{check_columns, structural_nonzeros};
use crate::mechanism::motion::Motion;
use crate::reduction::fir::FirFilter;
use crate::reduction::reducer::{Reducer, Task};
use crate::regressor::rows::Workspace;
use rayon::prelude::*;
use std::ops::Range;

/// Starting threads costs more than the work on this many samples.
const SINGLE_THREAD: usize = 2000;
/// Rows of a long block that are reduced as one task; the triangles of a block's tasks are merged.
const PIECE: usize = 2048;
/// What to reduce, and into which blocks.
#[derive(Debug, Clone, Copy)]
pub struct Reduction<'a> {
    /// The chosen columns of the regressor.
    pub columns: &'a [usize],
    /// Torques, coordinates x samples, channel major, N m or N.
    pub torque: &'a [f64],
    /// Taps of the FIR filter, odd in number; `[1.0]` for none.
    pub taps: &'a [f64],
    /// Taps that give the derivative of the filtered momenta, as many as `taps`, for a motion without accelerations;
    /// empty otherwise.
    pub derivative_taps: &'a [f64],
    /// Samples from one row to the next.
    pub decimation: usize,
    /// Sample at the centre of the first row; row r is centred `decimation * r` samples later.
    pub first: usize,
    /// Number of rows per motor.
    pub rows: usize,
    /// Rows per time block; the last block may have fewer.
    pub block: usize,
    /// Weights of the rows, coordinates x rows, channel major; zero drops a row. Empty for all ones.
    pub weights: &'a [f64],
}

/// R factors of one motor.
#[derive(Debug, Clone, PartialEq)]
pub struct RFactors {
    /// Indices of the chosen columns that are not structurally zero for this motor, ascending; the torque is the last
    /// column of each factor.
    pub columns: Vec<usize>,
    /// Per block an upper triangle [R z; 0 rest], row-major, (columns + 1) x (columns + 1).
    pub blocks: Vec<Vec<f64>>,
}

/// Reduce a motion to one R factor per coordinate and time block. The result does not depend on the number of threads.
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
/// # let chi = [0., 0., 0., 0., 0., 0.5, 1., 0., 0., 2.];
/// # let mut torque = [0.; 3];
/// # inverse_dynamics(&pendulum, &motion, &chi, &mut torque)?;
/// // A pendulum whose torques its columns ZZ and MX explain exactly: three rows, in one block.
/// let reduction = Reduction {
///     columns: &[5, 6],
///     torque: &torque,
///     taps: &[1.],
///     derivative_taps: &[],
///     decimation: 1,
///     first: 0,
///     rows: 3,
///     block: 3,
///     weights: &[],
/// };
/// let factors = reduce(&pendulum, &motion, &reduction)?;
/// // [R z; 0 rest], and the rest is zero.
/// assert!(factors[0].blocks[0][8].abs() < 1e-12);
/// # Ok::<(), haptid_core::Error>(())
/// ```
pub fn reduce(mechanism: &Mechanism, motion: &Motion, reduction: &Reduction) -> Result<Vec<RFactors>, Error> {
    let filter = check(mechanism, motion, reduction)?;
    let nonzero = structural_nonzeros(mechanism, reduction.columns)?;
    let p = reduction.columns.len();
    let nonzero: Vec<Vec<usize>> =
        (0..mechanism.coordinates()).map(|a| (0..p).filter(|&c| nonzero[a * p + c]).collect()).collect();
    let task = Task { mechanism, motion, reduction, filter: &filter, nonzero: &nonzero };
    let mut blocks = (0..reduction.rows)
        .step_by(reduction.block)
        .map(|begin| {
            let rows = begin..begin.saturating_add(reduction.block).min(reduction.rows);
            Ok(Block { routes: routes(task, &rows)?, rows, factors: Vec::new() })
        })
        .collect::<Result<Vec<Block>, Error>>()?;
    reduce_blocks(task, blocks.iter_mut().collect());
    // What a Gram matrix lost is computed again, by reflections.
    let mut lost = Vec::new();
    for block in blocks.iter_mut().filter(|block| block.factors.iter().any(Option::is_none)) {
        block.routes.clear();
        lost.push(block);
    }
    reduce_blocks(task, lost);
    let factors = |a: usize, columns: &Vec<usize>| {
        let of_block = |block: &Block| block.factors[a].as_ref().map(|r| transpose(r, columns.len() + 1));
        RFactors { columns: columns.clone(), blocks: blocks.iter().filter_map(of_block).collect() }
    };
    Ok(nonzero.iter().enumerate().map(|(a, columns)| factors(a, columns)).collect())
}

/// A time block: its rows, how each motor's are reduced (by reflections where there is no preconditioner), and the R
/// factors, column-major; `None` where the Gram matrix lost too much.
struct Block {
    rows: Range<usize>,
    routes: Vec<Option<Preconditioner>>,
    factors: Vec<Option<Vec<f64>>>,
}

/// Compute the factors of some blocks.
fn reduce_blocks(task: Task, mut blocks: Vec<&mut Block>) {
    // Long blocks are several tasks, so that they are divided among threads too.
    let tasks = |block: &Block| {
        let (end, of_block) = (block.rows.end, block.rows.clone().step_by(PIECE));
        of_block.map(move |from| from..end.min(from + PIECE)).collect::<Vec<_>>()
    };
    let pieces: Vec<(usize, Range<usize>)> =
        blocks.iter().enumerate().flat_map(|(b, block)| tasks(block).into_iter().map(move |rows| (b, rows))).collect();
    let samples = task.reduction.decimation * pieces.iter().map(|(_, rows)| rows.len()).sum::<usize>();
    let threads = threads(samples);
    // Several parts per thread balance the load; each part reads one window more than its own samples.
    let parts = if threads == 1 { 1 } else { (4 * threads).min(pieces.len().max(1)) };
    let run = |k: usize| {
        Workspace::with(task.mechanism, |workspace| {
            let mut reducer = Reducer::new(task, workspace);
            let part = &pieces[k * pieces.len() / parts..(k + 1) * pieces.len() / parts];
            part.iter().map(|(b, rows)| reducer.piece(rows.clone(), &blocks[*b].routes)).collect::<Vec<_>>()
        })
    };
    let done: Vec<Vec<Vec<Vec<f64>>>> =
        if parts == 1 { vec![run(0)] } else { (0..parts).into_par_iter().map(run).collect() };
    let mut parts: Vec<Vec<Vec<Vec<f64>>>> = vec![Vec::new(); blocks.len()];
    for ((b, _), factors) in pieces.iter().zip(done.into_iter().flatten()) {
        parts[*b].push(factors);
    }
    for (block, parts) in blocks.iter_mut().zip(parts) {
        let routes = &block.routes;
        block.factors = of_motors(threads, task.nonzero.len(), |a| {
            let own = parts.iter().map(|part| &part[a]);
            match routes.get(a).and_then(Option::as_ref) {
                Some(preconditioner) => preconditioner.r_factor(&sum(own)),
                None => Some(merged(task, own, task.nonzero[a].len() + 1)),
            }
        });
    }
}

/// Threads that share the work on this many samples.
fn threads(samples: usize) -> usize {
    if samples < SINGLE_THREAD { 1 } else { rayon::current_num_threads() }
}

/// Do the work for each motor, shared by the threads: the factors of a long block would be a fifth of its time.
fn of_motors<X: Send>(threads: usize, motors: usize, work: impl Fn(usize) -> X + Sync) -> Vec<X> {
    match threads {
        1 => (0..motors).map(work).collect(),
        _ => (0..motors).into_par_iter().map(&work).collect(),
    }
}

/// The sum of matrices of one size, in order.
fn sum<'a>(matrices: impl Iterator<Item = &'a Vec<f64>>) -> Vec<f64> {
    let add = |mut total: Vec<f64>, one: &Vec<f64>| {
        total.iter_mut().zip(one).for_each(|(total, x)| *total += x);
        total
    };
    let mut matrices = matrices;
    let first = matrices.next().cloned().unwrap_or_default();
    matrices.fold(first, add)
}

/// One triangle from several of this size, in order.
fn merged<'a>(task: Task, triangles: impl Iterator<Item = &'a Vec<f64>>, size: usize) -> Vec<f64> {
    let (mut triangles, mut rows) = (triangles, Vec::new());
    let mut first = triangles.next().cloned().unwrap_or_default();
    triangles.for_each(|other| merge(task.mechanism.backend, &mut first, other, size, &mut rows));
    first
}

/// Rows by which a preconditioner is chosen, for each column, and at least; a block is worth one if it is longer than
/// `WORTH` times these.
const FEW: usize = 3;
const LEAST_FEW: usize = 128;
const WORTH: usize = 8;

/// How each motor's rows of a block are reduced: by a preconditioned Gram matrix where the block is long, nothing is
/// filtered, and a few of its rows tell a preconditioner.
fn routes(task: Task, block: &Range<usize>) -> Result<Vec<Option<Preconditioner>>, Error> {
    let Task { mechanism, motion, reduction, filter, nonzero } = task;
    let few = LEAST_FEW.max(FEW * nonzero.iter().map(|columns| columns.len() + 1).max().unwrap_or(0));
    if !filter.is_identity() || block.len() < WORTH * few {
        return Ok(Vec::new());
    }
    // Multiples of the golden section spread over the block, and are in step with no period of the motion.
    let spread = |k: usize| block.start + ((k as f64 * 0.618_033_988_749_895).fract() * block.len() as f64) as usize;
    let mut at: Vec<usize> = (0..few).map(spread).collect();
    at.sort_unstable();
    let samples: Vec<usize> = at.iter().map(|row| reduction.first + row).collect();
    let picked = |channels: &[f64], length: usize, at: &[usize]| -> Vec<f64> {
        channels.chunks_exact(length.max(1)).flat_map(|channel| at.iter().map(|&k| channel[k])).collect()
    };
    let of_motion = |channels: &[f64]| picked(channels, motion.samples, &samples);
    let (position, velocity) = (of_motion(motion.position), of_motion(motion.velocity));
    let (acceleration, external) = (motion.acceleration.map(of_motion), of_motion(motion.external));
    let (loops, torque) = (of_motion(motion.loops), of_motion(reduction.torque));
    let weights = picked(reduction.weights, reduction.rows, &at);
    let some = Motion {
        samples: few,
        position: &position,
        velocity: &velocity,
        acceleration: acceleration.as_deref(),
        external: &external,
        loops: &loops,
    };
    let short = Reduction { torque: &torque, weights: &weights, first: 0, rows: few, block: few, ..*reduction };
    let found = reduce(mechanism, &some, &short)?;
    Ok(of_motors(threads(block.len()), found.len(), |a| {
        let size = found[a].columns.len() + 1;
        Preconditioner::new(&transpose(&found[a].blocks[0], size), size)
    }))
}

fn check(mechanism: &Mechanism, motion: &Motion, reduction: &Reduction) -> Result<FirFilter, Error> {
    motion.check(mechanism)?;
    check_columns(mechanism, reduction.columns)?;
    let na = mechanism.coordinates();
    expect_length("torque", reduction.torque.len(), na * motion.samples)?;
    if !reduction.weights.is_empty() {
        expect_length("weights", reduction.weights.len(), na * reduction.rows)?;
    }
    if reduction.block == 0 {
        return Err(Error::Value { name: "block", got: 0.0, wanted: "at least one row" });
    }
    let derivative_length = if motion.acceleration.is_some() { 0 } else { reduction.taps.len() };
    expect_length("slope", reduction.derivative_taps.len(), derivative_length)?;
    let filter = FirFilter::new(reduction.taps, reduction.derivative_taps, reduction.decimation)?;
    let half = filter.half();
    let Reduction { first, rows, decimation, .. } = *reduction;
    let last = rows.saturating_sub(1).checked_mul(decimation).and_then(|n| n.checked_add(first));
    let fits = first >= half && last.and_then(|n| n.checked_add(half)).is_some_and(|n| n < motion.samples);
    if rows > 0 && !fits {
        return Err(Error::Window { first, rows, half, decimation, samples: motion.samples });
    }
    Ok(filter)
}

/// A column-major matrix as row-major.
fn transpose(square: &[f64], size: usize) -> Vec<f64> {
    (0..size * size).map(|k| square[(k % size) * size + k / size]).collect()
}
