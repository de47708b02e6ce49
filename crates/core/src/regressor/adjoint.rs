//! Reverse sweep: gradients of a weighted sum of regressor entries with respect to all channels of a motion.
//!
//! An entry is a function of an axis and of a link's motion. The adjoints of these are accumulated link by link, from
//! the last to the first, and transformed to the parent as axes and motions were transformed from it (reverse
//! accumulation: Griewank and Walther 2008, section 3.2). One sweep gives the gradients for any number of channels, at
//! about three times the cost of the entries.
//!
//! Closures for the items of an array go to [`crate::simd::inlined`] only, here as in all kernels.
//!
//! Safety: batches are as in [`crate::batch`]; [`forward_sweep`], or the rows and [`constant_axes`], precede
//! [`reverse_sweep`] with the same batch and slots, and every run of weights has [`BATCH`] numbers. The slots of the
//! adjoint have grown to the mechanism in `clear`.

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
use crate::memory::slot::{BATCH, Slot, grow, load, store};
use crate::regressor::momentum::propagate_axis;
use crate::regressor::rows::{KinematicSlots, propagate_motion};
use crate::simd::dispatch::dispatched;
use crate::simd::inlined;
use crate::simd::lane::Lane;
use crate::simd::token::Simd;
use std::ops::Range;

/// Adjoint of a link's motion: with respect to angular velocity, angular acceleration, and acceleration of the origin.
type LinkAdjoint = [Slot; 9];

/// Adjoints of what the rows are computed from, at a batch of samples.
#[derive(Default)]
pub(crate) struct Adjoint {
    links: Vec<LinkAdjoint>,
    axes: Vec<AxisSlots>,
    /// Of position, velocity and acceleration of the joint, or term, in progress.
    joint: [Slot; 3],
    /// Of the channels of the motion.
    pub(crate) channels: Vec<Slot>,
}

impl Adjoint {
    /// Set to zero what the weights reach, and make room for the mechanism.
    fn clear(&mut self, mechanism: &Mechanism, weights: &Weights) {
        grow(&mut self.links, mechanism.links.len(), [Slot::ZERO; 9]);
        grow(&mut self.axes, mechanism.axes, [Slot::ZERO; 6]);
        grow(&mut self.channels, mechanism.channels(), Slot::ZERO);
        self.links[..mechanism.links.len()].fill([Slot::ZERO; 9]);
        let reachable = self.axes.iter_mut().zip(&weights.axes).filter(|(_, weights)| weights.1);
        reachable.for_each(|(axis, _)| *axis = [Slot::ZERO; 6]);
        self.channels[..mechanism.channels()].fill(Slot::ZERO);
    }

    /// Copy the channels' gradients to rows of `n` samples, from row `first` on.
    ///
    /// # Safety
    ///
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
            // SAFETY: the caller promises that the row is inside `out`.
            let to = unsafe { out.at(row * n + samples.start) };
            // SAFETY: as above; a batch has at least these samples, and the slot is no part of `out`.
            unsafe { core::ptr::copy_nonoverlapping(slot.0.as_ptr(), to, samples.len()) };
        }
    }
}

/// Weights of the entries: runs of [`BATCH`] numbers, the first of which is all zeros.
pub(crate) struct Weights {
    /// Per axis of the mechanism: runs of its entries, and whether it, or an axis computed from it, has a weight.
    axes: Vec<([usize; LINK_PARAMETERS], bool)>,
    /// Whether an entry of the axis itself has a weight.
    own: Vec<bool>,
    /// Per term, and per coordinate that it acts on.
    terms: Vec<usize>,
}

