//! Slopes of a weighed sum of entries of the rows, by all channels: the way of [`crate::rows`], gone backwards.
//!
//! An entry is made of an axis and of numbers of the link's motion. How the sum changes with these is found link by link,
//! the last one first, and carried to the parent as axes and motions were carried from it (reverse accumulation: Griewank
//! and Walther 2008, section 3.2). So one sweep gives the slopes by all channels, however many there are, and costs about
//! three times what the entries cost.
//!
//! A closure given to an array's `map` is compiled by itself, without the lane's instructions: there is none here.
//!
//! Safety: as in [`crate::rows`]. [`forward`] comes before [`sweep`], for the same batch; weights have a batch in each run.

use crate::batch::axis::{AxisSlots, load_axis, store_axis, store_transform};
use crate::batch::link::{A, B, LinkMotions, W, WD};
use crate::batch::{Batch, JointChannels};
use crate::linalg::vector::{Vector, add, cross, cross_add, dot, scale_add, zero};
use crate::mechanism::closure::{JointMap, Rate};
use crate::mechanism::shape::{JointShape, for_shape};
use crate::mechanism::terms::Law;
use crate::mechanism::transform::JointTransform;
use crate::mechanism::{Axis, LINK_PARAMETERS, Link, Mechanism};
use crate::memory::shared::SharedOutput;
use crate::memory::slot::grow;
use crate::memory::slot::{BATCH, Slot, load, store};
use crate::regressor::momentum::propagate_axis;
use crate::regressor::rows::{KinematicSlots, propagate_motion};
use crate::simd::dispatch::dispatched;
use crate::simd::lane::Lane;
use std::ops::Range;

/// Slopes by a link's motion: by angular velocity, angular acceleration, and acceleration of the origin.
type LinkAdjoint = [Slot; 9];

/// Slopes by what the rows are made of, at a batch of samples.
#[derive(Default)]
pub(crate) struct Adjoint {
    links: Vec<LinkAdjoint>,
    axes: Vec<AxisSlots>,
    /// By position, velocity and acceleration of the joint, or term, whose turn it is.
    joint: [Slot; 3],
    /// By the channels of the motion.
    pub(crate) channels: Vec<Slot>,
}

impl Adjoint {
    /// All slopes that weights lead to zero, and room for those of the mechanism.
    fn clear(&mut self, mechanism: &Mechanism, weights: &Weights) {
        grow(&mut self.links, mechanism.links.len(), [Slot::ZERO; 9]);
        grow(&mut self.axes, mechanism.axes, [Slot::ZERO; 6]);
        grow(&mut self.channels, mechanism.channels(), Slot::ZERO);
        self.links[..mechanism.links.len()].fill([Slot::ZERO; 9]);
        let reachable = self.axes.iter_mut().zip(&weights.axes).filter(|(_, weights)| weights.1);
        reachable.for_each(|(axis, _)| *axis = [Slot::ZERO; 6]);
        self.channels[..mechanism.channels()].fill(Slot::ZERO);
    }

    /// Copy the channels' slopes to some samples of rows of `n`, the first of which has the given number.
    ///
    /// # Safety
    /// The rows are inside `out`, and nobody else uses these samples.
    pub(crate) unsafe fn copy(
        &self,
        mechanism: &Mechanism,
        first: usize,
        out: SharedOutput,
        n: usize,
        samples: Range<usize>,
    ) {
        for (row, slot) in (first..).zip(&self.channels[..mechanism.channels()]) {
            let to = unsafe { out.at(row * n + samples.start) };
            unsafe { core::ptr::copy_nonoverlapping(slot.0.as_ptr(), to, samples.len()) };
        }
    }
}

/// Where the weights of the entries are: runs of a batch, the first of which is all zeros.
pub(crate) struct Weights {
    /// By axis of the mechanism: runs of its entries, and whether it, or an axis made from it, has a weight.
    axes: Vec<([usize; LINK_PARAMETERS], bool)>,
    /// Whether an entry of the axis itself has a weight.
    own: Vec<bool>,
    /// By term, and by the coordinates that move it.
    terms: Vec<usize>,
}

