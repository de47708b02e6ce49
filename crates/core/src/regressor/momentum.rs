//! Rows without accelerations, a batch of samples at a time: of every coordinate its momentum, and the rest of its
//! torque beside the momentum's rate of change. The recursion and its formulas are in `momentum`.

use crate::batch::axis::{AxisSlots, get_axis, put_axis, turn};
use crate::batch::link_velocity::LinkVelocities;
use crate::batch::sink::{Runs, for_set};
use crate::batch::{Batch, Followed};
use crate::linalg::vector::zero;
use crate::mechanism::layout::Places;
use crate::mechanism::shape::{Shape, for_shape};
use crate::mechanism::terms::Law;
use crate::mechanism::transform::{JointMotion, JointSlots};
use crate::mechanism::{Axis, Link};
use crate::memory::slot::Slot;
use crate::regressor::rows::{Slots, term_rows};
use crate::simd::dispatch::dispatched;
use crate::simd::lane::Lane;

dispatched! {
    /// # Safety
    /// As for [`crate::regressor::rows::rows`].
    pub(crate) unsafe fn momenta = momenta_in_lanes(
        batch: Batch, momentum: &Places, rest: &Places, out: Runs, slots: &mut Slots,
    )
}

#[inline(always)]
unsafe fn momenta_in_lanes<T: Lane>(batch: Batch, momentum: &Places, rest: &Places, out: Runs, slots: &mut Slots) {
    unsafe {
        for (i, link) in batch.mechanism.links.iter().enumerate() {
            let followed = batch.follow::<T>(&link.course, &mut slots.followed);
            turn::<T>(batch, link, followed, &mut slots.joint);
            for_shape!(link.shape, shape => move_link::<T>(batch, (shape, i), followed, slots));
            let velocities = LinkVelocities(slots.links[i].as_mut_ptr());
            for (own, axis) in (link.first..).zip(&link.axes) {
                let (momenta, rests) = (momentum.axis(own, out), rest.axis(own, out));
                carry_axis::<T>(batch, link, axis, own, &mut slots.axes, &slots.joint);
                carry_rate::<T>(batch, (link, velocities), axis, own, slots);
                let (axis, rate) = (slots.axes[own].as_ptr(), slots.axis_rates[own].as_ptr());
                for_set!(momenta, SET => velocities.contract::<T, SET>(batch, axis, &momenta));
                for_set!(rests, SET => velocities.contract_rest::<T, SET>(batch, (axis, rate), &rests));
            }
        }
        rotor_momenta::<T>(batch, (momentum, rest), out, slots);
        term_rows::<T>(batch, true, rest, out, &mut slots.followed);
    }
}

/// The link's velocity, from the parent's.
#[inline(always)]
unsafe fn move_link<T: Lane>(batch: Batch, (shape, i): (Shape, usize), followed: Followed, slots: &mut Slots) {
    let link = &batch.mechanism.links[i];
    let (rest, kept) = (JointMotion::<T>::rest(shape, link), slots.joint.as_ptr());
    let parent = link.parent.map(|p| LinkVelocities(slots.links[p].as_mut_ptr()));
    let own = LinkVelocities(slots.links[i].as_mut_ptr());
    for k in batch.lanes::<T>() {
        unsafe {
            let ([_, speed, _], joint) = (followed.at(k), rest.kept(kept, k));
            match parent {
                Some(parent) => own.follow(parent, &joint, speed, k),
                None => own.begin(batch.mechanism.gravity, &joint, speed, k),
            }
        }
    }
}

/// The axis of a coordinate, from the parent's.
#[inline(always)]
pub(crate) unsafe fn carry_axis<T: Lane>(
    batch: Batch,
    link: &Link,
    axis: &Axis,
    own: usize,
    axes: &mut [AxisSlots],
    joint: &JointSlots,
) {
    let (rest, to) = (JointMotion::<T>::rest(link.shape, link), axes[own].as_mut_ptr());
    unsafe {
        if let Some(above) = axis.above {
            let above = axes[above].as_ptr();
            carry(batch.mechanism.backend, batch, link, above, to, joint.as_ptr());
            if !axis.rate.is_zero() {
                for k in batch.lanes::<T>() {
                    put_axis(to, k, rest.moved(get_axis(to, k), batch.rate(axis.rate, k)));
                }
            }
        } else {
            for k in batch.lanes::<T>() {
                put_axis(to, k, rest.own(batch.rate(axis.rate, k)));
            }
        }
    }
}

dispatched! {
    /// An axis, or its rate of change, from the parent's slots to the link's.
    ///
    /// # Safety
    /// As for [`rows`].
    unsafe fn carry = carry_in_lanes(
        batch: Batch, link: &Link, from: *const Slot, to: *mut Slot, joint: *const Slot,
    )
}

#[inline(always)]
unsafe fn carry_in_lanes<T: Lane>(batch: Batch, link: &Link, from: *const Slot, to: *mut Slot, joint: *const Slot) {
    for_shape!(link.shape, shape => {
        let rest = JointMotion::<T>::rest(shape, link);
        for k in batch.lanes::<T>() {
            unsafe { put_axis(to, k, rest.kept(joint, k).carry(get_axis(from, k))) };
        }
    })
}

/// The rate of change of a coordinate's axis, from that of its axis on the parent.
#[inline(always)]
unsafe fn carry_rate<T: Lane>(
    batch: Batch,
    (link, velocities): (&Link, LinkVelocities),
    axis: &Axis,
    own: usize,
    slots: &mut Slots,
) {
    let (rest, to) = (JointMotion::<T>::rest(link.shape, link), slots.axis_rates[own].as_mut_ptr());
    unsafe {
        if let Some(above) = axis.above {
            let (above, joint) = (slots.axis_rates[above].as_ptr(), slots.joint.as_ptr());
            carry(batch.mechanism.backend, batch, link, above, to, joint);
        } else {
            batch.lanes::<T>().for_each(|k| put_axis::<T>(to, k, (zero(), zero())));
        }
        if !axis.rate.is_zero() {
            for k in batch.lanes::<T>() {
                let turned = velocities.turn_axis(link.slides(), get_axis(to, k), batch.rate(axis.rate, k), k);
                let changed = batch.change(axis.rate, k).map_or(turned, |change| rest.moved(turned, change));
                put_axis(to, k, changed);
            }
        }
    }
}

/// Of the terms only rotors have momentum; what is left of their torque is that of a rate that changes. The others
/// have no place among the momenta.
#[inline(always)]
unsafe fn rotor_momenta<T: Lane>(batch: Batch, (momentum, rest): (&Places, &Places), out: Runs, slots: &mut Slots) {
    let mut first = 0;
    for term in &batch.mechanism.terms {
        let rates = &term.course.rates;
        if term.law == Law::Rotor {
            unsafe {
                let followed = batch.follow::<T>(&term.course, &mut slots.followed);
                for (number, &(_, rate)) in (first..).zip(rates) {
                    let (momentum, rest) = (momentum.term(number), rest.term(number));
                    for k in batch.lanes::<T>() {
                        let [_, speed, _]: [T; 3] = followed.at(k);
                        let change = batch.change(rate, k).map_or(T::splat(0.0), |change: T| speed.mul(change).neg());
                        let put = |place: Option<usize>, entry: T| {
                            if let Some(place) = place {
                                entry.store(out.at(place).add(k));
                            }
                        };
                        put(momentum, speed.mul(batch.rate(rate, k)));
                        put(rest, change);
                    }
                }
            }
        }
        first += rates.len();
    }
}
