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
        let reused = mechanism.places * mechanism.coordinates;
        grow(&mut self.slots.axes, mechanism.axes.max(reused), [Slot::ZERO; 6]);
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
                [torque] => torques(mechanism.backend, batch, Kept::Needed, torque, out.from(done), slots),
                [momentum, remainder] => {
                    momentum_rows(mechanism.backend, batch, momentum, remainder, out.from(done), slots)
                }
                _ => unreachable!("a motion has one set of rows or two"),
            }
        }
    }
}

/// Which motions and axes stay in the slots.
#[derive(Clone, Copy, PartialEq)]
pub(crate) enum Kept {
    /// Those of all links, each in the slots of its number: a reverse sweep reads them.
    All,
    /// Those of links with children to come: fewer slots stay in the first cache, beside the entries that pass it.
    Needed,
}

impl Kept {
    /// Slots of a link's motion, and of its first axis.
    #[inline(always)]
    fn slots(self, mechanism: &Mechanism, i: usize) -> (usize, usize) {
        let link = &mechanism.links[i];
        match self {
            Kept::All => (i, link.first),
            Kept::Needed => (link.place, link.place * mechanism.coordinates),
        }
    }
}

dispatched! {
    /// Rows of the torques of a batch.
    ///
    /// # Safety
    ///
    /// As for [`rows`], and the batch is as described in [`crate::batch`].
    pub(crate) unsafe fn torques = torques_in_lanes(
        batch: Batch, kept: Kept, places: &EntryMap, out: EntryRuns, slots: &mut KinematicSlots,
    )
}

#[inline(always)]
unsafe fn torques_in_lanes<T: Lane>(
    simd: Simd<T>,
    batch: Batch,
    kept: Kept,
    places: &EntryMap,
    out: EntryRuns,
    slots: &mut KinematicSlots,
) {
    let mechanism = batch.mechanism;
    for (i, link) in batch.mechanism.links.iter().enumerate() {
        // SAFETY: batch, slots and output runs are as in the head of the file; `own` is an axis of the mechanism.
        unsafe {
            let followed = batch.follow(simd, &link.joint_map, &mut slots.followed);
            store_transform(simd, batch, link, followed, &mut slots.joint);
            let (own, first) = kept.slots(mechanism, i);
            let above = link.parent.map(|parent| kept.slots(mechanism, parent));
            let motions = LinkMotions(slots.links[own].as_mut_ptr());
            let parent = above.map(|(parent, _)| LinkMotions(slots.links[parent].as_mut_ptr()));
            for_shape!(link.shape, shape => {
                propagate_motion(simd, batch, (shape, link), followed, &slots.joint, (parent, motions))
            });
            let axes = slots.axes.as_mut_ptr();
            let rows = LinkRows {
                link,
                motions,
                joint: slots.joint.as_ptr(),
                to: axes.add(first),
                from: above.map_or(axes, |(_, first)| axes.add(first)),
                places,
                out,
            };
            for (k, axis) in link.axes.iter().enumerate().filter(|(_, axis)| axis.above.is_none()) {
                own_rows(simd, batch, &rows.row(k, axis));
            }
            if link.axes.iter().any(|axis| axis.above.is_some()) {
                inherited_rows(mechanism.backend, batch, rows);
            }
        }
    }
    // SAFETY: as above.
    unsafe { term_rows(simd, batch, false, places, out, &mut slots.followed) };
}

/// Rows of all coordinates on one link: the motion of the link, its axes and those on the parent, and the output of the
/// entries.
#[derive(Clone, Copy)]
struct LinkRows<'a> {
    link: &'a Link,
    motions: LinkMotions,
    joint: *const Slot,
    to: *mut AxisSlots,
    from: *const AxisSlots,
    places: &'a EntryMap,
    out: EntryRuns,
}

impl<'a> LinkRows<'a> {
    /// That of axis `k` of the link.
    #[inline(always)]
    fn row(self, k: usize, axis: &Axis) -> Row<'a> {
        let LinkRows { link, motions, joint, to, places, out, .. } = self;
        let sink = places.axis(link.first + k, out);
        Row { link, rate: axis.rate, motions, joint, to: to.wrapping_add(k).cast(), sink }
    }
}

/// One coordinate on one link: its axis, and the output of its entries.
#[derive(Clone, Copy)]
struct Row<'a> {
    link: &'a Link,
    rate: Rate,
    motions: LinkMotions,
    joint: *const Slot,
    to: *mut Slot,
    sink: EntrySink<'a>,
}

