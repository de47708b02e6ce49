//! The regressor, and torques from it, over whole motions.

use crate::error::{Error, expect_length};
use crate::lane::MAX_WIDTH;
use crate::mechanism::{LINK_PARAMETERS, Mechanism};
use crate::rows::{CHUNK, Places, Workspace, rows};

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
    let inertial = mechanism.inertial_columns();
    check_columns(mechanism, columns)?;
    let reaches = |a: usize, c: usize| {
        if c >= inertial {
            return !mechanism.terms[c - inertial].course.rate(a).is_zero();
        }
        mechanism.links[c / LINK_PARAMETERS].axes.iter().any(|axis| axis.coordinate == a)
    };
    let na = mechanism.coordinates;
    Ok((0..na).flat_map(|a| columns.iter().map(move |&c| reaches(a, c))).collect())
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

/// A buffer for one chunk of rows, one run of samples per entry (row a, chosen column).
pub(crate) struct Tile {
    numbers: Vec<f64>,
    place: Vec<usize>,
    /// First sample of entry (r, c): `at[r * chosen + c]`.
    at: Vec<usize>,
}

/// Runs are this far apart: a multiple of 4 KiB would make them fight for the same cache lines.
const RUN: usize = CHUNK + MAX_WIDTH;

impl Tile {
    pub(crate) fn new(mechanism: &Mechanism, rows: usize, columns: &[usize]) -> Tile {
        let all = mechanism.columns();
        let mut place = vec![0; rows * all]; // the first run takes what nobody wants
        let mut at = Vec::with_capacity(rows * columns.len());
        for r in 0..rows {
            for &c in columns {
                at.push((1 + at.len()) * RUN);
                place[r * all + c] = at[at.len() - 1];
            }
        }
        Tile { numbers: vec![0.0; (1 + at.len()) * RUN], place, at }
    }

    fn fill(&mut self, mechanism: &Mechanism, motion: &Motion, from: usize, count: usize, workspace: &mut Workspace) {
        let places = Places { place: &self.place, out: self.numbers.as_mut_ptr() };
        // SAFETY: every run has room for a chunk and a lane.
        unsafe { rows(mechanism, motion, from, count, &places, workspace) }
    }

    fn run(&self, entry: usize, count: usize) -> &[f64] {
        &self.numbers[self.at[entry]..][..count]
    }
}

/// The regressor of every sample: `out[(r * chosen + c) * samples + k]`, for row r (coordinates, set after set), chosen
/// column c, sample k.
pub fn regressor(mechanism: &Mechanism, motion: &Motion, columns: &[usize], out: &mut [f64]) -> Result<(), Error> {
    motion.check(mechanism)?;
    check_columns(mechanism, columns)?;
    let (n, rows) = (motion.samples, motion.sets() * mechanism.coordinates);
    expect_length("out", out.len(), rows * columns.len() * n)?;
    let (mut tile, mut workspace) = (Tile::new(mechanism, rows, columns), Workspace::new(mechanism));
    for from in (0..n).step_by(CHUNK) {
        let count = CHUNK.min(n - from);
        tile.fill(mechanism, motion, from, count, &mut workspace);
        for (entry, column) in out.chunks_exact_mut(n).enumerate() {
            column[from..from + count].copy_from_slice(tile.run(entry, count));
        }
    }
    Ok(())
}

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
    let (n, rows) = (motion.samples, motion.sets() * mechanism.coordinates);
    expect_length("out", out.len(), rows * n)?;
    let (mut tile, mut workspace) = (Tile::new(mechanism, rows, columns), Workspace::new(mechanism));
    out.fill(0.0);
    for from in (0..n).step_by(CHUNK) {
        let count = CHUNK.min(n - from);
        tile.fill(mechanism, motion, from, count, &mut workspace);
        for (r, row) in out.chunks_exact_mut(n).enumerate() {
            let row = &mut row[from..from + count];
            for (c, &parameter) in chi.iter().enumerate() {
                let column = tile.run(r * columns.len() + c, count);
                row.iter_mut().zip(column).for_each(|(tau, y)| *tau += y * parameter);
            }
        }
    }
    Ok(())
}
