//! Composite-rigid-body algorithm (CRBA): the mass matrix, from composite bodies that consist of a link and all that it
//! carries.
//!
//! The wrench that moves a composite body at unit rate of its joint is propagated to the base; its component along each
//! joint on the way is an entry of the tree's mass matrix (Walker and Orin 1982, method 3; Featherstone 2008, section
//! 6.2). The joints' rates reduce these entries to the coordinates: `M[a, b] = sum_jk G[j, a] G[k, b] H[j, k]`.
//!
//! Safety: all functions take a batch as described in [`crate::batch`], and a state and parameters that have grown to
//! its mechanism, so that every link, coordinate and column has its slots.

use crate::batch::Batch;
use crate::batch::axis::{load_axis, store_axis, store_transform};
use crate::batch::sweep::{BatchParameters, RecursionState};
use crate::dynamics::rnea::clear;
use crate::mechanism::shape::{JointShape, for_shape};
use crate::mechanism::terms::Law;
use crate::mechanism::transform::{JointTransform, TransformSlots};
use crate::mechanism::{LINK_PARAMETERS, Link};
use crate::memory::slot::{Slot, load, store};
use crate::simd::dispatch::dispatched;
use crate::simd::inlined;
use crate::simd::lane::Lane;
use crate::simd::token::Simd;

dispatched! {
    /// Transforms of all joints at a batch: all that the mass matrix needs of its channels.
    ///
    /// # Safety
    ///
    /// As in the head of the file.
    pub(crate) unsafe fn joint_transforms = joint_transforms_in_lanes(batch: Batch, state: &mut RecursionState)
}

#[inline(always)]
unsafe fn joint_transforms_in_lanes<T: Lane>(simd: Simd<T>, batch: Batch, state: &mut RecursionState) {
    for (link, joint) in batch.mechanism.links.iter().zip(&mut state.joints) {
        // SAFETY: batch and state are as in the head of the file.
        unsafe {
            let followed = batch.follow(simd, &link.joint_map, &mut state.followed);
            store_transform(simd, batch, link, followed, joint);
        }
    }
}

dispatched! {
    /// Mass matrices of a batch, after [`joint_transforms`].
    ///
    /// # Safety
    ///
    /// As in the head of the file.
    pub(crate) unsafe fn crba = crba_in_lanes(batch: Batch, bodies: BatchParameters, state: &mut RecursionState)
}

#[inline(always)]
unsafe fn crba_in_lanes<T: Lane>(simd: Simd<T>, batch: Batch, bodies: BatchParameters, state: &mut RecursionState) {
    let (mechanism, na) = (batch.mechanism, batch.mechanism.coordinates);
    // SAFETY: batch and state are as in the head of the file; a parent is another link than its child.
    unsafe {
        clear(simd, batch, &mut state.mass[..na * (na + 1) / 2]);
        for i in 0..mechanism.links.len() {
            for k in batch.lanes(simd) {
                store(state.bodies[i].as_mut_ptr(), k, bodies.slots.link(simd, i, k));
            }
        }
        for (i, link) in mechanism.links.iter().enumerate().rev() {
            if !link.joint_map.rates.is_empty() {
                unit_rate_wrench(simd, batch, link, &state.bodies[i], &mut state.force);
                propagate_to_base(simd, batch, i, state);
            }
            if let Some(parent) = link.parent {
                let (joint, composites) = (&state.joints[i], state.bodies.as_mut_ptr());
                let (from, to) = (composites.add(i), composites.add(parent));
                for_shape!(link.shape, shape => add_inertia_to_parent(simd, batch, (shape, link), joint, from.cast(), to.cast()));
            }
        }
        add_rotors(simd, batch, bodies, state);
    }
}

/// The wrench that moves a body at unit rate of its joint.
#[inline(always)]
unsafe fn unit_rate_wrench<T: Lane>(
    simd: Simd<T>,
    batch: Batch,
    link: &Link,
    body: &[Slot; LINK_PARAMETERS],
    force: &mut [Slot; 6],
) {
    for k in batch.lanes(simd) {
        // SAFETY: `lanes` leaves room for a lane in the slots of body and force.
        unsafe {
            let [_, _, xz, _, yz, zz, x, y, _, m]: [T; LINK_PARAMETERS] = load(simd, body.as_ptr(), k);
            let none = simd.splat(0.0);
            let wrench = match link.is_prismatic() {
                true => ([y, x.neg(), none], [none, none, m]),
                false => ([xz, yz, zz], [y.neg(), x, none]),
            };
            store_axis(force.as_mut_ptr(), k, wrench);
        }
    }
}

