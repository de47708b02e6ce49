//! The regressor, and torques from it, over whole motions.

use crate::error::{Error, expect_length};
use crate::lane::MAX_WIDTH;
use crate::mechanism::Mechanism;
use crate::places::Places;
use crate::rows::{Workspace, rows};
use crate::stream;
use rayon::prelude::*;
use std::ops::Range;

/// Positions, velocities and accelerations of the coordinates, and the caller's own columns, channel major:
/// sample `k` of coordinate `a` is at `a * samples + k`.
///
/// Without accelerations there are two sets of rows: generalised momenta, then what is left of the torque beside their
/// rate of change. Both are free of accelerations, and `Y(q, qd, qdd) = d/dt momenta + rest`.
#[derive(Debug, Clone, Copy)]
pub struct Motion<'a> {
    pub samples: usize,
    pub position: &'a [f64],
    pub velocity: &'a [f64],
    pub acceleration: Option<&'a [f64]>,
    pub external: &'a [f64],
    /// For each joint with given rates, in order: its position, those rates, then their changes; see [`crate::Closure`].
    pub loops: &'a [f64],
}

impl Motion<'_> {
    /// Sets of rows, each as many as coordinates.
    pub fn sets(&self) -> usize {
        if self.acceleration.is_some() { 1 } else { 2 }
    }

    pub(crate) fn check(&self, mechanism: &Mechanism) -> Result<(), Error> {
        let wanted = self.samples * mechanism.coordinates;
        expect_length("position", self.position.len(), wanted)?;
        expect_length("velocity", self.velocity.len(), wanted)?;
        expect_length("acceleration", self.acceleration.map_or(wanted, <[f64]>::len), wanted)?;
        expect_length("external", self.external.len(), self.samples * mechanism.externals)?;
        expect_length("loops", self.loops.len(), self.samples * mechanism.loops)
    }
}

/// Which of the chosen columns each row can reach: coordinates x columns, row-major. The rest is structurally zero.
pub fn reach(mechanism: &Mechanism, columns: &[usize]) -> Result<Vec<bool>, Error> {
    check_columns(mechanism, columns)?;
    let na = mechanism.coordinates;
    Ok((0..na).flat_map(|a| columns.iter().map(move |&c| mechanism.reaches(a, c))).collect())
}

pub(crate) fn check_columns(mechanism: &Mechanism, columns: &[usize]) -> Result<(), Error> {
    let mut taken = vec![false; mechanism.columns()];
    for &got in columns {
        match taken.get_mut(got) {
            None => return Err(Error::Index { name: "column", got, limit: mechanism.columns() }),
            Some(true) => return Err(Error::Repeated { name: "column", got }),
            Some(free) => *free = true,
        }
    }
    Ok(())
}

/// The entries of some rows and chosen columns that can differ from zero, and where they go.
struct Entries {
    /// Numbers of the entries, row * chosen + column, in the order in which they were placed.
    filled: Vec<usize>,
    sets: Vec<Places>,
}

impl Entries {
    /// `place(entry, index)` is the place of the entry with that index among the filled ones.
    fn new(
        mechanism: &Mechanism,
        motion: &Motion,
        columns: &[usize],
        place: impl Fn(usize, usize) -> usize,
    ) -> Entries {
        let (na, sets) = (mechanism.coordinates, motion.sets());
        let mut chosen = vec![None; mechanism.columns()];
        columns.iter().enumerate().for_each(|(c, &column)| chosen[column] = Some(c));
        let mut filled = Vec::with_capacity(sets * na * columns.len());
        let mut of_set = |set: usize| {
            Places::new(mechanism, |a, column| {
                let momentum = set + 1 < sets;
                let c = chosen[column].filter(|_| !momentum || mechanism.has_momentum(column))?;
                filled.push((set * na + a) * columns.len() + c);
                Some(place(filled[filled.len() - 1], filled.len() - 1))
            })
        };
        let sets = (0..sets).map(&mut of_set).collect();
        Entries { filled, sets }
    }

    /// Of `all` entries, those that are structurally zero.
    fn empty(&self, all: usize) -> impl Iterator<Item = usize> {
        let mut empty = vec![true; all];
        self.filled.iter().for_each(|&entry| empty[entry] = false);
        (0..all).filter(move |&entry| empty[entry])
    }
}

/// The regressor of every sample: `out[(r * chosen + c) * samples + k]`, for row r (coordinates, set after set), chosen
/// column c, sample k.
pub fn regressor(mechanism: &Mechanism, motion: &Motion, columns: &[usize], out: &mut [f64]) -> Result<(), Error> {
    motion.check(mechanism)?;
    check_columns(mechanism, columns)?;
    let n = motion.samples;
    expect_length("out", out.len(), motion.sets() * mechanism.coordinates * columns.len() * n)?;
    let all = motion.sets() * mechanism.coordinates * columns.len();
    let shared = Shared(out.as_mut_ptr());
    if all * n <= CACHED {
        let entries = Entries::new(mechanism, motion, columns, |entry, _| entry * n);
        let whole = n - n % MAX_WIDTH;
        let mut workspace = Workspace::new(mechanism, motion);
        // SAFETY: every entry has n numbers, and these are whole lanes of them.
        unsafe { rows(mechanism, motion, 0, whole, &entries.sets, shared.at(0), &mut workspace) };
        entries.empty(all).for_each(|entry| out[entry * n..(entry + 1) * n].fill(0.0));
        // SAFETY: what is left is inside every entry.
        unsafe { tiled(mechanism, motion, columns, whole..n, shared, &mut workspace) };
    } else {
        let entries = Entries::new(mechanism, motion, columns, |entry, _| entry);
        entries.empty(all).for_each(|entry| out[entry * n..(entry + 1) * n].fill(0.0));
        in_parts(mechanism, motion, n, |part, workspace| {
            // SAFETY: the part is inside every entry, and no other part writes it.
            unsafe { tiled(mechanism, motion, columns, part, shared, workspace) };
        });
    }
    Ok(())
}

