//! One thread's part of a reduction: rows are computed, filtered, decimated, and folded or multiplied.

use crate::batch::sink::EntryRuns;
use crate::linalg::lane_gram::LaneGram;
use crate::linalg::preconditioned_gram::Preconditioner;
use crate::linalg::tsqr::{CompactPanel, fold};
use crate::mechanism::Mechanism;
use crate::mechanism::layout::EntryMap;
use crate::mechanism::motion::Motion;
use crate::memory::aligned::Aligned;
use crate::reduction::fir::FirFilter;
use crate::reduction::reduce::Reduction;
use crate::regressor::rows::{Workspace, rows};
use crate::simd::lane::MAX_WIDTH;
use std::mem::take;
use std::ops::Range;

/// Samples computed at a time, and rows folded at a time.
const CHUNK: usize = 256;
const FOLD: usize = CHUNK;
/// Padding of runs, so that their distance is no multiple of 4 KiB.
const PAD: usize = MAX_WIDTH;

/// What all threads of a reduction read.
#[derive(Clone, Copy)]
pub(crate) struct Task<'a> {
    pub(crate) mechanism: &'a Mechanism,
    pub(crate) motion: &'a Motion<'a>,
    pub(crate) reduction: &'a Reduction<'a>,
    pub(crate) filter: &'a FirFilter,
    /// Nonzero columns of each motor.
    pub(crate) nonzero: &'a [Vec<usize>],
}

/// Buffers of one thread: raw columns under the filter's window, and decimated rows.
pub(crate) struct Reducer<'a> {
    task: Task<'a>,
    workspace: &'a mut Workspace,
    raw: RawRows,
    /// Decimated rows, FOLD + PAD apart, in the order of the raw runs.
    decimated: Aligned,
    panels: Vec<CompactPanel>,
    grams: Vec<LaneGram>,
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

/// Make room for this many numbers: zeros, unless they are all `written` before they are read. A filter reads past the
/// last sample, and nobody writes the remainder of a rotor.
fn room(buffer: &mut Aligned, numbers: usize, written: bool) {
    match written {
        true => buffer.resize(numbers),
        false => buffer.clear(numbers),
    }
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
        let all = (entries + with_momentum.len()) * run;
        room(&mut numbers, all, filter.is_identity() && with_momentum.is_empty());
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
    fn extend(&mut self, task: Task, end: usize, workspace: &mut Workspace) {
        let Task { mechanism, motion, reduction, .. } = task;
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
    pub(crate) fn new(task: Task<'a>, workspace: &'a mut Workspace) -> Reducer<'a> {
        let Task { mechanism, motion, reduction, filter, nonzero } = task;
        let (numbers, mut decimated) = (take(&mut workspace.raw), take(&mut workspace.decimated));
        let raw = RawRows::new(mechanism, motion.sets(), reduction.columns, nonzero, filter, numbers);
        let rows = raw.motors[raw.motors.len() - 1] * (FOLD + PAD);
        room(&mut decimated, rows, filter.is_identity() && raw.with_momentum.is_empty());
        let grams = nonzero.iter().map(|_| LaneGram::default()).collect();
        Reducer { task, workspace, raw, decimated, panels: Vec::new(), grams }
    }

    /// One matrix for each motor from some rows, column-major: their triangle; or where there is a preconditioner the
    /// upper triangle of the Gram matrix of the transformed columns.
    pub(crate) fn piece(&mut self, piece: Range<usize>, routes: &[Option<Preconditioner>]) -> Vec<Vec<f64>> {
        let (backend, sizes) = (self.task.mechanism.backend, self.task.nonzero.iter().map(|c| c.len() + 1));
        let sizes: Vec<usize> = sizes.collect();
        let route = |a: usize| routes.get(a).and_then(Option::as_ref);
        for (a, gram) in self.grams.iter_mut().enumerate().filter(|(a, _)| route(*a).is_some()) {
            gram.clear(sizes[a]);
        }
        let mut made: Vec<Vec<f64>> = sizes.iter().map(|size| vec![0.0; size * size]).collect();
        for from in piece.clone().step_by(FOLD) {
            let to = piece.end.min(from + FOLD);
            self.decimate(from, to);
            self.weigh(from, to);
            for (a, (triangle, &size)) in made.iter_mut().zip(&sizes).enumerate() {
                let motor = self.raw.motors[a] * (FOLD + PAD)..self.raw.motors[a + 1] * (FOLD + PAD);
                let columns = &mut self.decimated[motor];
                match route(a) {
                    Some(preconditioner) => {
                        preconditioner.apply(backend, columns, to - from, FOLD + PAD);
                        self.grams[a].add(backend, columns, size, to - from, FOLD + PAD);
                    }
                    None => fold(backend, triangle, size, (columns, to - from, FOLD + PAD), &mut self.panels),
                }
            }
        }
        for (a, gram) in self.grams.iter_mut().enumerate().filter(|(a, _)| route(*a).is_some()) {
            gram.drain(backend, sizes[a], &mut made[a]);
        }
        made
    }

    /// Filter rows `from..to` into `decimated`, with zeros after them up to a whole lane.
    fn decimate(&mut self, from: usize, to: usize) {
        if self.task.filter.is_identity() {
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
        (self.raw.from, self.raw.stored) = (self.task.reduction.first + from, 0);
        self.raw.extend(self.task, self.task.reduction.first + to, self.workspace);
        std::mem::swap(&mut self.raw.numbers, &mut self.decimated);
    }

    fn filter(&mut self, from: usize, to: usize) {
        let Reduction { first, .. } = *self.task.reduction;
        let (d, half) = (self.task.filter.decimation, self.task.filter.half());
        let centre = |row: usize| first + row * d;
        let samples = centre(to - 1) + half + 1;
        let mut row = from;
        while row < to {
            self.raw.drop_before(centre(row) - half);
            self.raw.extend(self.task, samples, self.workspace);
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
        let (backend, filter, raw) = (self.task.mechanism.backend, self.task.filter, &self.raw);
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
        if self.task.reduction.weights.is_empty() {
            return;
        }
        for (a, motor) in self.raw.motors.windows(2).enumerate() {
            let weights = &self.task.reduction.weights[a * self.task.reduction.rows..][from..to];
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