impl Weights {
    /// `run(row, column)` is the number of an entry's run, 0 where it has no weight.
    pub(crate) fn new(mechanism: &Mechanism, run: impl Fn(usize, usize) -> usize) -> Weights {
        let (mut axes, mut own, mut terms) = (Vec::new(), Vec::new(), Vec::new());
        for (i, link) in mechanism.links.iter().enumerate() {
            for axis in &link.axes {
                let runs: [usize; LINK_PARAMETERS] =
                    core::array::from_fn(|p| run(axis.coordinate, LINK_PARAMETERS * i + p));
                own.push(runs.iter().any(|&run| run != 0));
                axes.push((runs, own[own.len() - 1]));
            }
        }
        for link in mechanism.links.iter().rev() {
            for (k, axis) in (link.first..).zip(&link.axes) {
                if let Some(above) = axis.above {
                    axes[above].1 |= axes[k].1;
                }
            }
        }
        for (c, term) in (mechanism.inertial_columns()..).zip(&mechanism.terms) {
            terms.extend(term.joint_map.rates.iter().map(|rate| run(rate.0, c)));
        }
        Weights { axes, own, terms }
    }
}

dispatched! {
    /// Links and axes of a batch into `slots`.
    pub(crate) unsafe fn forward_sweep = forward_in_lanes(batch: Batch, slots: &mut KinematicSlots)
}

#[inline(always)]
unsafe fn forward_in_lanes<T: Lane>(batch: Batch, slots: &mut KinematicSlots) {
    for (i, link) in batch.mechanism.links.iter().enumerate() {
        unsafe {
            let followed = batch.follow::<T>(&link.joint_map, &mut slots.followed);
            store_transform::<T>(batch, link, followed, &mut slots.joint);
            for_shape!(link.shape, shape => propagate_motion::<T>(batch, (shape, i), followed, slots));
            for (own, axis) in (link.first..).zip(&link.axes) {
                propagate_axis::<T>(batch, link, axis, own, &mut slots.axes, &slots.joint);
            }
        }
    }
}

/// Slopes of the sum over entries of weight times entry, into `adjoint.channels`. `first` is the first run of weights.
///
/// # Safety
/// See the head of the file.
pub(crate) unsafe fn reverse_sweep(
    batch: Batch,
    weights: &Weights,
    first: *const f64,
    slots: &mut KinematicSlots,
    adjoint: &mut Adjoint,
) {
    adjoint.clear(batch.mechanism, weights);
    unsafe { reverse(batch.mechanism.backend, batch, weights, first, slots, adjoint) };
}

dispatched! {
    unsafe fn reverse = reverse_in_lanes(
        batch: Batch, weights: &Weights, first: *const f64, slots: &mut KinematicSlots, adjoint: &mut Adjoint,
    )
}

#[inline(always)]
unsafe fn reverse_in_lanes<T: Lane>(
    batch: Batch,
    weights: &Weights,
    first: *const f64,
    slots: &mut KinematicSlots,
    adjoint: &mut Adjoint,
) {
    for (i, link) in batch.mechanism.links.iter().enumerate().rev() {
        unsafe {
            let followed = batch.follow::<T>(&link.joint_map, &mut slots.followed);
            store_transform::<T>(batch, link, followed, &mut slots.joint);
            adjoint.joint.fill(Slot::ZERO);
            for (own, axis) in (link.first..).zip(&link.axes) {
                if weights.own[own] {
                    let runs = weights.axes[own].0.map(|run| first.add(run * BATCH));
                    let motions = LinkMotions(slots.links[i].as_mut_ptr());
                    entry_adjoint::<T>(batch, runs, (motions, slots.axes[own].as_ptr()), adjoint, (i, own));
                }
                if weights.axes[own].1 {
                    for_shape!(link.shape, shape => axis_adjoint::<T>(batch, (shape, link), axis, own, slots, adjoint));
                }
            }
            for_shape!(link.shape, shape => motion_adjoint::<T>(batch, (shape, i), followed, slots, adjoint));
            channel_adjoint::<T>(batch, &link.joint_map, adjoint);
        }
    }
    unsafe { term_adjoint::<T>(batch, weights, first, &mut slots.followed, adjoint) };
}

