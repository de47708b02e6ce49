//! Reduction: rows are computed, filtered, decimated and folded into one triangle per motor and time block, in one
//! pass.

use crate::batch::sink::EntryRuns;
use crate::error::{Error, expect_length};
use crate::linalg::tsqr::{CompactPanel, fold, merge};
use crate::mechanism::Mechanism;
use crate::mechanism::layout::{EntryMap, check_columns, structural_nonzeros};
use crate::mechanism::motion::Motion;
use crate::memory::aligned::Aligned;
use crate::reduction::fir::FirFilter;
use crate::regressor::rows::{Workspace, rows};
use crate::simd::lane::MAX_WIDTH;
use rayon::prelude::*;
use std::mem::take;
use std::ops::Range;

/// Samples computed at a time, and rows folded at a time.
const CHUNK: usize = 256;
const FOLD: usize = CHUNK;
/// Starting threads costs more than the work on this many samples.
const SINGLE_THREAD: usize = 2000;
/// Rows of a long block that are reduced as one task; the triangles of a block's tasks are merged.
const PIECE: usize = 2048;
/// Padding of runs, so that their distance is no multiple of 4 KiB.
const PAD: usize = MAX_WIDTH;

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
    let nonzero_of: Vec<Vec<usize>> =
        (0..mechanism.coordinates()).map(|a| (0..p).filter(|&c| nonzero[a * p + c]).collect()).collect();
    let pieces = pieces(reduction);
    let threads = if reduction.rows * reduction.decimation < SINGLE_THREAD { 1 } else { rayon::current_num_threads() };
    // Several parts per thread balance the load; each part reads one window more than its own samples.
    let parts = if threads == 1 { 1 } else { (4 * threads).min(pieces.len().max(1)) };
    let part = |k: usize| &pieces[k * pieces.len() / parts..(k + 1) * pieces.len() / parts];
    let run = |k: usize| {
        Workspace::with(mechanism, |workspace| {
            let mut reducer = Reducer::new(mechanism, motion, reduction, &filter, &nonzero_of, workspace);
            part(k).iter().map(|piece| reducer.piece(piece.clone())).collect::<Vec<_>>()
        })
    };
    let done: Vec<Vec<Vec<Vec<f64>>>> =
        if parts == 1 { vec![run(0)] } else { (0..parts).into_par_iter().map(run).collect() };
    let factors: Vec<Vec<Vec<f64>>> = done.into_iter().flatten().collect();
    Ok(nonzero_of
        .into_iter()
        .enumerate()
        .map(|(a, columns)| gather(mechanism, reduction, &pieces, &factors, a, columns))
        .collect())
}

/// Rows of every block in tasks of limited length, so that long blocks are divided among threads too.
fn pieces(reduction: &Reduction) -> Vec<Range<usize>> {
    let Reduction { rows, block, .. } = *reduction;
    let of_block = |begin: usize| {
        let end = begin.saturating_add(block).min(rows);
        (begin..end).step_by(PIECE).map(move |from| from..end.min(from + PIECE))
    };
    (0..rows).step_by(block).flat_map(of_block).collect()
}

/// One motor's factors, row-major, after merging the tasks of each block.
fn gather(
    mechanism: &Mechanism,
    reduction: &Reduction,
    pieces: &[Range<usize>],
    factors: &[Vec<Vec<f64>>],
    a: usize,
    columns: Vec<usize>,
) -> RFactors {
    let (size, mut rows) = (columns.len() + 1, Vec::new());
    let mut blocks: Vec<Vec<f64>> = Vec::new();
    for (piece, factors) in pieces.iter().zip(factors) {
        match blocks.last_mut() {
            Some(block) if !piece.start.is_multiple_of(reduction.block) => {
                merge(mechanism.backend, block, &factors[a], size, &mut rows)
            }
            _ => blocks.push(factors[a].clone()),
        }
    }
    RFactors { columns, blocks: blocks.iter().map(|block| transpose(block, size)).collect() }
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

/// Buffers of one thread: raw columns under the filter's window, and decimated rows.
struct Reducer<'a> {
    mechanism: &'a Mechanism,
    motion: &'a Motion<'a>,
    reduction: &'a Reduction<'a>,
    filter: &'a FirFilter,
    nonzero: &'a [Vec<usize>],
    workspace: &'a mut Workspace,
    raw: RawRows,
    /// Decimated rows, FOLD + PAD apart, in the order of the raw runs.
    decimated: Aligned,
    panels: Vec<CompactPanel>,
}

