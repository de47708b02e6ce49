//! Rows without accelerations: the generalised momentum of every coordinate, and the remainder of its torque. The
//! recursion and its formulas are in [`crate::batch::link_velocity`].
//!
//! Safety: as in [`mod@crate::regressor::rows`].

use crate::batch::axis::{AxisSlots, load_axis, store_axis, store_transform};
use crate::batch::link_velocity::LinkVelocities;
use crate::batch::sink::{EntryRuns, for_set};
use crate::batch::{Batch, JointChannels};
use crate::linalg::vector::zero;
use crate::mechanism::layout::EntryMap;
use crate::mechanism::shape::{JointShape, for_shape};
use crate::mechanism::terms::Law;
use crate::mechanism::transform::{JointTransform, TransformSlots};
use crate::mechanism::{Axis, Link};
use crate::memory::slot::Slot;
use crate::regressor::rows::{KinematicSlots, term_rows};
use crate::simd::dispatch::dispatched;
use crate::simd::lane::Lane;
use crate::simd::token::Simd;

dispatched! {
    /// Rows of a batch: momenta, and remainders.
    ///
    /// # Safety
    ///
    /// As for [`crate::regressor::rows::rows`].
    pub(crate) unsafe fn momentum_rows = momentum_rows_in_lanes(
        batch: Batch, momentum: &EntryMap, remainder: &EntryMap, out: EntryRuns, slots: &mut KinematicSlots,
    )
}

#[inline(always)]
unsafe fn momentum_rows_in_lanes<T: Lane>(
    simd: Simd<T>,
    batch: Batch,
    momentum: &EntryMap,
    remainder: &EntryMap,
    out: EntryRuns,
    slots: &mut KinematicSlots,
) {
    // SAFETY: batch, slots and output runs are as in the head of the file.
    unsafe {
        for (i, link) in batch.mechanism.links.iter().enumerate() {
            let followed = batch.follow(simd, &link.joint_map, &mut slots.followed);
            store_transform(simd, batch, link, followed, &mut slots.joint);
            for_shape!(link.shape, shape => propagate_motion(simd, batch, (shape, i), followed, slots));
            let velocities = LinkVelocities(slots.links[i].as_mut_ptr());
            for (own, axis) in (link.first..).zip(&link.axes) {
                let (momenta, remainders) = (momentum.axis(own, out), remainder.axis(own, out));
                propagate_axis(simd, batch, link, axis, own, &mut slots.axes, &slots.joint);
                axis_rate(simd, batch, (link, velocities), axis, own, slots);
                let (axis, rate) = (slots.axes[own].as_ptr(), slots.axis_rates[own].as_ptr());
                for_set!(momenta, SET => velocities.contract::<T, SET>(simd, batch, axis, &momenta));
                for_set!(remainders, SET => velocities.contract_rest::<T, SET>(simd, batch, (axis, rate), &remainders));
            }
        }
        rotor_momenta(simd, batch, (momentum, remainder), out, slots);
        term_rows(simd, batch, true, remainder, out, &mut slots.followed);
    }
}

/// Velocity of the link from its parent's.
#[inline(always)]
unsafe fn propagate_motion<T: Lane>(
    simd: Simd<T>,
    batch: Batch,
    (shape, i): (JointShape, usize),
    followed: JointChannels,
    slots: &mut KinematicSlots,
) {
    let link = &batch.mechanism.links[i];
    let (at_zero, stored) = (JointTransform::at_zero(simd, shape, link), slots.joint.as_ptr());
    let parent = link.parent.map(|p| LinkVelocities(slots.links[p].as_mut_ptr()));
    let own = LinkVelocities(slots.links[i].as_mut_ptr());
    for k in batch.lanes(simd) {
        // SAFETY: `lanes` leaves room for a lane; a parent is another link than its child.
        unsafe {
            let ([_, speed, _], joint) = (followed.at(simd, k), at_zero.load(stored, k));
            match parent {
                Some(parent) => own.propagate(simd, parent, &joint, speed, k),
                None => own.begin_at_base(simd, batch.mechanism.gravity, &joint, speed, k),
            }
        }
    }
}