/// Add to what slots hold.
#[inline(always)]
unsafe fn accumulate<T: Lane, const N: usize>(first: *mut Slot, k: usize, by: [T; N]) {
    unsafe {
        let held: [T; N] = load(first, k);
        store(first, k, core::array::from_fn::<T, N, _>(|e| held[e].add(by[e])));
    }
}

/// A symmetric matrix, upper triangle row by row, times a vector, and `c` added.
#[inline(always)]
fn symmetric<T: Lane>(m: [T; 6], v: Vector<T>, c: Vector<T>) -> Vector<T> {
    let row = |i: usize, j: usize, l: usize, c: T| m[l].fma(v[2], m[j].fma(v[1], m[i].fma(v[0], c)));
    [row(0, 1, 2, c[0]), row(1, 3, 4, c[1]), row(2, 4, 5, c[2])]
}

/// Slope of `u . (w x (w x p))` by w, and `c` added.
#[inline(always)]
fn double_cross_gradient<T: Lane>(w: Vector<T>, u: Vector<T>, p: Vector<T>, c: Vector<T>) -> Vector<T> {
    let back = dot(u, p);
    scale_add(w, back.add(back).neg(), scale_add(p, dot(u, w), scale_add(u, dot(w, p), c)))
}

/// The entries of one axis: their sum, with weights for parameters of a body of tensor J, first moment m and mass M, is
/// `x . (J wd + w x J w + m x a) + u . (M a + (skew(wd) + skew(w)^2) m)`.
#[inline(always)]
unsafe fn entry_adjoint<T: Lane>(
    batch: Batch,
    runs: [*const f64; LINK_PARAMETERS],
    (link, axis): (LinkMotions, *const Slot),
    adjoint: &mut Adjoint,
    (i, own): (usize, usize),
) {
    let (links, axes) = (adjoint.links[i].as_mut_ptr(), adjoint.axes[own].as_mut_ptr());
    for k in batch.lanes::<T>() {
        unsafe {
            let tensor: [T; 6] = core::array::from_fn(|p| T::load(runs[p].add(k)));
            let moment: Vector<T> = core::array::from_fn(|p| T::load(runs[6 + p].add(k)));
            let mass = T::load(runs[9].add(k));
            let (x, u): (Vector<T>, Vector<T>) = load_axis(axis, k);
            let (w, wd, a): (Vector<T>, Vector<T>, Vector<T>) = (link.part(W, k), link.part(WD, k), link.part(A, k));
            let spin = symmetric(tensor, w, zero());
            let b: [T; 9] = link.part(B, k);
            let by_x = symmetric(tensor, wd, cross_add(w, spin, cross(moment, a)));
            let by_u: Vector<T> = core::array::from_fn(|e| {
                let turned = b[3 * e + 2].fma(moment[2], b[3 * e + 1].fma(moment[1], b[3 * e].mul(moment[0])));
                mass.fma(a[e], turned)
            });
            accumulate(axes, k, [by_x[0], by_x[1], by_x[2], by_u[0], by_u[1], by_u[2]]);
            let by_w = double_cross_gradient(w, u, moment, symmetric(tensor, cross(x, w), cross(spin, x)));
            let by_wd = symmetric(tensor, x, cross(moment, u));
            let by_a = scale_add(u, mass, cross(x, moment));
            accumulate(links, k, by_w);
            accumulate(links.add(3), k, by_wd);
            accumulate(links.add(6), k, by_a);
        }
    }
}

/// Slope by the position of a joint that turns, of a vector in the link's frame and the slopes by it.
#[inline(always)]
fn rotation_gradient<T: Lane>(v: Vector<T>, by: Vector<T>, c: T) -> T {
    by[1].fnma(v[0], by[0].fma(v[1], c))
}