/// Raw columns, one run per entry (motor, nonzero column or torque), with samples `from..from + stored`; without
/// accelerations the momenta of these entries follow in runs of their own.
struct RawRows {
    numbers: Aligned,
    run: usize,
    from: usize,
    stored: usize,
    sets: Vec<EntryMap>,
    /// First run of each motor, and one past the last.
    motors: Vec<usize>,
    /// Entries whose momenta follow, in this order.
    with_momentum: Vec<usize>,
}

impl RawRows {
    fn new(
        mechanism: &Mechanism,
        sets: usize,
        columns: &[usize],
        nonzero: &[Vec<usize>],
        filter: &FirFilter,
        mut numbers: Aligned,
    ) -> RawRows {
        let (na, all) = (mechanism.coordinates(), mechanism.columns());
        let longest = filter.padded_length() + CHUNK;
        let run = if filter.is_identity() { FOLD + PAD } else { longest.next_multiple_of(MAX_WIDTH) + PAD };
        let entries = 1 + nonzero.iter().map(|nonzero| nonzero.len() + 1).sum::<usize>();
        let mut place = vec![None; sets * na * all];
        let (mut motors, mut with_momentum) = (vec![1], Vec::new());
        for (a, nonzero) in nonzero.iter().enumerate() {
            for (entry, &c) in (motors[a]..).zip(nonzero) {
                let column = columns[c];
                // Of two sets the first holds the momenta.
                place[((sets - 1) * na + a) * all + column] = Some(entry);
                if sets == 2 && mechanism.has_momentum(column) {
                    place[a * all + column] = Some(entries + with_momentum.len());
                    with_momentum.push(entry);
                }
            }
            motors.push(motors[a] + nonzero.len() + 1);
        }
        let sets = (0..sets).map(|set| EntryMap::new(mechanism, |a, c| place[(set * na + a) * all + c])).collect();
        numbers.clear((entries + with_momentum.len()) * run);
        RawRows { numbers, run, from: 0, stored: 0, sets, motors, with_momentum }
    }

    fn entry(&self, entry: usize) -> &[f64] {
        &self.numbers[entry * self.run..][..self.run]
    }

    /// Drop the samples before `from`.
    fn drop_before(&mut self, from: usize) {
        let gone = from.saturating_sub(self.from).min(self.stored);
        if gone > 0 {
            let left = self.stored - gone;
            for run in self.numbers.chunks_exact_mut(self.run) {
                run.copy_within(gone..gone + left, 0);
            }
            self.stored = left;
        }
        self.from = if self.stored == 0 { from } else { self.from + gone };
    }

    /// Append the next samples, at most a chunk of them and none from `end` on.
    fn extend(&mut self, reducer: (&Mechanism, &Motion, &Reduction), end: usize, workspace: &mut Workspace) {
        let (mechanism, motion, reduction) = reducer;
        let next = self.from + self.stored;
        let count = CHUNK.min(end - next);
        // SAFETY: a run has room for what the filter reaches back to, a chunk, and a lane; `numbers` is borrowed by
        // nobody else.
        unsafe {
            let out = EntryRuns { first: self.numbers.as_mut_ptr(), apart: self.run }.from(self.stored);
            rows(mechanism, motion, next, count, &self.sets, out, workspace);
        }
        for (a, motor) in self.motors.windows(2).enumerate() {
            let torque = &reduction.torque[a * motion.samples + next..][..count];
            self.numbers[(motor[1] - 1) * self.run + self.stored..][..count].copy_from_slice(torque);
        }
        self.stored += count;
    }
}

