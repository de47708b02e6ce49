//! Rows of the regressor, a batch of samples at a time, by forward transformation of axes.
//!
//! The axis of every coordinate is transformed from link to link, in the links' own frames, and contracted there with
//! the link's inertial wrench, `Y[a, i] = s_i^a . A_i(v_i, a_i)`; the 6 x 10 matrix A_i is never formed. With the axes
//! of the *coordinates* in place of the joints', `s_i^a = X_i s_parent^a + G[i, a] z`, a closed chain's torques are
//! projected on its motors at no cost (Khalil and Dombre 2002, chapter 10, without forming the tree's rows).
//!
//! Without accelerations there are two rows for each coordinate in place of one: generalised momentum, and the
//! remainder of the torque (see [`crate::regressor::momentum`]).
//!
//! Safety: [`rows`] is the only entry. Its batches are as described in [`crate::batch`], `Workspace::grow` has made
//! slots for every link and axis of the mechanism, and its caller promises output runs with room for whole lanes. Every
//! unsafe function below relies on this.

use crate::batch::axis::{AxisSlots, load_axis, store_axis, store_transform};
use crate::batch::link::{LINK_NUMBERS, LinkMotions};
use crate::batch::sink::{EntryRuns, EntrySink, for_set};
use crate::batch::{Batch, Channels, JointChannels, no_pointers};
use crate::linalg::vector::Vector;
use crate::mechanism::closure::Rate;
use crate::mechanism::layout::EntryMap;
use crate::mechanism::motion::Motion;
use crate::mechanism::shape::{JointShape, JointType, Rotation, for_shape};
use crate::mechanism::terms::Law;
use crate::mechanism::transform::{JointTransform, TransformSlots};
use crate::mechanism::{Axis, Link, Mechanism};
use crate::memory::aligned::Aligned;
use crate::memory::slot::{BATCH, Slot, grow};
use crate::regressor::adjoint::Adjoint;
use crate::regressor::momentum::momentum_rows;
use crate::simd::dispatch::dispatched;
use crate::simd::lane::Lane;
use crate::simd::token::Simd;
use std::cell::Cell;

/// Workspace of a thread for rows: it grows to what a mechanism needs, and is reused by later batches and calls.
#[derive(Default)]
pub(crate) struct Workspace {
    pub(crate) channels: Channels,
    pub(crate) slots: KinematicSlots,
    /// Adjoints of a reverse sweep.
    pub(crate) adjoint: Adjoint,
    /// Runs of entries before they are copied to memory.
    tile: Aligned,
    /// Runs of entries before and after the filter.
    pub(crate) raw: Aligned,
    pub(crate) decimated: Aligned,
}

const _: () = no_pointers::<(KinematicSlots, Adjoint, Aligned)>();

/// Links and axes at a batch of samples.
#[derive(Default)]
pub(crate) struct KinematicSlots {
    pub(crate) followed: [Slot; 3],
    pub(crate) joint: TransformSlots,
    /// Motions of the links, or their velocities.
    pub(crate) links: Vec<[Slot; LINK_NUMBERS]>,
    pub(crate) axes: Vec<AxisSlots>,
    /// Rates of the axes, for rows without accelerations.
    pub(crate) axis_rates: Vec<AxisSlots>,
}

thread_local! {
    static WORKSPACE: Cell<Option<Box<Workspace>>> = const { Cell::new(None) };
}

impl Workspace {
    /// Work with the thread's own workspace, after it has grown to the mechanism.
    pub(crate) fn with<R>(mechanism: &Mechanism, work: impl FnOnce(&mut Workspace) -> R) -> R {
        let mut workspace = WORKSPACE.take().unwrap_or_default();
        workspace.grow(mechanism);
        let done = work(&mut workspace);
        workspace.channels.release();
        WORKSPACE.set(Some(workspace));
        done
    }

