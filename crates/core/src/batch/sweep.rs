//! What recursions over the tree need, outward from the base and back: a batch of samples at a time, part by part of a
//! motion.

use crate::batch::{Batch, Channels};
use crate::mechanism::motion::{Motion, PART};
use crate::mechanism::parameters::{Held, Sets};
use crate::mechanism::transform::JointSlots;
use crate::mechanism::{LINK_PARAMETERS, Mechanism};
use crate::memory::shared::Shared;
use crate::memory::slot::grow;
use crate::memory::slot::{BATCH, Slot};
use crate::simd::lane::MAX_WIDTH;
use rayon::prelude::*;
use std::cell::Cell;

/// Numbers of a link's motion: see [`crate::mechanism::transform::Moving`].
const MOVING: usize = 9;

/// A thread's workspace: it grows to what a mechanism needs, and is kept for the next batch and call.
#[derive(Default)]
struct Workspace {
    channels: Channels,
    held: Held,
    passing: Passing,
}

/// A tree's links at a batch of samples.
#[derive(Default)]
pub(crate) struct Passing {
    pub(crate) followed: [Slot; 3],
    pub(crate) joints: Vec<JointSlots>,
    pub(crate) motions: Vec<[Slot; MOVING]>,
    /// Moment and force; or a momentum, angular and linear.
    pub(crate) wrenches: Vec<[Slot; 6]>,
    /// Weights, where momenta stand among the wrenches.
    pub(crate) weights: Vec<[Slot; 6]>,
    /// A link with all that it carries.
    pub(crate) bodies: Vec<[Slot; LINK_PARAMETERS]>,
    /// A wrench on its way to the base.
    pub(crate) force: [Slot; 6],
    /// Torques of the coordinates, or what is left of them beside momenta.
    pub(crate) torque: Vec<Slot>,
    /// Momenta of the coordinates; or torques that are given, then accelerations.
    pub(crate) other: Vec<Slot>,
    /// Lower triangle of the mass matrix, row by row.
    pub(crate) mass: Vec<Slot>,
    /// How far the mass matrix is from one that is not positive definite; zero or less where it is not.
    pub(crate) margin: Slot,
}

thread_local! {
    static KEPT: Cell<Option<Box<Workspace>>> = const { Cell::new(None) };
}

impl Workspace {
    fn grow(&mut self, mechanism: &Mechanism) {
        let (links, na, passing) = (mechanism.links.len(), mechanism.coordinates, &mut self.passing);
        self.channels.grow(mechanism);
        self.held.grow(mechanism);
        self.held.clear();
        grow(&mut passing.joints, links, JointSlots::default());
        grow(&mut passing.motions, links, [Slot::ZERO; MOVING]);
        grow(&mut passing.wrenches, links, [Slot::ZERO; 6]);
        grow(&mut passing.weights, links, [Slot::ZERO; 6]);
        grow(&mut passing.bodies, links, [Slot::ZERO; LINK_PARAMETERS]);
        grow(&mut passing.torque, na, Slot::ZERO);
        grow(&mut passing.other, na, Slot::ZERO);
        grow(&mut passing.mass, na * (na + 1) / 2, Slot::ZERO);
    }
}

/// Parameters of a batch of samples.
#[derive(Clone, Copy)]
pub(crate) struct Bodies<'a> {
    pub(crate) sets: &'a Sets<'a>,
    pub(crate) held: &'a Held,
}

/// Work on every batch of a motion, on one thread where samples are few; `work` has the batch, its first sample, its
/// parameters, and what it may write to.
pub(crate) fn each_batch(
    mechanism: &Mechanism,
    motion: &Motion,
    sets: &Sets,
    work: impl Fn(Batch, usize, Bodies, &mut Passing) + Sync,
) {
    let part = |index: usize| {
        let mut workspace = KEPT.take().unwrap_or_default();
        workspace.grow(mechanism);
        let Workspace { channels, held, passing } = &mut *workspace;
        let end = motion.samples.min((index + 1) * PART);
        for from in (index * PART..end).step_by(BATCH) {
            let samples = BATCH.min(end - from);
            channels.turn_to(mechanism, motion, from, samples);
            held.turn_to(sets, from, samples);
            work(Batch { mechanism, channels, samples }, from, Bodies { sets, held }, passing);
        }
        KEPT.set(Some(workspace));
    };
    match motion.samples.div_ceil(PART) {
        parts @ 0..=2 => (0..parts).for_each(part),
        parts => (0..parts).into_par_iter().for_each(part),
    }
}

/// Write a batch's rows to `out`, channel major with `n` samples.
///
/// # Safety
/// `out` has `n` numbers for every row, and nobody else uses those of these samples.
pub(crate) unsafe fn put_rows(rows: &[Slot], (from, count): (usize, usize), n: usize, out: Shared) {
    for (a, row) in rows.iter().enumerate() {
        unsafe { out.at(a * n + from).copy_from_nonoverlapping(row.0.as_ptr(), count) };
    }
}

/// Numbers of a batch, the last one repeated up to a whole lane.
pub(crate) fn stage(slot: &mut Slot, source: &[f64]) {
    let (count, last) = (source.len(), source[source.len() - 1]);
    slot.0[..count].copy_from_slice(source);
    slot.0[count..count.next_multiple_of(MAX_WIDTH)].fill(last);
}