/// Axis of a coordinate from its parent's.
#[inline(always)]
pub(crate) unsafe fn propagate_axis<T: Lane>(
    simd: Simd<T>,
    batch: Batch,
    link: &Link,
    axis: &Axis,
    own: usize,
    axes: &mut [AxisSlots],
    joint: &TransformSlots,
) {
    let (at_zero, to) = (JointTransform::at_zero(simd, link.shape, link), axes[own].as_mut_ptr());
    // SAFETY: `lanes` leaves room for a lane; an axis on the parent is another than the link's own.
    unsafe {
        if let Some(above) = axis.above {
            let above = axes[above].as_ptr();
            transform_axis(batch.mechanism.backend, batch, link, above, to, joint.as_ptr());
            if !axis.rate.is_zero() {
                for k in batch.lanes(simd) {
                    store_axis(to, k, at_zero.add_joint_rate(load_axis(simd, to, k), batch.rate(simd, axis.rate, k)));
                }
            }
        } else {
            for k in batch.lanes(simd) {
                store_axis(to, k, at_zero.joint_axis(batch.rate(simd, axis.rate, k)));
            }
        }
    }
}

dispatched! {
    /// Transform an axis, or its rate, from the parent's slots to the link's.
    ///
    /// # Safety
    ///
    /// As in the head of the file; the slots are those of different axes.
    unsafe fn transform_axis = transform_axis_in_lanes(
        batch: Batch, link: &Link, from: *const Slot, to: *mut Slot, joint: *const Slot,
    )
}

#[inline(always)]
unsafe fn transform_axis_in_lanes<T: Lane>(
    simd: Simd<T>,
    batch: Batch,
    link: &Link,
    from: *const Slot,
    to: *mut Slot,
    joint: *const Slot,
) {
    for_shape!(link.shape, shape => {
        let at_zero = JointTransform::at_zero(simd, shape, link);
        for k in batch.lanes(simd) {
            // SAFETY: `lanes` leaves room for a lane in the slots of joint and axes.
            unsafe { store_axis(to, k, at_zero.load(joint, k).transform_axis(load_axis(simd, from, k))) };
        }
    })
}

/// Rate of a coordinate's axis from that of its axis on the parent.
#[inline(always)]
unsafe fn axis_rate<T: Lane>(
    simd: Simd<T>,
    batch: Batch,
    (link, velocities): (&Link, LinkVelocities),
    axis: &Axis,
    own: usize,
    slots: &mut KinematicSlots,
) {
    let (at_zero, to) = (JointTransform::at_zero(simd, link.shape, link), slots.axis_rates[own].as_mut_ptr());
    // SAFETY: batch and slots are as in the head of the file.
    unsafe {
        if let Some(above) = axis.above {
            let (above, joint) = (slots.axis_rates[above].as_ptr(), slots.joint.as_ptr());
            transform_axis(batch.mechanism.backend, batch, link, above, to, joint);
        } else {
            batch.lanes(simd).for_each(|k| store_axis::<T>(to, k, (zero(simd), zero(simd))));
        }
        if !axis.rate.is_zero() {
            for k in batch.lanes(simd) {
                let turned = velocities.turn_axis(
                    simd,
                    link.is_prismatic(),
                    load_axis(simd, to, k),
                    batch.rate(simd, axis.rate, k),
                    k,
                );
                let changed = batch
                    .rate_derivative(simd, axis.rate, k)
                    .map_or(turned, |change| at_zero.add_joint_rate(turned, change));
                store_axis(to, k, changed);
            }
        }
    }
}

/// Of the terms only rotors have momentum; the remainder of their torque comes from a varying rate. The other terms
/// have no entries among the momenta.
#[inline(always)]
unsafe fn rotor_momenta<T: Lane>(
    simd: Simd<T>,
    batch: Batch,
    (momentum, remainder): (&EntryMap, &EntryMap),
    out: EntryRuns,
    slots: &mut KinematicSlots,
) {
    let mut first = 0;
    for term in &batch.mechanism.terms {
        let rates = &term.joint_map.rates;
        if term.law == Law::Rotor {
            // SAFETY: batch and output runs are as in the head of the file.
            unsafe {
                let followed = batch.follow(simd, &term.joint_map, &mut slots.followed);
                for (number, &(_, rate)) in (first..).zip(rates) {
                    let (momentum, remainder) = (momentum.term(number), remainder.term(number));
                    for k in batch.lanes(simd) {
                        let [_, speed, _]: [T; 3] = followed.at(simd, k);
                        let change = batch
                            .rate_derivative(simd, rate, k)
                            .map_or(simd.splat(0.0), |change: T| speed.mul(change).neg());
                        let put = |place: Option<usize>, entry: T| {
                            if let Some(place) = place {
                                entry.store(out.at(place).add(k));
                            }
                        };
                        put(momentum, speed.mul(batch.rate(simd, rate, k)));
                        put(remainder, change);
                    }
                }
            }
        }
        first += rates.len();
    }
}
