//! Rows of the observation matrix, a batch of samples at a time, by axes carried forward.
//!
//! The axis of every coordinate is carried from link to link in the links' own frames and contracted there with the
//! link's wrench, `Y[a, i] = s_i^a . A_i(v_i, a_i)`; the 6 x 10 map A_i is never written out. Carrying the axes of
//! the *coordinates* rather than of the joints, `s_i^a = X_i s_parent^a + G[i, a] z`, projects a closed chain's
//! torques onto its motors at no cost (Khalil and Dombre 2002, chapter 10, done without forming the tree's rows).
//!
//! Without accelerations there are two rows for each coordinate in place of one: generalised momentum, and the rest of
//! the torque beside its rate of change (see `momentum_rows`).
//!
//! Safety: [`rows`] is the one door. Behind it channels have whole lanes, slots hold a batch, and the caller's places have
//! room for whole lanes; every unsafe function relies on just that.

use crate::batch::{BATCH, Batch, Channels, Slot, load, store};
use crate::dispatch::dispatched;
use crate::lane::Lane;
use crate::link::{
    JointMotion, JointSlots, LINK_NUMBERS, LinkMotions, contract, contract_slide, contract_turn, link_motion,
};
use crate::mechanism::{Axis, Link, Mechanism, Shape, for_shape};
use crate::momentum_rows::momenta;
use crate::places::{Places, Sink};
use crate::regressor::Motion;
use crate::terms::Law;
use crate::vector::Vector;

/// Both vectors of an axis.
pub(crate) type AxisSlots = [Slot; 6];

/// What one thread needs to make rows; made once, then reused for every batch.
pub(crate) struct Workspace {
    channels: Channels,
    pub(crate) slots: Slots,
}

/// Links and axes at a batch of samples.
pub(crate) struct Slots {
    pub(crate) followed: [Slot; 3],
    pub(crate) joint: JointSlots,
    pub(crate) links: Vec<[Slot; LINK_NUMBERS]>,
    pub(crate) axes: Vec<AxisSlots>,
    /// Rates of change of the axes, where there are no accelerations.
    pub(crate) axis_rates: Vec<AxisSlots>,
}

impl Workspace {
    pub(crate) fn new(mechanism: &Mechanism, motion: &Motion) -> Workspace {
        let changing = if motion.acceleration.is_some() { 0 } else { mechanism.axes };
        let slots = Slots {
            followed: [[0.0; BATCH]; 3],
            joint: [[0.0; BATCH]; 3],
            links: vec![[[0.0; BATCH]; LINK_NUMBERS]; mechanism.links.len()],
            axes: vec![[[0.0; BATCH]; 6]; mechanism.axes],
            axis_rates: vec![[[0.0; BATCH]; 6]; changing],
        };
        Workspace { channels: Channels::new(mechanism), slots }
    }
}

/// Make the rows of samples `from..from + count`. Entry (row, column) of sample `from + k` is written to `out` plus its
/// place plus k, for each of the sets of places: torques, or momenta and then the rest of the torques.
///
/// # Safety
/// Every place has room for `count` rounded up to whole lanes of [`crate::lane::MAX_WIDTH`].
pub(crate) unsafe fn rows(
    mechanism: &Mechanism,
    motion: &Motion,
    from: usize,
    count: usize,
    sets: &[Places],
    out: *mut f64,
    workspace: &mut Workspace,
) {
    debug_assert!(sets.len() == motion.sets());
    let Workspace { channels, slots } = workspace;
    for done in (0..count).step_by(BATCH) {
        let samples = BATCH.min(count - done);
        channels.turn_to(mechanism, motion, from + done, samples);
        let batch = Batch { mechanism, channels, samples };
        unsafe {
            match sets {
                [torque] => torques(mechanism.backend, batch, torque, out.add(done), slots),
                [momentum, rest] => momenta(mechanism.backend, batch, momentum, rest, out.add(done), slots),
                _ => unreachable!("a motion has one set of rows or two"),
            }
        }
    }
}

dispatched! {
    unsafe fn torques = torques_in_lanes(batch: Batch, places: &Places, out: *mut f64, slots: &mut Slots)
}

#[inline(always)]
unsafe fn torques_in_lanes<T: Lane>(batch: Batch, places: &Places, out: *mut f64, slots: &mut Slots) {
    unsafe {
        for i in 0..batch.mechanism.links.len() {
            let link = &batch.mechanism.links[i];
            move_link::<T>(batch, i, slots);
            let motions = LinkMotions(slots.links[i].as_mut_ptr());
            for (own, axis) in (link.first..).zip(&link.axes) {
                let sink = places.axis(own);
                match axis.above {
                    Some(above) => for_shape!(link.shape, shape => carried_rows::<T>(
                        batch, (shape, link), axis, (above, own), motions, &sink, out, slots
                    )),
                    None => first_rows::<T>(batch, link, axis, own, motions, &sink, out, slots),
                }
            }
        }
        term_rows::<T>(batch, false, places, out, &mut slots.followed);
    }
}