impl Weights {
    /// `run(row, column)` is the number of an entry's run, 0 for no weight.
    pub(crate) fn new(mechanism: &Mechanism, run: impl Fn(usize, usize) -> usize) -> Weights {
        let (mut axes, mut own, mut terms) = (Vec::new(), Vec::new(), Vec::new());
        for (i, link) in mechanism.links.iter().enumerate() {
            for axis in &link.axes {
                let runs: [usize; LINK_PARAMETERS] =
                    inlined::from_fn(|p| run(axis.coordinate, LINK_PARAMETERS * i + p));
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
    /// Motions of the links and axes at a batch.
    pub(crate) unsafe fn forward_sweep = forward_in_lanes(batch: Batch, slots: &mut KinematicSlots)
}

#[inline(always)]
unsafe fn forward_in_lanes<T: Lane>(simd: Simd<T>, batch: Batch, slots: &mut KinematicSlots) {
    for (i, link) in batch.mechanism.links.iter().enumerate() {
        // SAFETY: the batch and its workspace are as in the head of the file.
        unsafe {
            let followed = batch.follow(simd, &link.joint_map, &mut slots.followed);
            store_transform(simd, batch, link, followed, &mut slots.joint);
            let parent = link.parent.map(|parent| LinkMotions(slots.links[parent].as_mut_ptr()));
            let motions = (parent, LinkMotions(slots.links[i].as_mut_ptr()));
            for_shape!(link.shape, shape => {
                propagate_motion(simd, batch, (shape, link), followed, &slots.joint, motions)
            });
            for (own, axis) in (link.first..).zip(&link.axes) {
                propagate_axis(simd, batch, link, axis, own, &mut slots.axes, &slots.joint);
            }
        }
    }
}

dispatched! {
    /// The axes that [`crate::regressor::rows::torques`] leaves out, which are the same at every sample: after it has
    /// computed the torques' rows of a batch, what [`forward_sweep`] would give is there.
    pub(crate) unsafe fn constant_axes = constant_axes_in_lanes(batch: Batch, slots: &mut KinematicSlots)
}

#[inline(always)]
unsafe fn constant_axes_in_lanes<T: Lane>(simd: Simd<T>, batch: Batch, slots: &mut KinematicSlots) {
    for link in &batch.mechanism.links {
        let at_zero = JointTransform::at_zero(simd, link.shape, link);
        for (own, axis) in (link.first..).zip(&link.axes) {
            if let (None, Rate::Constant(rate)) = (axis.above, axis.rate) {
                let (to, along) = (slots.axes[own].as_mut_ptr(), at_zero.joint_axis(simd.splat(rate)));
                // SAFETY: `lanes` leaves room for a lane, and every axis has its slots.
                batch.lanes(simd).for_each(|k| unsafe { store_axis(to, k, along) });
            }
        }
    }
}

/// Gradients of the weighted sum of entries, to `adjoint.channels`. `first` is the first run of weights.
///
/// # Safety
///
/// As in the head of the file.
pub(crate) unsafe fn reverse_sweep(
    batch: Batch,
    weights: &Weights,
    first: *const f64,
    slots: &mut KinematicSlots,
    adjoint: &mut Adjoint,
) {
    adjoint.clear(batch.mechanism, weights);
    // SAFETY: the caller's promise; `clear` has made room in the adjoint.
    unsafe { reverse(batch.mechanism.backend, batch, weights, first, slots, adjoint) };
}

dispatched! {
    unsafe fn reverse = reverse_in_lanes(
        batch: Batch, weights: &Weights, first: *const f64, slots: &mut KinematicSlots, adjoint: &mut Adjoint,
    )
}

#[inline(always)]
unsafe fn reverse_in_lanes<T: Lane>(
    simd: Simd<T>,
    batch: Batch,
    weights: &Weights,
    first: *const f64,
    slots: &mut KinematicSlots,
    adjoint: &mut Adjoint,
) {
    for (i, link) in batch.mechanism.links.iter().enumerate().rev() {
        // SAFETY: the batch, its workspace and the weights are as in the head of the file.
        unsafe {
            let followed = batch.follow(simd, &link.joint_map, &mut slots.followed);
            store_transform(simd, batch, link, followed, &mut slots.joint);
            adjoint.joint.fill(Slot::ZERO);
            for (own, axis) in (link.first..).zip(&link.axes) {
                if weights.own[own] {
                    let runs = inlined::map(weights.axes[own].0, |run| first.add(run * BATCH));
                    let motions = LinkMotions(slots.links[i].as_mut_ptr());
                    entry_adjoint(simd, batch, runs, (motions, slots.axes[own].as_ptr()), adjoint, (i, own));
                }
                if weights.axes[own].1 {
                    for_shape!(link.shape, shape => axis_adjoint(simd, batch, (shape, link), axis, own, slots, adjoint));
                }
            }
            for_shape!(link.shape, shape => motion_adjoint(simd, batch, (shape, i), followed, slots, adjoint));
            channel_adjoint(simd, batch, &link.joint_map, adjoint);
        }
    }
    // SAFETY: as above.
    unsafe { term_adjoint(simd, batch, weights, first, &mut slots.followed, adjoint) };
}

/// Add to slots.
#[inline(always)]
unsafe fn accumulate<T: Lane, const N: usize>(simd: Simd<T>, first: *mut Slot, k: usize, by: [T; N]) {
    // SAFETY: the caller promises N slots with room for a lane from k on.
    unsafe {
        let present: [T; N] = load(simd, first, k);
        store(first, k, inlined::from_fn::<T, N>(|e| present[e].add(by[e])));
    }
}

/// Product of a symmetric matrix, upper triangle row by row, and a vector, plus `c`.
#[inline(always)]
fn symmetric<T: Lane>(m: [T; 6], v: Vector<T>, c: Vector<T>) -> Vector<T> {
    let row = |i: usize, j: usize, l: usize, c: T| m[l].fma(v[2], m[j].fma(v[1], m[i].fma(v[0], c)));
    [row(0, 1, 2, c[0]), row(1, 3, 4, c[1]), row(2, 4, 5, c[2])]
}

/// Gradient of `u . (w x (w x p))` with respect to w, plus `c`.
#[inline(always)]
fn double_cross_gradient<T: Lane>(w: Vector<T>, u: Vector<T>, p: Vector<T>, c: Vector<T>) -> Vector<T> {
    let back = dot(u, p);
    scale_add(w, back.add(back).neg(), scale_add(p, dot(u, w), scale_add(u, dot(w, p), c)))
}

/// Adjoints of one axis and its link's motion. With the weights read as a body of tensor J, first moment m and mass M,
/// the weighted sum of its entries is `x . (J wd + w x J w + m x a) + u . (M a + (skew(wd) + skew(w)^2) m)`.
#[inline(always)]
unsafe fn entry_adjoint<T: Lane>(
    simd: Simd<T>,
    batch: Batch,
    runs: [*const f64; LINK_PARAMETERS],
    (link, axis): (LinkMotions, *const Slot),
    adjoint: &mut Adjoint,
    (i, own): (usize, usize),
) {
    let (links, axes) = (adjoint.links[i].as_mut_ptr(), adjoint.axes[own].as_mut_ptr());
    for k in batch.lanes(simd) {
        // SAFETY: `lanes` leaves room for a lane in weights, slots and axes.
        unsafe {
            let tensor: [T; 6] = inlined::from_fn(|p| simd.load(runs[p].add(k)));
            let moment: Vector<T> = inlined::from_fn(|p| simd.load(runs[6 + p].add(k)));
            let mass = simd.load(runs[9].add(k));
            let (x, u): (Vector<T>, Vector<T>) = load_axis(simd, axis, k);
            let (w, wd, a): (Vector<T>, Vector<T>, Vector<T>) =
                (link.part(simd, W, k), link.part(simd, WD, k), link.part(simd, A, k));
            let spin = symmetric(tensor, w, zero(simd));
            let b: [T; 9] = link.part(simd, B, k);
            let by_x = symmetric(tensor, wd, cross_add(w, spin, cross(moment, a)));
            let by_u: Vector<T> = inlined::from_fn(|e| {
                let turned = b[3 * e + 2].fma(moment[2], b[3 * e + 1].fma(moment[1], b[3 * e].mul(moment[0])));
                mass.fma(a[e], turned)
            });
            accumulate(simd, axes, k, [by_x[0], by_x[1], by_x[2], by_u[0], by_u[1], by_u[2]]);
            let by_w = double_cross_gradient(w, u, moment, symmetric(tensor, cross(x, w), cross(spin, x)));
            let by_wd = symmetric(tensor, x, cross(moment, u));
            let by_a = scale_add(u, mass, cross(x, moment));
            accumulate(simd, links, k, by_w);
            accumulate(simd, links.add(3), k, by_wd);
            accumulate(simd, links.add(6), k, by_a);
        }
    }
}

/// Derivative with respect to a revolute joint's position of a vector in the link's frame, times its adjoint, plus `c`.
#[inline(always)]
fn rotation_gradient<T: Lane>(v: Vector<T>, by: Vector<T>, c: T) -> T {
    by[1].fnma(v[0], by[0].fma(v[1], c))
}

/// Adjoint of an axis, propagated to the parent's axis, the joint's position and the rate.
#[inline(always)]
unsafe fn axis_adjoint<T: Lane>(
    simd: Simd<T>,
    batch: Batch,
    (shape, link): (JointShape, &Link),
    axis: &Axis,
    own: usize,
    slots: &mut KinematicSlots,
    adjoint: &mut Adjoint,
) {
    let (at_zero, stored) = (JointTransform::at_zero(simd, shape, link), slots.joint.as_ptr());
    let prismatic = at_zero.is_prismatic();
    for k in batch.lanes(simd) {
        // SAFETY: `lanes` leaves room for a lane; axes and channels have their slots.
        unsafe {
            let joint = at_zero.load(stored, k);
            let (by_x, by_u) = load_axis(simd, adjoint.axes[own].as_ptr(), k);
            if let Rate::Varying { rate, .. } = axis.rate {
                accumulate(simd, &raw mut adjoint.channels[rate], k, [if prismatic { by_u[2] } else { by_x[2] }]);
            }
            let Some(above) = axis.above else { continue };
            let mut by_q = simd.splat(0.0);
            if !prismatic {
                let (x, u) = load_axis(simd, slots.axes[own].as_ptr(), k);
                by_q = rotation_gradient(u, by_u, rotation_gradient(x, by_x, by_q));
            }
            let (mut to_x, to_u) = (joint.rotate_transposed(by_x), joint.rotate_transposed(by_u));
            if let Some(origin) = joint.offset() {
                to_x = cross_add(origin, to_u, to_x);
            }
            if prismatic {
                let (x, _) = load_axis(simd, slots.axes[above].as_ptr(), k);
                by_q = dot(to_u, cross(x, joint.axis_in_parent()));
            }
            let (x, u) = load_axis(simd, adjoint.axes[above].as_ptr(), k);
            store_axis(adjoint.axes[above].as_mut_ptr(), k, (add(x, to_x), add(u, to_u)));
            accumulate(simd, &raw mut adjoint.joint[0], k, [by_q]);
        }
    }
}

/// Adjoint of a link's motion, propagated to the parent's and the joint's.
#[inline(always)]
unsafe fn motion_adjoint<T: Lane>(
    simd: Simd<T>,
    batch: Batch,
    (shape, i): (JointShape, usize),
    followed: JointChannels,
    slots: &mut KinematicSlots,
    adjoint: &mut Adjoint,
) {
    let link = &batch.mechanism.links[i];
    let (at_zero, stored) = (JointTransform::at_zero(simd, shape, link), slots.joint.as_ptr());
    let own = LinkMotions(slots.links[i].as_mut_ptr());
    for k in batch.lanes(simd) {
        // SAFETY: `lanes` leaves room for a lane; a parent is another link than its child.
        unsafe {
            let (joint, [_, v, _]) = (at_zero.load(stored, k), followed.at(simd, k));
            let (w, wd, a): (Vector<T>, Vector<T>, Vector<T>) =
                (own.part(simd, W, k), own.part(simd, WD, k), own.part(simd, A, k));
            let by = adjoint.links[i].as_ptr();
            let (mut by_w, by_wd, by_a): (Vector<T>, Vector<T>, Vector<T>) =
                (load(simd, by, k), load(simd, by.add(3), k), load(simd, by.add(6), k));
            let by_joint = if joint.is_prismatic() {
                let twice = v.add(v);
                let by_v = rotation_gradient(w, by_a, simd.splat(0.0));
                by_w = [by_a[1].fnma(twice, by_w[0]), by_a[0].fma(twice, by_w[1]), by_w[2]];
                [simd.splat(0.0), by_v.add(by_v), by_a[2]]
            } else {
                let by_v = rotation_gradient(w, by_wd, by_w[2]);
                by_w = [by_wd[1].fnma(v, by_w[0]), by_wd[0].fma(v, by_w[1]), by_w[2]];
                // The parent's acceleration, before the joint's own was added.
                let before = [w[1].fnma(v, wd[0]), w[0].fma(v, wd[1]), wd[2]];
                let by_q = rotation_gradient(
                    w,
                    by_w,
                    rotation_gradient(before, by_wd, rotation_gradient(a, by_a, simd.splat(0.0))),
                );
                [by_q, by_v, by_wd[2]]
            };
            accumulate(simd, adjoint.joint.as_mut_ptr(), k, by_joint);
            if let Some(parent) = link.parent {
                let motions = LinkMotions(slots.links[parent].as_mut_ptr());
                let to = adjoint.links[parent].as_mut_ptr();
                let by_q = carry_to_parent(simd, &joint, motions, to, (by_w, by_wd, by_a), k);
                accumulate(simd, &raw mut adjoint.joint[0], k, [by_q]);
            }
        }
    }
}

/// Add the adjoint of a link's motion to its parent's; returns that of a prismatic position.
#[inline(always)]
unsafe fn carry_to_parent<T: Lane>(
    simd: Simd<T>,
    joint: &JointTransform<T>,
    parent: LinkMotions,
    to: *mut Slot,
    (by_w, by_wd, by_a): (Vector<T>, Vector<T>, Vector<T>),
    k: usize,
) -> T {
    let (mut by_w, mut by_wd, by_a) =
        (joint.rotate_transposed(by_w), joint.rotate_transposed(by_wd), joint.rotate_transposed(by_a));
    let mut by_q = simd.splat(0.0);
    // SAFETY: the caller promises both links' slots, with room for a lane from k on.
    unsafe {
        if let Some(origin) = joint.offset() {
            by_w = double_cross_gradient(parent.part(simd, W, k), by_a, origin, by_w);
            by_wd = cross_add(origin, by_a, by_wd);
        }
        if joint.is_prismatic() {
            let (b, along): ([T; 9], _) = (parent.part(simd, B, k), joint.axis_in_parent());
            by_q = dot(by_a, inlined::from_fn(|e| dot([b[3 * e], b[3 * e + 1], b[3 * e + 2]], along)));
        }
        accumulate(simd, to, k, by_w);
        accumulate(simd, to.add(3), k, by_wd);
        accumulate(simd, to.add(6), k, by_a);
    }
    by_q
}

/// Adjoint of a joint's motion, or a term's, propagated to the channels that it follows.
#[inline(always)]
unsafe fn channel_adjoint<T: Lane>(simd: Simd<T>, batch: Batch, joint_map: &JointMap, adjoint: &mut Adjoint) {
    let na = batch.mechanism.coordinates;
    for k in batch.lanes(simd) {
        // SAFETY: `lanes` leaves room for a lane; every channel has its slot.
        unsafe {
            let by: [T; 3] = load(simd, adjoint.joint.as_ptr(), k);
            let channels = adjoint.channels.as_mut_ptr();
            if let Some(position) = joint_map.given {
                accumulate(simd, channels.add(position), k, [by[0]]);
            }
            for &(a, rate) in &joint_map.rates {
                let weight: T = batch.rate(simd, rate, k);
                for (order, by) in by.iter().enumerate().skip(usize::from(joint_map.given.is_some())) {
                    accumulate(simd, channels.add(order * na + a), k, [by.mul(weight)]);
                }
                let (Rate::Varying { rate, derivative }, Some(moved)) = (rate, batch.rate_derivative(simd, rate, k))
                else {
                    continue;
                };
                let channel = |order: usize| simd.load(batch.channels.channel(order * na + a).add(k));
                accumulate(simd, channels.add(na + a), k, [by[2].mul(moved)]);
                accumulate(simd, channels.add(rate), k, [by[2].fma(channel(2), by[1].mul(channel(1)))]);
                accumulate(simd, channels.add(derivative), k, [by[2].mul(channel(1))]);
            }
        }
    }
}

/// Adjoints of the terms' columns.
#[inline(always)]
unsafe fn term_adjoint<T: Lane>(
    simd: Simd<T>,
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
            // SAFETY: `lanes` leaves room for a lane in weights, slots and channels.
            unsafe {
                let followed = batch.follow(simd, &term.joint_map, slots);
                for k in batch.lanes(simd) {
                    let [x, v, a] = followed.at(simd, k);
                    let given = simd.load(batch.channels.channel(if outside { external } else { 0 }).add(k));
                    let (column, mut by): (T, T) = (term.law.column(x, v, a, given), simd.splat(0.0));
                    for (&run, &(_, rate)) in own.iter().zip(&term.joint_map.rates) {
                        let weight = simd.load(first.add(run * BATCH + k));
                        by = weight.fma(batch.rate(simd, rate, k), by);
                        if let Rate::Varying { rate, .. } = rate {
                            accumulate(simd, &raw mut adjoint.channels[rate], k, [weight.mul(column)]);
                        }
                    }
                    if outside {
                        accumulate(simd, &raw mut adjoint.channels[external], k, [by]);
                    }
                    let [by_x, by_v, by_a]: [T; 3] = term.law.slopes(v);
                    store(adjoint.joint.as_mut_ptr(), k, [by_x.mul(by), by_v.mul(by), by_a.mul(by)]);
                }
                channel_adjoint(simd, batch, &term.joint_map, adjoint);
            }
        }
        external += usize::from(outside);
    }
}