/// Slopes by an axis of a link, to the parent's axis, the joint's position and the rate.
#[inline(always)]
unsafe fn axis_adjoint<T: Lane>(
    batch: Batch,
    (shape, link): (JointShape, &Link),
    axis: &Axis,
    own: usize,
    slots: &mut KinematicSlots,
    adjoint: &mut Adjoint,
) {
    let (rest, kept) = (JointTransform::<T>::at_zero(shape, link), slots.joint.as_ptr());
    let prismatic = rest.is_prismatic();
    for k in batch.lanes::<T>() {
        unsafe {
            let joint = rest.load(kept, k);
            let (by_x, by_u) = load_axis::<T>(adjoint.axes[own].as_ptr(), k);
            if let Rate::Varying { rate, .. } = axis.rate {
                accumulate(&raw mut adjoint.channels[rate], k, [if prismatic { by_u[2] } else { by_x[2] }]);
            }
            let Some(above) = axis.above else { continue };
            let mut by_q = T::splat(0.0);
            if !prismatic {
                let (x, u) = load_axis::<T>(slots.axes[own].as_ptr(), k);
                by_q = rotation_gradient(u, by_u, rotation_gradient(x, by_x, by_q));
            }
            let (mut to_x, to_u) = (joint.rotate_to_parent(by_x), joint.rotate_to_parent(by_u));
            if let Some(origin) = joint.offset() {
                to_x = cross_add(origin, to_u, to_x);
            }
            if prismatic {
                let (x, _) = load_axis::<T>(slots.axes[above].as_ptr(), k);
                by_q = dot(to_u, cross(x, joint.axis_in_parent()));
            }
            let (x, u) = load_axis::<T>(adjoint.axes[above].as_ptr(), k);
            store_axis(adjoint.axes[above].as_mut_ptr(), k, (add(x, to_x), add(u, to_u)));
            accumulate(&raw mut adjoint.joint[0], k, [by_q]);
        }
    }
}

/// Slopes by a link's motion, to the parent's and the joint's.
#[inline(always)]
unsafe fn motion_adjoint<T: Lane>(
    batch: Batch,
    (shape, i): (JointShape, usize),
    followed: JointChannels,
    slots: &mut KinematicSlots,
    adjoint: &mut Adjoint,
) {
    let link = &batch.mechanism.links[i];
    let (rest, kept) = (JointTransform::<T>::at_zero(shape, link), slots.joint.as_ptr());
    let own = LinkMotions(slots.links[i].as_mut_ptr());
    for k in batch.lanes::<T>() {
        unsafe {
            let (joint, [_, v, _]) = (rest.load(kept, k), followed.at::<T>(k));
            let (w, wd, a): (Vector<T>, Vector<T>, Vector<T>) = (own.part(W, k), own.part(WD, k), own.part(A, k));
            let by = adjoint.links[i].as_ptr();
            let (mut by_w, by_wd, by_a): (Vector<T>, Vector<T>, Vector<T>) =
                (load(by, k), load(by.add(3), k), load(by.add(6), k));
            let by_joint = if joint.is_prismatic() {
                let twice = v.add(v);
                let by_v = rotation_gradient(w, by_a, T::splat(0.0));
                by_w = [by_a[1].fnma(twice, by_w[0]), by_a[0].fma(twice, by_w[1]), by_w[2]];
                [T::splat(0.0), by_v.add(by_v), by_a[2]]
            } else {
                let by_v = rotation_gradient(w, by_wd, by_w[2]);
                by_w = [by_wd[1].fnma(v, by_w[0]), by_wd[0].fma(v, by_w[1]), by_w[2]];
                // As the parent's acceleration was before the joint's own was added.
                let before = [w[1].fnma(v, wd[0]), w[0].fma(v, wd[1]), wd[2]];
                let by_q = rotation_gradient(
                    w,
                    by_w,
                    rotation_gradient(before, by_wd, rotation_gradient(a, by_a, T::splat(0.0))),
                );
                [by_q, by_v, by_wd[2]]
            };
            accumulate(adjoint.joint.as_mut_ptr(), k, by_joint);
            if let Some(parent) = link.parent {
                let motions = LinkMotions(slots.links[parent].as_mut_ptr());
                let to = adjoint.links[parent].as_mut_ptr();
                let by_q = carry_to_parent(&joint, motions, to, (by_w, by_wd, by_a), k);
                accumulate(&raw mut adjoint.joint[0], k, [by_q]);
            }
        }
    }
}