/// The joint's motion and the link's, from the parent's.
#[inline(always)]
unsafe fn move_link<T: Lane>(batch: Batch, i: usize, slots: &mut Slots) {
    let link = &batch.mechanism.links[i];
    unsafe {
        let followed = batch.follow::<T>(&link.course, &mut slots.followed);
        let parent = link.parent.map(|p| LinkMotions(slots.links[p].as_mut_ptr()));
        let motions = LinkMotions(slots.links[i].as_mut_ptr());
        for k in batch.lanes::<T>() {
            let [q, v, acceleration] = followed.at(k);
            let joint = JointMotion::new(link, q);
            joint.keep(link, &mut slots.joint, k);
            let parent = parent.map(|parent| parent.at::<T>(k));
            motions.set(k, link_motion(batch.mechanism, link, &joint, parent, v, acceleration));
        }
    }
}

/// An axis carried from the parent to the link, and its entries.
#[inline(always)]
#[allow(clippy::too_many_arguments)]
unsafe fn carried_rows<T: Lane>(
    batch: Batch,
    (shape, link): (Shape, &Link),
    axis: &Axis,
    (above, own): (usize, usize),
    motions: LinkMotions,
    sink: &Sink,
    out: *mut f64,
    slots: &mut Slots,
) {
    let (above, own) = (slots.axes[above].as_ptr(), slots.axes[own].as_mut_ptr());
    for k in batch.lanes::<T>() {
        unsafe {
            let joint = JointMotion::at(shape, link, &slots.joint, k);
            let axis = joint.carry_by(shape, link, get_axis::<T>(above, k), batch.rate(axis.rate, k));
            put_axis(own, k, axis);
            contract(motions, axis, sink, out, k);
        }
    }
}

/// The axis of a coordinate that moves no link before this one, and its entries.
#[inline(always)]
#[allow(clippy::too_many_arguments)]
unsafe fn first_rows<T: Lane>(
    batch: Batch,
    link: &Link,
    axis: &Axis,
    own: usize,
    motions: LinkMotions,
    sink: &Sink,
    out: *mut f64,
    slots: &mut Slots,
) {
    let own = slots.axes[own].as_mut_ptr();
    for k in batch.lanes::<T>() {
        unsafe {
            let rate: T = batch.rate(axis.rate, k);
            put_axis(own, k, JointMotion::own(link, rate));
            match link.slides() {
                true => contract_slide(motions, rate, sink, out, k),
                false => contract_turn(motions, rate, sink, out, k),
            }
        }
    }
}

/// # Safety
/// `slots` are an axis's, and a lane from `k` on is inside them.
#[inline(always)]
pub(crate) unsafe fn get_axis<T: Lane>(slots: *const Slot, k: usize) -> (Vector<T>, Vector<T>) {
    let s: [T; 6] = unsafe { load(slots, k) };
    ([s[0], s[1], s[2]], [s[3], s[4], s[5]])
}

/// # Safety
/// As for [`get_axis`].
#[inline(always)]
pub(crate) unsafe fn put_axis<T: Lane>(slots: *mut Slot, k: usize, (x, u): (Vector<T>, Vector<T>)) {
    unsafe { store(slots, k, [x[0], x[1], x[2], u[0], u[1], u[2]]) }
}

/// The columns of the terms; without those of rotors where `momentum` is wanted of them.
#[inline(always)]
pub(crate) unsafe fn term_rows<T: Lane>(
    batch: Batch,
    momentum: bool,
    places: &Places,
    out: *mut f64,
    slots: &mut [Slot; 3],
) {
    let mut external = 3 * batch.mechanism.coordinates;
    let mut first = 0;
    for term in &batch.mechanism.terms {
        let own = if term.law == Law::External { external } else { 0 };
        external += usize::from(term.law == Law::External);
        let places_of = |rate: usize| places.term(first + rate).map(|place| unsafe { out.add(place) });
        let wanted = (0..term.course.rates.len()).any(|rate| places_of(rate).is_some());
        if wanted && !(momentum && term.law == Law::Rotor) {
            unsafe {
                let (followed, own) = (batch.follow::<T>(&term.course, slots), batch.channels.channel(own));
                for k in batch.lanes::<T>() {
                    let [x, v, a] = followed.at(k);
                    let column: T = term.law.column(x, v, a, T::load(own.add(k)));
                    for (rate, &(_, weight)) in term.course.rates.iter().enumerate() {
                        let Some(place) = places_of(rate) else { continue };
                        column.mul(batch.rate(weight, k)).store(place.add(k));
                    }
                }
            }
        }
        first += term.course.rates.len();
    }
}
