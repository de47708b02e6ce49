//! Recursions over the tree, from the base to the end links and back: their state, and the division of a motion into
//! batches.

use crate::batch::{Batch, Channels, no_pointers};
use crate::mechanism::motion::{Motion, PART};
use crate::mechanism::parameters::{ParameterSets, ParameterSlots};
use crate::mechanism::transform::TransformSlots;
use crate::mechanism::{LINK_PARAMETERS, Mechanism};
use crate::memory::shared::SharedOutput;
use crate::memory::slot::{BATCH, Slot, grow};
use crate::simd::lane::MAX_WIDTH;
use rayon::prelude::*;
use std::cell::Cell;

/// Numbers of a link's motion, see [`crate::mechanism::transform::SpatialMotion`]; a link's velocity takes as many.
const MOTION_NUMBERS: usize = 9;

/// Workspace of a thread: it grows to what a mechanism needs, and is reused by later batches and calls.
#[derive(Default)]
struct Workspace {
    channels: Channels,
    parameters: ParameterSlots,
    state: RecursionState,
}

const _: () = no_pointers::<(ParameterSlots, RecursionState)>();

/// State of a recursion at a batch of samples.
#[derive(Default)]
pub(crate) struct RecursionState {
    pub(crate) followed: [Slot; 3],
    pub(crate) joints: Vec<TransformSlots>,
    pub(crate) motions: Vec<[Slot; MOTION_NUMBERS]>,
    /// Moment and force of each link; or its momentum, or its velocity, angular and linear.
    pub(crate) wrenches: Vec<[Slot; 6]>,
    /// Gravity wrenches, where `wrenches` holds momenta.
    pub(crate) weights: Vec<[Slot; 6]>,
    /// Composite bodies: a link with all that it carries.
    pub(crate) bodies: Vec<[Slot; LINK_PARAMETERS]>,
    /// Wrench that is propagated to the base.
    pub(crate) force: [Slot; 6],
    /// Torques of the coordinates, or their remainder in addition to the rate of momentum.
    pub(crate) torque: Vec<Slot>,
    /// Momenta of the coordinates; or given torques, then accelerations.
    pub(crate) other: Vec<Slot>,
    /// Lower triangle of the mass matrix, row by row.
    pub(crate) mass: Vec<Slot>,
    /// Smallest margin of the mass matrix's pivots over rounding error; zero or less where it is not positive definite.
    pub(crate) margin: Slot,
}

thread_local! {
    static WORKSPACE: Cell<Option<Box<Workspace>>> = const { Cell::new(None) };
}

impl Workspace {
    fn grow(&mut self, mechanism: &Mechanism) {
        let (links, na, state) = (mechanism.links.len(), mechanism.coordinates, &mut self.state);
        self.channels.grow(mechanism);
        self.parameters.grow(mechanism);
        self.parameters.clear();
        grow(&mut state.joints, links, TransformSlots::default());
        grow(&mut state.motions, links, [Slot::ZERO; MOTION_NUMBERS]);
        grow(&mut state.wrenches, links, [Slot::ZERO; 6]);
        grow(&mut state.weights, links, [Slot::ZERO; 6]);
        grow(&mut state.bodies, links, [Slot::ZERO; LINK_PARAMETERS]);
        grow(&mut state.torque, na, Slot::ZERO);
        grow(&mut state.other, na, Slot::ZERO);
        grow(&mut state.mass, na * (na + 1) / 2, Slot::ZERO);
    }
}

/// Parameters at a batch of samples.
#[derive(Clone, Copy)]
pub(crate) struct BatchParameters<'a> {
    pub(crate) sets: &'a ParameterSets<'a>,
    pub(crate) slots: &'a ParameterSlots,
}

/// Evaluate `work` on every batch of a motion, by several threads where samples are many. Its arguments are the batch,
/// its first sample, its parameters, and a state that has grown to the mechanism.
pub(crate) fn for_each_batch(
    mechanism: &Mechanism,
    motion: &Motion,
    sets: &ParameterSets,
    work: impl Fn(Batch, usize, BatchParameters, &mut RecursionState) + Sync,
) {
    for_each_batch_with(
        mechanism,
        motion,
        sets,
        || (),
        |batch, from, bodies, state, ()| work(batch, from, bodies, state),
    );
}

/// The same for work with a state of its own, which `start` makes for each part of the motion.
pub(crate) fn for_each_batch_with<S>(
    mechanism: &Mechanism,
    motion: &Motion,
    sets: &ParameterSets,
    start: impl Fn() -> S + Sync,
    work: impl Fn(Batch, usize, BatchParameters, &mut RecursionState, &mut S) + Sync,
) {
    let part = |index: usize| {
        let mut own = start();
        let mut workspace = WORKSPACE.take().unwrap_or_default();
        workspace.grow(mechanism);
        let Workspace { channels, parameters, state } = &mut *workspace;
        let end = motion.samples.min((index + 1) * PART);
        for from in (index * PART..end).step_by(BATCH) {
            let samples = BATCH.min(end - from);
            channels.advance_to(mechanism, motion, from, samples);
            parameters.advance_to(sets, from, samples);
            let (batch, bodies) = (Batch { mechanism, channels, samples }, BatchParameters { sets, slots: parameters });
            work(batch, from, bodies, state, &mut own);
        }
        channels.release();
        WORKSPACE.set(Some(workspace));
    };
    match motion.samples.div_ceil(PART) {
        parts @ 0..=2 => (0..parts).for_each(part),
        parts => (0..parts).into_par_iter().for_each(part),
    }
}

/// Write a batch's rows to `out`, channel major with `n` samples.
///
/// # Safety
///
/// `out` has `n` numbers for every row, and nobody else uses those of samples `from..from + count`.
pub(crate) unsafe fn write_rows(rows: &[Slot], (from, count): (usize, usize), n: usize, out: SharedOutput) {
    for (a, row) in rows.iter().enumerate() {
        // SAFETY: the caller's promise; a slot holds a batch, of which `count` is a part.
        unsafe { out.at(a * n + from).copy_from_nonoverlapping(row.0.as_ptr(), count) };
    }
}

/// Stage samples in a slot; the last one is repeated up to a whole lane.
pub(crate) fn stage_slot(slot: &mut Slot, source: &[f64]) {
    let (count, last) = (source.len(), source[source.len() - 1]);
    slot.0[..count].copy_from_slice(source);
    slot.0[count..count.next_multiple_of(MAX_WIDTH)].fill(last);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mechanism::Joint;
    use crate::mechanism::closure::Closure;
    use crate::simd::dispatch::Backend;

    #[test]
    fn no_pointer_to_a_motion_outlives_the_call() {
        let rotation = [1., 0., 0., 0., 1., 0., 0., 0., 1.];
        let joint = Joint { parent: None, rotation, translation: [0.; 3], prismatic: false };
        let pendulum = Mechanism::new(&[joint], &Closure::open(1), [0., -9.81, 0.], &[], Backend::best()).unwrap();
        let numbers = [0.5; BATCH];
        let motion = Motion {
            samples: BATCH,
            position: &numbers,
            velocity: &numbers,
            acceleration: None,
            external: &[],
            loops: &[],
        };
        let sets = ParameterSets::new(&pendulum, BATCH, &[1.0; LINK_PARAMETERS]).unwrap();
        for_each_batch(&pendulum, &motion, &sets, |batch, _, _, _| assert!(!batch.channels.is_released()));
        let kept = WORKSPACE.take().expect("kept for the next call");
        assert!(kept.channels.is_released());
    }
}
