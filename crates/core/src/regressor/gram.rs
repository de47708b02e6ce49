//! Gram matrix of the regressor's columns, without storing the regressor.
//!
//! It loses half the digits that triangles keep (see [`crate::linalg::tsqr`]): enough for an optimisation of trajectories, not
//! for estimation.

use crate::batch::sink::EntryRuns;
use crate::error::{Error, expect_length};
use crate::mechanism::Mechanism;
use crate::mechanism::layout::{EntryMap, check_columns};
use crate::mechanism::motion::{Motion, PART};
use crate::regressor::rows::{Workspace, rows};
use crate::simd::dispatch::dispatched;
use crate::simd::inlined;
use crate::simd::lane::{Lane, MAX_WIDTH};
use crate::simd::token::Simd;
use rayon::prelude::*;
use std::ops::Range;

/// Samples per tile, and distance of its runs: see [`mod@crate::regressor`].
const TILE: usize = 128;
const RUN: usize = TILE + MAX_WIDTH;

/// Nonzero entries of the chosen columns in each row, and the number of each entry's run in a tile. Run 0 is all zeros.
pub(crate) struct NonzeroEntries {
    pub(crate) nonzero: Vec<Vec<usize>>,
    first: Vec<usize>,
    runs: Vec<usize>,
    all: usize,
}

impl NonzeroEntries {
    /// Entries with a factor of zero, of coordinates x columns, are left out.
    pub(crate) fn new(mechanism: &Mechanism, columns: &[usize], factors: &[f64]) -> NonzeroEntries {
        let (na, all) = (mechanism.coordinates, mechanism.columns());
        let (mut nonzero, mut first, mut runs) = (Vec::with_capacity(na), vec![1], vec![0; na * all]);
        for a in 0..na {
            let there = |&c: &usize| factors[a * columns.len() + c] != 0.0;
            let row: Vec<usize> =
                (0..columns.len()).filter(there).filter(|&c| mechanism.is_structural_nonzero(a, columns[c])).collect();
            row.iter().enumerate().for_each(|(k, &c)| runs[a * all + columns[c]] = first[a] + k);
            first.push(first[a] + row.len());
            nonzero.push(row);
        }
        NonzeroEntries { nonzero, first, runs, all }
    }

    /// The run of an entry; 0 where it is not chosen, or structurally zero.
    pub(crate) fn run(&self, row: usize, column: usize) -> usize {
        self.runs[row * self.all + column]
    }

    /// Number of runs.
    pub(crate) fn count(&self) -> usize {
        self.first[self.nonzero.len()]
    }

    /// Runs of a row.
    pub(crate) fn row_runs(&self, row: usize) -> Range<usize> {
        self.first[row]..self.first[row + 1]
    }

    /// Map of each entry to its run.
    pub(crate) fn entry_map(&self, mechanism: &Mechanism) -> EntryMap {
        EntryMap::new(mechanism, |a, column| Some(self.run(a, column)).filter(|&run| run != 0))
    }
}

/// Gram matrix of the chosen columns over all rows and samples, chosen x chosen, row-major, each entry multiplied by its
/// factor, of coordinates x chosen. The motion must have accelerations.
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
/// // A pendulum; its columns ZZ, which is the acceleration, and MX.
/// let mut gram = [0.; 4];
/// gram_matrix(&pendulum, &motion, &[5, 6], &[3., 1.], &mut gram)?;
/// assert!((gram[0] - 18.).abs() < 1e-12 && gram[1] == gram[2]);
/// # Ok::<(), haptid_core::Error>(())
/// ```
pub fn gram_matrix(
    mechanism: &Mechanism,
    motion: &Motion,
    columns: &[usize],
    factors: &[f64],
    out: &mut [f64],
) -> Result<(), Error> {
    motion.check_accelerations(mechanism)?;
    check_columns(mechanism, columns)?;
    let p = columns.len();
    expect_length("factors", factors.len(), mechanism.coordinates * p)?;
    expect_length("out", out.len(), p * p)?;
    let entries = NonzeroEntries::new(mechanism, columns, factors);
    let part = |from: usize| {
        let samples = from..motion.samples.min(from + PART);
        Workspace::with(mechanism, |workspace| part_gram(mechanism, motion, &entries, samples, workspace))
    };
    let starts = (0..motion.samples).step_by(PART);
    // Starting threads costs more than a few parts; the order of the sum does not depend on them.
    let made: Vec<Vec<f64>> = match starts.len() {
        0..=2 => starts.map(part).collect(),
        _ => starts.collect::<Vec<_>>().into_par_iter().map(part).collect(),
    };
    out.fill(0.0);
    for made in &made {
        let mut rest = &made[..];
        for (nonzero, factors) in entries.nonzero.iter().zip(factors.chunks_exact(p.max(1))) {
            let own;
            (own, rest) = rest.split_at(nonzero.len().pow(2));
            add_triangle(own, nonzero, factors, out);
        }
    }
    for i in 0..p {
        (0..i).for_each(|j| out[j * p + i] = out[i * p + j]);
    }
    Ok(())
}

