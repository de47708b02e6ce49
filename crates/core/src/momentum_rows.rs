//! Rows without accelerations, a batch of samples at a time: of every coordinate its momentum, and the rest of its
//! torque beside the momentum's rate of change. The recursion and its formulas are in `momentum`.

use crate::batch::Batch;
use crate::dispatch::dispatched;
use crate::lane::Lane;
use crate::link::JointMotion;
use crate::mechanism::{Axis, Link};
use crate::momentum::{LinkVelocity, axis_rate, contract_momentum, contract_rest, link_velocity};
use crate::places::Places;
use crate::rows::{Slots, get_axis, put_axis, term_rows};
use crate::terms::Law;

dispatched! {
    /// # Safety
    /// As for [`crate::rows::rows`].
    pub(crate) unsafe fn momenta = momenta_in_lanes(
        batch: Batch, momentum: &Places, rest: &Places, out: *mut f64, slots: &mut Slots,
    )
}

#[inline(always)]
unsafe fn momenta_in_lanes<T: Lane>(batch: Batch, momentum: &Places, rest: &Places, out: *mut f64, slots: &mut Slots) {
    unsafe {
        for i in 0..batch.mechanism.links.len() {
            let link = &batch.mechanism.links[i];
            move_link::<T>(batch, i, slots);
            for (slot, axis) in (link.first..).zip(&link.axes) {
                axis_momenta::<T>(batch, (i, link), (slot, axis), slots, (momentum, rest), out);
            }
        }
        rotor_momenta::<T>(batch, (momentum, rest), out, slots);
        term_rows::<T>(batch, true, rest, out, &mut slots.followed);
    }
}

#[inline(always)]
unsafe fn move_link<T: Lane>(batch: Batch, i: usize, slots: &mut Slots) {
    let link = &batch.mechanism.links[i];
    unsafe {
        let followed = batch.follow::<T>(&link.course, &mut slots.followed);
        let parent = link.parent.map(|p| slots.links[p].as_ptr());
        let own = slots.links[i].as_mut_ptr();
        for k in batch.lanes::<T>() {
            let [q, speed, _] = followed.at(k);
            let joint = JointMotion::new(link, q);
            joint.keep(link, &mut slots.joint, k);
            let parent = parent.map(|parent| LinkVelocity::<T>::at(parent, k));
            link_velocity(batch.mechanism, link, &joint, parent, speed).store(own, k);
        }
    }
}

#[inline(always)]
unsafe fn axis_momenta<T: Lane>(
    batch: Batch,
    (i, link): (usize, &Link),
    (slot, axis): (usize, &Axis),
    slots: &mut Slots,
    (momentum, rest): (&Places, &Places),
    out: *mut f64,
) {
    let (momenta, rests) = (momentum.axis(slot), rest.axis(slot));
    let moves = !axis.rate.is_zero();
    unsafe {
        let above = axis.above.map(|k| (slots.axes[k].as_ptr(), slots.axis_rates[k].as_ptr()));
        let (own, own_rate) = (slots.axes[slot].as_mut_ptr(), slots.axis_rates[slot].as_mut_ptr());
        for k in batch.lanes::<T>() {
            let velocity = LinkVelocity::<T>::at(slots.links[i].as_ptr(), k);
            let joint = JointMotion::at(link.shape, link, &slots.joint, k);
            let above = above.map(|(axis, rate)| (get_axis::<T>(axis, k), get_axis::<T>(rate, k)));
            let (rate, change) = (batch.rate(axis.rate, k), batch.change(axis.rate, k));
            let (x, u) = match above {
                Some(((x, u), _)) => joint.carry(link, x, u, rate),
                None => JointMotion::own(link, rate),
            };
            put_axis(own, k, (x, u));
            momenta.put(out, k, 0, contract_momentum(&velocity, x, u));
            let change = axis_rate(&velocity, link, &joint, above.map(|pair| pair.1), moves.then_some(rate), change);
            put_axis(own_rate, k, change);
            rests.put(out, k, 0, contract_rest(&velocity, (x, u), change));
        }
    }
}

/// Of the terms only rotors have momentum; what is left of their torque is that of a rate that changes. The others' runs
/// stay zero.
#[inline(always)]
unsafe fn rotor_momenta<T: Lane>(batch: Batch, (momentum, rest): (&Places, &Places), out: *mut f64, slots: &mut Slots) {
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
                                entry.store(out.add(place + k));
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