/// Propagate the wrench of link `i` to the base, and add the entries of its joint with those on the way.
#[inline(always)]
unsafe fn propagate_to_base<T: Lane>(simd: Simd<T>, batch: Batch, i: usize, state: &mut RecursionState) {
    let links = &batch.mechanism.links;
    let mut at = i;
    loop {
        // SAFETY: batch and state are as in the head of the file.
        unsafe { add_entry(simd, batch, (&links[i], &links[at]), i == at, state) };
        let Some(parent) = links[at].parent else { break };
        let (link, joint, force) = (&links[at], &state.joints[at], state.force.as_mut_ptr());
        // SAFETY: as above; the six slots of the force are borrowed by nobody else.
        for_shape!(link.shape, shape => unsafe { carry_force(simd, batch, (shape, link), joint, force) });
        at = parent;
    }
}

#[inline(always)]
unsafe fn carry_force<T: Lane>(
    simd: Simd<T>,
    batch: Batch,
    (shape, link): (JointShape, &Link),
    joint: &TransformSlots,
    force: *mut Slot,
) {
    let at_zero = JointTransform::at_zero(simd, shape, link);
    for k in batch.lanes(simd) {
        // SAFETY: `lanes` leaves room for a lane in the slots of joint and force.
        unsafe { store_axis(force, k, at_zero.load(joint.as_ptr(), k).wrench_to_parent(load_axis(simd, force, k))) };
    }
}

/// Index of an entry of a symmetric matrix in its lower triangle, row by row.
#[inline(always)]
pub(crate) fn triangular_index(a: usize, b: usize) -> usize {
    let (low, high) = (a.min(b), a.max(b));
    high * (high + 1) / 2 + low
}

/// Add the component of the wrench along the joint of `other` to the coordinates' entries.
#[inline(always)]
unsafe fn add_entry<T: Lane>(
    simd: Simd<T>,
    batch: Batch,
    (own, other): (&Link, &Link),
    same: bool,
    state: &mut RecursionState,
) {
    let along = &state.force[if other.is_prismatic() { 5 } else { 2 }];
    for &(a, left) in &own.joint_map.rates {
        for &(b, right) in &other.joint_map.rates {
            // A joint with itself meets both orders of two coordinates; two joints meet one, and the matrix has both.
            if same && a < b {
                continue;
            }
            let (entry, times) = (&mut state.mass[triangular_index(a, b)], if !same && a == b { 2.0 } else { 1.0 });
            for k in batch.lanes(simd) {
                // SAFETY: `lanes` leaves room for a lane in slots and channels.
                unsafe {
                    let ([along], [sum]): ([T; 1], [T; 1]) = (load(simd, along, k), load(simd, entry, k));
                    let rates = batch.rate(simd, left, k).mul(batch.rate(simd, right, k)).mul(simd.splat(times));
                    store(entry, k, [along.fma(rates, sum)]);
                }
            }
        }
    }
}

/// Add a body's inertia to its parent's.
#[inline(always)]
unsafe fn add_inertia_to_parent<T: Lane>(
    simd: Simd<T>,
    batch: Batch,
    (shape, link): (JointShape, &Link),
    joint: &TransformSlots,
    from: *const Slot,
    to: *mut Slot,
) {
    let at_zero = JointTransform::at_zero(simd, shape, link);
    for k in batch.lanes(simd) {
        // SAFETY: the caller's pointers are to the slots of two different links, with room for a lane.
        unsafe {
            let carried = at_zero.load(joint.as_ptr(), k).inertia_to_parent(load(simd, from, k));
            let sum: [T; LINK_PARAMETERS] = load(simd, to, k);
            store(to, k, inlined::from_fn::<T, LINK_PARAMETERS>(|p| sum[p].add(carried[p])));
        }
    }
}

#[inline(always)]
unsafe fn add_rotors<T: Lane>(simd: Simd<T>, batch: Batch, bodies: BatchParameters, state: &mut RecursionState) {
    let first = batch.mechanism.inertial_columns();
    for (t, term) in batch.mechanism.terms.iter().enumerate() {
        if term.law != Law::Rotor || !bodies.sets.is_used(t) {
            continue;
        }
        for &(a, left) in &term.joint_map.rates {
            for &(b, right) in term.joint_map.rates.iter().filter(|rate| rate.0 <= a) {
                let entry = &mut state.mass[triangular_index(a, b)];
                for k in batch.lanes(simd) {
                    // SAFETY: `lanes` leaves room for a lane in slots and channels.
                    unsafe {
                        let ([sum], rotor): (_, T) = (load(simd, entry, k), bodies.slots.column(simd, first + t, k));
                        let rates = batch.rate(simd, left, k).mul(batch.rate(simd, right, k));
                        store(entry, k, [rotor.fma(rates, sum)]);
                    }
                }
            }
        }
    }
}