/// Entries of a coordinate that moves this link's joint and none before it. The axis is stored only where it varies.
#[inline(always)]
unsafe fn own_rows<T: Lane>(simd: Simd<T>, batch: Batch, row: &Row) {
    let (link, rate) = (row.link, row.rate);
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
    /// Entries of the coordinates that move the parent too.
    ///
    /// # Safety
    ///
    /// As for [`rows`].
    unsafe fn inherited_rows = inherited_rows_in_lanes(batch: Batch, rows: LinkRows)
}

#[inline(always)]
unsafe fn inherited_rows_in_lanes<T: Lane>(simd: Simd<T>, batch: Batch, rows: LinkRows) {
    let link = rows.link;
    // SAFETY: batch, slots and output runs are as in the head of the file; the numbers are those of the link's axes.
    unsafe {
        // The axes on the parent that are the same at every sample come first, by themselves.
        for (k, axis) in link.axes.iter().enumerate() {
            if let Some((parent, rate)) = constant_parent_rate(batch.mechanism, link, axis) {
                let above = JointTransform::at_zero(simd, parent.shape, parent).joint_axis(simd.splat(rate));
                constant_axis_rows(simd, batch, rows.row(k, axis), above);
            }
        }
        for_shape!(link.shape, shape => {
            let at_zero = JointTransform::at_zero(simd, shape, link);
            for (k, axis) in link.axes.iter().enumerate() {
                let Some(above) = axis.above else { continue };
                if constant_parent_rate(batch.mechanism, link, axis).is_some() {
                    continue;
                }
                let number = above - batch.mechanism.links[link.parent.unwrap_or(0)].first;
                let (row, above) = (rows.row(k, axis), rows.from.add(number).cast::<Slot>());
                for_set!(row.sink, SET => {
                    put_rows::<T, SET>(simd, batch, row, |k| {
                        at_zero.load(row.joint, k).transform_axis(load_axis(simd, above, k))
                    });
                });
            }
        });
    }
}

/// Entries of a coordinate whose axis on the parent, in the parent's frame, is the same at every sample.
#[inline(always)]
unsafe fn constant_axis_rows<T: Lane>(simd: Simd<T>, batch: Batch, row: Row, above: (Vector<T>, Vector<T>)) {
    let link = row.link;
    let at_zero = JointTransform::at_zero(simd, link.shape, link);
    // SAFETY: batch, slots and output runs are as in the head of the file.
    unsafe {
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
    }
}

/// The parent and the rate of its joint, where the axis on the parent is the joint's own and the same at every sample.
#[inline(always)]
fn constant_parent_rate<'a>(mechanism: &'a Mechanism, link: &Link, axis: &Axis) -> Option<(&'a Link, f64)> {
    let parent = &mechanism.links[link.parent?];
    let above = &parent.axes[axis.above? - parent.first];
    match (above.above, above.rate) {
        (None, Rate::Constant(rate)) => Some((parent, rate)),
        _ => None,
    }
}

/// Transform an axis at every lane, store it, and contract it while it is in registers.
#[inline(always)]
unsafe fn put_rows<T: Lane, const SET: u32>(
    simd: Simd<T>,
    batch: Batch,
    row: Row,
    carried: impl Fn(usize) -> (Vector<T>, Vector<T>),
) {
    let (sink, at_zero) = (row.sink.of::<SET>(), JointTransform::at_zero(simd, row.link.shape, row.link));
    let moves = !row.rate.is_zero();
    for k in batch.lanes(simd) {
        // SAFETY: `lanes` leaves room for a lane in slots, channels and output runs.
        unsafe {
            let mut axis = carried(k);
            if moves {
                axis = at_zero.add_joint_rate(axis, batch.rate(simd, row.rate, k));
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
    (shape, link): (JointShape, &Link),
    followed: JointChannels,
    joint: &TransformSlots,
    (parent, own): (Option<LinkMotions>, LinkMotions),
) {
    let at_zero = JointTransform::at_zero(simd, shape, link);
    for k in batch.lanes(simd) {
        // SAFETY: `lanes` leaves room for a lane; the slots of a parent are others than its child's.
        unsafe {
            let [_, v, acceleration] = followed.at(simd, k);
            let joint = at_zero.load(joint.as_ptr(), k);
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