/// Add a lower triangle of nonzero columns, which are ascending, to that of all.
fn add_triangle(triangle: &[f64], nonzero: &[usize], factors: &[f64], out: &mut [f64]) {
    let p = factors.len();
    for (row, &i) in triangle.chunks_exact(nonzero.len().max(1)).zip(nonzero) {
        let to = &mut out[i * p..][..=i];
        for (product, &j) in row.iter().zip(nonzero).take_while(|(_, j)| **j <= i) {
            to[j] += factors[i] * factors[j] * product;
        }
    }
}

/// Lower triangles of some samples, one after the other, nonzero x nonzero each.
fn part_gram(
    mechanism: &Mechanism,
    motion: &Motion,
    entries: &NonzeroEntries,
    samples: Range<usize>,
    workspace: &mut Workspace,
) -> Vec<f64> {
    let places = [entries.entry_map(mechanism)];
    let mut sums = vec![0.0; entries.nonzero.iter().map(|nonzero| nonzero.len().pow(2)).sum()];
    let tile = workspace.tile(entries.count() * RUN);
    // SAFETY: the tile has room for all runs, the first of which stands for columns after the last one.
    unsafe { tile.write_bytes(0, RUN) };
    for from in samples.clone().step_by(TILE) {
        let count = TILE.min(samples.end - from);
        // SAFETY: every run has room for a tile and a lane.
        unsafe { rows(mechanism, motion, from, count, &places, EntryRuns { first: tile, apart: RUN }, workspace) };
        let whole = count.next_multiple_of(MAX_WIDTH);
        // SAFETY: the tile has been given this size, is initialised, and nothing else points to it here.
        let runs = unsafe { core::slice::from_raw_parts_mut(tile, entries.count() * RUN) };
        runs.chunks_exact_mut(RUN).for_each(|run| run[count..whole].fill(0.0));
        let mut rest = &mut sums[..];
        for row in 0..mechanism.coordinates {
            let (row_runs, m) = (entries.row_runs(row), entries.row_runs(row).len());
            let own;
            (own, rest) = rest.split_at_mut(m * m);
            // SAFETY: the row's runs are inside the tile, and whole lanes of them are initialised.
            unsafe { multiply(mechanism.backend, runs.as_ptr(), row_runs, whole, own) };
        }
    }
    sums
}

dispatched! {
    /// Add the inner products of some runs to a lower triangle.
    ///
    /// # Safety
    ///
    /// The runs, and run 0, are inside the tile and readable up to `samples`, which are whole lanes.
    unsafe fn multiply = multiply_in_lanes(tile: *const f64, runs: Range<usize>, samples: usize, sums: &mut [f64])
}

#[inline(always)]
unsafe fn multiply_in_lanes<T: Lane>(
    simd: Simd<T>,
    tile: *const f64,
    runs: Range<usize>,
    samples: usize,
    sums: &mut [f64],
) {
    // As many columns as keep their products in registers.
    // SAFETY: the caller's promise, passed on.
    unsafe {
        match T::PANEL {
            2 => multiply_panels::<T, 2>(simd, tile, runs, samples, sums),
            3 => multiply_panels::<T, 3>(simd, tile, runs, samples, sums),
            _ => multiply_panels::<T, 4>(simd, tile, runs, samples, sums),
        }
    }
}

#[inline(always)]
unsafe fn multiply_panels<T: Lane, const P: usize>(
    simd: Simd<T>,
    tile: *const f64,
    runs: Range<usize>,
    samples: usize,
    sums: &mut [f64],
) {
    let m = runs.len();
    // After the last column stands run 0, whose products are discarded.
    let panel = |i: usize| -> [*const f64; P] {
        // SAFETY: the runs of the row, and run 0, are inside the tile.
        inlined::from_fn(|e| unsafe { tile.add(if i + e < m { (runs.start + i + e) * RUN } else { 0 }) })
    };
    for i in (0..m).step_by(P) {
        for j in (0..=i).step_by(P) {
            // SAFETY: both panels are runs of the tile, readable up to `samples`.
            let made = unsafe { panel_products::<T, P>(simd, panel(i), panel(j), samples) };
            for (i, made) in (i..m).zip(made) {
                sums[i * m..][..m].iter_mut().skip(j).zip(made).for_each(|(sum, made)| *sum += made);
            }
        }
    }
}

#[inline(always)]
unsafe fn panel_products<T: Lane, const P: usize>(
    simd: Simd<T>,
    left: [*const f64; P],
    right: [*const f64; P],
    samples: usize,
) -> [[f64; P]; P] {
    let mut sums = [[simd.splat(0.0); P]; P];
    let mut k = 0;
    while k < samples {
        // SAFETY: the caller promises whole lanes up to `samples`.
        let right: [T; P] = inlined::from_fn(|j| unsafe { simd.load(right[j].add(k)) });
        for (sums, left) in sums.iter_mut().zip(left) {
            // SAFETY: as above.
            let left = unsafe { simd.load(left.add(k)) };
            for (sum, right) in sums.iter_mut().zip(right) {
                *sum = left.fma(right, *sum);
            }
        }
        k += T::WIDTH;
    }
    let mut made = [[0.0; P]; P];
    for (made, sums) in made.iter_mut().zip(sums) {
        *made = T::sums(sums);
    }
    made
}