    fn grow(&mut self, mechanism: &Mechanism) {
        self.channels.grow(mechanism);
        grow(&mut self.slots.links, mechanism.links.len(), [Slot::ZERO; LINK_NUMBERS]);
        grow(&mut self.slots.axes, mechanism.axes, [Slot::ZERO; 6]);
        grow(&mut self.slots.axis_rates, mechanism.axes, [Slot::ZERO; 6]);
    }

    /// The tile, with room for this many numbers; it holds what was last written there.
    pub(crate) fn tile(&mut self, numbers: usize) -> *mut f64 {
        self.tile.grow(numbers);
        self.tile.as_mut_ptr()
    }
}

/// Compute the rows of samples `from..from + count`. Entry (row, column) of sample `from + k` is written to number k of
/// its run in `out`, for each set of rows: torques; or momenta and then remainders.
///
/// # Safety
///
/// Every run has room for `count` rounded up to whole lanes of [`crate::simd::lane::MAX_WIDTH`], and nobody else uses
/// it meanwhile.
pub(crate) unsafe fn rows(
    mechanism: &Mechanism,
    motion: &Motion,
    from: usize,
    count: usize,
    sets: &[EntryMap],
    out: EntryRuns,
    workspace: &mut Workspace,
) {
    debug_assert!(sets.len() == motion.sets());
    let Workspace { channels, slots, .. } = workspace;
    for done in (0..count).step_by(BATCH) {
        let samples = BATCH.min(count - done);
        channels.advance_to(mechanism, motion, from + done, samples);
        let batch = Batch { mechanism, channels, samples };
        // SAFETY: the channels have been advanced to the batch, the workspace has grown to the mechanism, and the
        // caller promises the runs.
        unsafe {
            match sets {
                [torque] => torques(mechanism.backend, batch, torque, out.from(done), slots),
                [momentum, remainder] => {
                    momentum_rows(mechanism.backend, batch, momentum, remainder, out.from(done), slots)
                }
                _ => unreachable!("a motion has one set of rows or two"),
            }
        }
    }
}

dispatched! {
    unsafe fn torques = torques_in_lanes(batch: Batch, places: &EntryMap, out: EntryRuns, slots: &mut KinematicSlots)
}

#[inline(always)]
unsafe fn torques_in_lanes<T: Lane>(
    simd: Simd<T>,
    batch: Batch,
    places: &EntryMap,
    out: EntryRuns,
    slots: &mut KinematicSlots,
) {
    for (i, link) in batch.mechanism.links.iter().enumerate() {
        // SAFETY: batch, slots and output runs are as in the head of the file; `own` is an axis of the mechanism.
        unsafe {
            let followed = batch.follow(simd, &link.joint_map, &mut slots.followed);
            store_transform(simd, batch, link, followed, &mut slots.joint);
            for_shape!(link.shape, shape => propagate_motion(simd, batch, (shape, i), followed, slots));
            let motions = LinkMotions(slots.links[i].as_mut_ptr());
            for (own, axis) in (link.first..).zip(&link.axes) {
                let (axes, joint) = (slots.axes.as_mut_ptr(), slots.joint.as_ptr());
                let row = Row { link, axis, motions, joint, to: axes.add(own).cast(), sink: places.axis(own, out) };
                match axis.above {
                    None => own_rows(simd, batch, &row),
                    Some(above) => inherited_rows(batch.mechanism.backend, batch, &row, axes.add(above).cast()),
                }
            }
        }
    }
    // SAFETY: as above.
    unsafe { term_rows(simd, batch, false, places, out, &mut slots.followed) };
}

/// One coordinate on one link: its axis, and the output of its entries.
struct Row<'a> {
    link: &'a Link,
    axis: &'a Axis,
    motions: LinkMotions,
    joint: *const Slot,
    to: *mut Slot,
    sink: EntrySink<'a>,
}