/// A regressor of so many numbers stays in the caches, and is written where it belongs; a larger one by way of a tile.
const CACHED: usize = 1 << 16;

/// Some samples of the regressor, made in a tile and sent to memory in long runs.
///
/// # Safety
/// `out` has `motion.samples` numbers for every entry, and nobody else uses those of these samples.
unsafe fn tiled(
    mechanism: &Mechanism,
    motion: &Motion,
    columns: &[usize],
    samples: Range<usize>,
    out: Shared,
    workspace: &mut Workspace,
) {
    if samples.is_empty() {
        return;
    }
    let entries = Entries::new(mechanism, motion, columns, |_, index| index * RUN);
    let mut tile = vec![0.0; entries.filled.len() * RUN];
    for from in samples.clone().step_by(TILE) {
        let count = TILE.min(samples.end - from);
        // SAFETY: every run has room for a tile and a lane; the rest is the caller's promise.
        unsafe {
            rows(mechanism, motion, from, count, &entries.sets, tile.as_mut_ptr(), workspace);
            for (run, &entry) in tile.chunks_exact(RUN).zip(&entries.filled) {
                stream::copy(mechanism.backend, run.as_ptr(), out.at(entry * motion.samples + from), count);
            }
        }
    }
    stream::settle();
}

/// Samples that one thread takes at a time, a multiple of any lane; starting threads costs more than a few of these.
const PART: usize = 1024;

/// An array that threads write to, each its own numbers.
#[derive(Clone, Copy)]
struct Shared(*mut f64);

// SAFETY: whoever writes promises that nobody else writes the same numbers.
unsafe impl Send for Shared {}
unsafe impl Sync for Shared {}

impl Shared {
    /// # Safety
    /// `number` is inside the array, or one past it.
    unsafe fn at(self, number: usize) -> *mut f64 {
        unsafe { self.0.add(number) }
    }
}

/// Do the work for every part of some samples, on one thread where they are few.
fn in_parts(
    mechanism: &Mechanism,
    motion: &Motion,
    samples: usize,
    work: impl Fn(Range<usize>, &mut Workspace) + Sync,
) {
    let part = |k: usize| k * PART..samples.min((k + 1) * PART);
    let parts = samples.div_ceil(PART);
    if parts <= 2 {
        let mut workspace = Workspace::new(mechanism, motion);
        (0..parts).for_each(|k| work(part(k), &mut workspace));
    } else {
        let workspace = || Workspace::new(mechanism, motion);
        (0..parts).into_par_iter().for_each_init(workspace, |workspace, k| work(part(k), workspace));
    }
}

/// Samples of a tile, and how far apart the runs of a tile are: a multiple of 4 KiB would make them
/// fight for the same cache lines.
const TILE: usize = 128;
const RUN: usize = TILE + MAX_WIDTH;

/// Torques of the chosen columns' parameters `chi`: `out[r * samples + k]`, rows as in [`regressor`].
pub fn torque(
    mechanism: &Mechanism,
    motion: &Motion,
    columns: &[usize],
    chi: &[f64],
    out: &mut [f64],
) -> Result<(), Error> {
    motion.check(mechanism)?;
    check_columns(mechanism, columns)?;
    expect_length("chi", chi.len(), columns.len())?;
    let n = motion.samples;
    expect_length("out", out.len(), motion.sets() * mechanism.coordinates * n)?;
    let entries = Entries::new(mechanism, motion, columns, |_, index| index * RUN);
    out.fill(0.0);
    let shared = Shared(out.as_mut_ptr());
    in_parts(mechanism, motion, n, |part, workspace| {
        let mut tile = vec![0.0; entries.filled.len() * RUN];
        for from in part.clone().step_by(TILE) {
            let count = TILE.min(part.end - from);
            // SAFETY: every run has room for a tile and a lane.
            unsafe { rows(mechanism, motion, from, count, &entries.sets, tile.as_mut_ptr(), workspace) };
            for (run, &entry) in tile.chunks_exact(RUN).zip(&entries.filled) {
                let (row, parameter) = (entry / columns.len(), chi[entry % columns.len()]);
                // SAFETY: the row has n numbers, and no other part touches these.
                let row = unsafe { core::slice::from_raw_parts_mut(shared.at(row * n + from), count) };
                row.iter_mut().zip(run).for_each(|(tau, y)| *tau += y * parameter);
            }
        }
    });
    Ok(())
}