impl<'a> Reducer<'a> {
    fn new(
        mechanism: &'a Mechanism,
        motion: &'a Motion<'a>,
        reduction: &'a Reduction<'a>,
        filter: &'a FirFilter,
        nonzero: &'a [Vec<usize>],
        workspace: &'a mut Workspace,
    ) -> Reducer<'a> {
        let (numbers, mut decimated) = (take(&mut workspace.raw), take(&mut workspace.decimated));
        let raw = RawRows::new(mechanism, motion.sets(), reduction.columns, nonzero, filter, numbers);
        decimated.clear(raw.motors[raw.motors.len() - 1] * (FOLD + PAD));
        Reducer { mechanism, motion, reduction, filter, nonzero, workspace, raw, decimated, panels: Vec::new() }
    }

    /// Triangles of some rows, one per motor, column-major.
    fn piece(&mut self, piece: Range<usize>) -> Vec<Vec<f64>> {
        let mut triangles: Vec<Vec<f64>> = self.nonzero.iter().map(|c| vec![0.0; (c.len() + 1).pow(2)]).collect();
        for from in piece.clone().step_by(FOLD) {
            let to = piece.end.min(from + FOLD);
            self.decimate(from, to);
            self.weigh(from, to);
            for (a, triangle) in triangles.iter_mut().enumerate() {
                let motor = self.raw.motors[a] * (FOLD + PAD)..self.raw.motors[a + 1] * (FOLD + PAD);
                let columns = self.nonzero[a].len() + 1;
                let rows = (&mut self.decimated[motor], to - from, FOLD + PAD);
                fold(self.mechanism.backend, triangle, columns, rows, &mut self.panels);
            }
        }
        triangles
    }

    /// Filter rows `from..to` into `decimated`, with zeros after them up to a whole lane.
    fn decimate(&mut self, from: usize, to: usize) {
        if self.filter.is_identity() {
            self.copy(from, to)
        } else {
            self.filter(from, to)
        }
        for decimated in self.decimated.chunks_exact_mut(FOLD + PAD) {
            decimated[to - from..(to - from).next_multiple_of(MAX_WIDTH)].fill(0.0);
        }
    }

    /// Without a filter the raw columns are the rows; they are exchanged, not copied.
    fn copy(&mut self, from: usize, to: usize) {
        (self.raw.from, self.raw.stored) = (self.reduction.first + from, 0);
        let reducer = (self.mechanism, self.motion, self.reduction);
        self.raw.extend(reducer, self.reduction.first + to, self.workspace);
        std::mem::swap(&mut self.raw.numbers, &mut self.decimated);
    }

    fn filter(&mut self, from: usize, to: usize) {
        let Reduction { first, .. } = *self.reduction;
        let (d, half) = (self.filter.decimation, self.filter.half());
        let centre = |row: usize| first + row * d;
        let samples = centre(to - 1) + half + 1;
        let mut row = from;
        while row < to {
            self.raw.drop_before(centre(row) - half);
            let reducer = (self.mechanism, self.motion, self.reduction);
            self.raw.extend(reducer, samples, self.workspace);
            let seen = self.raw.from + self.raw.stored;
            let ready = if seen < centre(row) + half + 1 { row } else { (seen - half - 1 - first) / d + 1 };
            let ready = ready.clamp(row, to);
            let start = centre(row) - half - self.raw.from;
            self.add(start, row - from..ready - from);
            row = ready;
        }
    }

    /// Filter columns and torques into some of the decimated rows, and add the derivatives of the momenta.
    fn add(&mut self, start: usize, rows: Range<usize>) {
        let (backend, filter, raw) = (self.mechanism.backend, self.filter, &self.raw);
        for (entry, decimated) in self.decimated.chunks_exact_mut(FOLD + PAD).enumerate().skip(1) {
            decimated[rows.clone()].fill(0.0);
            filter.add(backend, &filter.taps, raw.entry(entry), start, &mut decimated[rows.clone()]);
        }
        let entries = raw.motors[raw.motors.len() - 1];
        for (momentum, &entry) in (entries..).zip(&raw.with_momentum) {
            let decimated = &mut self.decimated[entry * (FOLD + PAD)..][rows.clone()];
            filter.add(backend, &filter.derivative_taps, raw.entry(momentum), start, decimated);
        }
    }

    fn weigh(&mut self, from: usize, to: usize) {
        if self.reduction.weights.is_empty() {
            return;
        }
        for (a, motor) in self.raw.motors.windows(2).enumerate() {
            let weights = &self.reduction.weights[a * self.reduction.rows..][from..to];
            if weights.iter().all(|&w| w == 1.0) {
                continue;
            }
            for run in motor[0]..motor[1] {
                let column = &mut self.decimated[run * (FOLD + PAD)..][..weights.len()];
                // Selected, not multiplied: a row that is dropped may hold NaN.
                column.iter_mut().zip(weights).for_each(|(x, &w)| *x = if w == 0.0 { 0.0 } else { *x * w });
            }
        }
    }
}

impl Drop for Reducer<'_> {
    /// Return the buffers to the thread's workspace.
    fn drop(&mut self) {
        self.workspace.raw = take(&mut self.raw.numbers);
        self.workspace.decimated = take(&mut self.decimated);
    }
}

/// A column-major matrix as row-major.
fn transpose(square: &[f64], size: usize) -> Vec<f64> {
    (0..size * size).map(|k| square[(k % size) * size + k / size]).collect()
}