/// Entries of a coordinate that moves this link's joint and none before it. The axis is stored only where it varies.
#[inline(always)]
unsafe fn own_rows<T: Lane>(simd: Simd<T>, batch: Batch, row: &Row) {
    let (link, rate) = (row.link, row.axis.rate);
    // SAFETY: batch, slots and output runs are as in the head of the file.
    unsafe {
        if let Rate::Varying { .. } = rate {
            let at_zero = JointTransform::at_zero(simd, link.shape, link);
            batch.lanes(simd).for_each(|k| store_axis(row.to, k, at_zero.joint_axis(batch.rate(simd, rate, k))));
        }
        for_set!(row.sink, SET => match link.is_prismatic() {
            false => row.motions.contract_turn::<T, SET>(simd, batch, rate, &row.sink),
            true => row.motions.contract_slide::<T, SET>(simd, batch, rate, &row.sink),
        });
    }
}

dispatched! {
    /// Entries of a coordinate that moves the parent too.
    ///
    /// # Safety
    ///
    /// As for [`rows`]; `above` points to the slots of the axis on the parent, where it varies.
    unsafe fn inherited_rows = inherited_rows_in_lanes(batch: Batch, row: &Row, above: *const Slot)
}

#[inline(always)]
unsafe fn inherited_rows_in_lanes<T: Lane>(simd: Simd<T>, batch: Batch, row: &Row, above: *const Slot) {
    let link = row.link;
    // SAFETY: batch, slots and output runs are as in the head of the file.
    unsafe {
        if let Some(above) = constant_parent_axis(simd, batch.mechanism, row) {
            let at_zero = JointTransform::at_zero(simd, link.shape, link);
            if link.is_prismatic() {
                return for_set!(row.sink, SET => {
                    put_rows::<T, SET>(simd, batch, row, |k| at_zero.load(row.joint, k).transform_axis(above))
                });
            }
            // Transformed to the joint at position zero, the axis has only to rotate about z.
            let above = at_zero.transform_axis(above);
            let turn = JointTransform::at_zero(
                simd,
                JointShape { rotation: Rotation::Identity, joint_type: JointType::RevoluteInPlace },
                link,
            );
            for_set!(row.sink, SET => put_rows::<T, SET>(simd, batch, row, |k| turn.load(row.joint, k).transform_axis(above)))
        } else {
            for_shape!(link.shape, shape => {
                let at_zero = JointTransform::at_zero(simd, shape, link);
                for_set!(row.sink, SET => {
                    put_rows::<T, SET>(simd, batch, row, |k| at_zero.load(row.joint, k).transform_axis(load_axis(simd, above, k)))
                });
            })
        }
    }
}

/// The axis on the parent, in its frame, where it is the same at every sample: the parent's own joint axis.
#[inline(always)]
fn constant_parent_axis<T: Lane>(simd: Simd<T>, mechanism: &Mechanism, row: &Row) -> Option<(Vector<T>, Vector<T>)> {
    let parent = &mechanism.links[row.link.parent?];
    let axis = &parent.axes[row.axis.above? - parent.first];
    match (axis.above, axis.rate) {
        (None, Rate::Constant(rate)) => {
            Some(JointTransform::at_zero(simd, parent.shape, parent).joint_axis(simd.splat(rate)))
        }
        _ => None,
    }
}

/// Transform an axis at every lane, store it, and contract it while it is in registers.
#[inline(always)]
unsafe fn put_rows<T: Lane, const SET: u32>(
    simd: Simd<T>,
    batch: Batch,
    row: &Row,
    carried: impl Fn(usize) -> (Vector<T>, Vector<T>),
) {
    let (sink, at_zero) = (row.sink.of::<SET>(), JointTransform::at_zero(simd, row.link.shape, row.link));
    for k in batch.lanes(simd) {
        // SAFETY: `lanes` leaves room for a lane in slots, channels and output runs.
        unsafe {
            let mut axis = carried(k);
            if !row.axis.rate.is_zero() {
                axis = at_zero.add_joint_rate(axis, batch.rate(simd, row.axis.rate, k));
            }
            store_axis(row.to, k, axis);
            row.motions.contract(simd, axis, &sink, k);
        }
    }
}