/// Slopes by the parent's motion as the link's frame has it, added to the parent's; returns that by a sliding position.
#[inline(always)]
unsafe fn carry_to_parent<T: Lane>(
    joint: &JointTransform<T>,
    parent: LinkMotions,
    to: *mut Slot,
    (by_w, by_wd, by_a): (Vector<T>, Vector<T>, Vector<T>),
    k: usize,
) -> T {
    let (mut by_w, mut by_wd, by_a) =
        (joint.rotate_to_parent(by_w), joint.rotate_to_parent(by_wd), joint.rotate_to_parent(by_a));
    let mut by_q = T::splat(0.0);
    unsafe {
        if let Some(origin) = joint.offset() {
            by_w = double_cross_gradient(parent.part(W, k), by_a, origin, by_w);
            by_wd = cross_add(origin, by_a, by_wd);
        }
        if joint.is_prismatic() {
            let (b, along): ([T; 9], _) = (parent.part(B, k), joint.axis_in_parent());
            by_q = dot(by_a, core::array::from_fn(|e| dot([b[3 * e], b[3 * e + 1], b[3 * e + 2]], along)));
        }
        accumulate(to, k, by_w);
        accumulate(to.add(3), k, by_wd);
        accumulate(to.add(6), k, by_a);
    }
    by_q
}

/// Slopes by a joint's motion, or a term's, to the channels that it follows.
#[inline(always)]
unsafe fn channel_adjoint<T: Lane>(batch: Batch, joint_map: &JointMap, adjoint: &mut Adjoint) {
    let na = batch.mechanism.coordinates;
    for k in batch.lanes::<T>() {
        unsafe {
            let by: [T; 3] = load(adjoint.joint.as_ptr(), k);
            let channels = adjoint.channels.as_mut_ptr();
            if let Some(position) = joint_map.given {
                accumulate(channels.add(position), k, [by[0]]);
            }
            for &(a, rate) in &joint_map.rates {
                let weight: T = batch.rate(rate, k);
                for (order, by) in by.iter().enumerate().skip(usize::from(joint_map.given.is_some())) {
                    accumulate(channels.add(order * na + a), k, [by.mul(weight)]);
                }
                let (Rate::Varying { rate, derivative }, Some(moved)) = (rate, batch.rate_derivative::<T>(rate, k))
                else {
                    continue;
                };
                let channel = |order: usize| T::load(batch.channels.channel(order * na + a).add(k));
                accumulate(channels.add(na + a), k, [by[2].mul(moved)]);
                accumulate(channels.add(rate), k, [by[2].fma(channel(2), by[1].mul(channel(1)))]);
                accumulate(channels.add(derivative), k, [by[2].mul(channel(1))]);
            }
        }
    }
}

/// Slopes of the columns of terms.
#[inline(always)]
unsafe fn term_adjoint<T: Lane>(
    batch: Batch,
    weights: &Weights,
    first: *const f64,
    slots: &mut [Slot; 3],
    adjoint: &mut Adjoint,
) {
    let (mut external, mut runs) = (3 * batch.mechanism.coordinates, &weights.terms[..]);
    for term in &batch.mechanism.terms {
        let own;
        (own, runs) = runs.split_at(term.joint_map.rates.len());
        let outside = term.law == Law::External;
        if own.iter().any(|&run| run != 0) {
            unsafe {
                let followed = batch.follow::<T>(&term.joint_map, slots);
                for k in batch.lanes::<T>() {
                    let [x, v, a] = followed.at::<T>(k);
                    let given = T::load(batch.channels.channel(if outside { external } else { 0 }).add(k));
                    let (column, mut by): (T, T) = (term.law.column(x, v, a, given), T::splat(0.0));
                    for (&run, &(_, rate)) in own.iter().zip(&term.joint_map.rates) {
                        let weight = T::load(first.add(run * BATCH + k));
                        by = weight.fma(batch.rate(rate, k), by);
                        if let Rate::Varying { rate, .. } = rate {
                            accumulate(&raw mut adjoint.channels[rate], k, [weight.mul(column)]);
                        }
                    }
                    if outside {
                        accumulate(&raw mut adjoint.channels[external], k, [by]);
                    }
                    let [by_x, by_v, by_a]: [T; 3] = term.law.slopes(v);
                    store(adjoint.joint.as_mut_ptr(), k, [by_x.mul(by), by_v.mul(by), by_a.mul(by)]);
                }
                channel_adjoint::<T>(batch, &term.joint_map, adjoint);
            }
        }
        external += usize::from(outside);
    }
}