/// Motion of the link from its parent's.
#[inline(always)]
pub(crate) unsafe fn propagate_motion<T: Lane>(
    simd: Simd<T>,
    batch: Batch,
    (shape, i): (JointShape, usize),
    followed: JointChannels,
    slots: &mut KinematicSlots,
) {
    let link = &batch.mechanism.links[i];
    let (at_zero, stored) = (JointTransform::at_zero(simd, shape, link), slots.joint.as_ptr());
    let parent = link.parent.map(|p| LinkMotions(slots.links[p].as_mut_ptr()));
    let own = LinkMotions(slots.links[i].as_mut_ptr());
    for k in batch.lanes(simd) {
        // SAFETY: `lanes` leaves room for a lane; a parent is another link than its child.
        unsafe {
            let [_, v, acceleration] = followed.at(simd, k);
            let joint = at_zero.load(stored, k);
            match parent {
                Some(parent) => own.propagate(simd, parent, &joint, (v, acceleration), k),
                None => own.begin_at_base(simd, batch.mechanism.gravity, &joint, (v, acceleration), k),
            }
        }
    }
}

/// Columns of the terms; rotors are omitted if the rows have `momentum`.
#[inline(always)]
pub(crate) unsafe fn term_rows<T: Lane>(
    simd: Simd<T>,
    batch: Batch,
    momentum: bool,
    places: &EntryMap,
    out: EntryRuns,
    slots: &mut [Slot; 3],
) {
    let mut external = 3 * batch.mechanism.coordinates;
    let mut first = 0;
    for term in &batch.mechanism.terms {
        let own = if term.law == Law::External { external } else { 0 };
        external += usize::from(term.law == Law::External);
        let places_of = |rate: usize| places.term(first + rate).map(|place| out.at(place));
        let requested = (0..term.joint_map.rates.len()).any(|rate| places_of(rate).is_some());
        if requested && !(momentum && term.law == Law::Rotor) {
            // SAFETY: batch and output runs are as in the head of the file; an external term has a channel of its own.
            unsafe {
                let (followed, own) = (batch.follow(simd, &term.joint_map, slots), batch.channels.channel(own));
                for k in batch.lanes(simd) {
                    let [x, v, a] = followed.at(simd, k);
                    let column: T = term.law.column(x, v, a, simd.load(own.add(k)));
                    for (rate, &(_, weight)) in term.joint_map.rates.iter().enumerate() {
                        let Some(place) = places_of(rate) else { continue };
                        column.mul(batch.rate(simd, weight, k)).store(place.add(k));
                    }
                }
            }
        }
        first += term.joint_map.rates.len();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mechanism::Joint;
    use crate::mechanism::closure::Closure;
    use crate::regressor::regressor;
    use crate::simd::dispatch::Backend;

    #[test]
    fn no_pointer_to_a_motion_outlives_the_call() {
        let rotation = [1., 0., 0., 0., 1., 0., 0., 0., 1.];
        let joint = Joint { parent: None, rotation, translation: [0.; 3], prismatic: false };
        for backend in Backend::available() {
            let pendulum =
                Mechanism::new(core::slice::from_ref(&joint), &Closure::open(1), [0., -9.81, 0.], &[], backend)
                    .unwrap();
            for samples in [3, 64] {
                let numbers = vec![0.5; samples];
                let motion = Motion {
                    samples,
                    position: &numbers,
                    velocity: &numbers,
                    acceleration: Some(&numbers),
                    external: &[],
                    loops: &[],
                };
                regressor(&pendulum, &motion, &[5], &mut vec![0.0; samples]).unwrap();
                let kept = WORKSPACE.take().expect("kept for the next call");
                assert!(kept.channels.is_released(), "{backend:?}, {samples} samples");
                WORKSPACE.set(Some(kept));
            }
        }
    }
}
