//! The mass matrix, by composite bodies: each link with all that it carries.
//!
//! The wrench that moves a composite body at unit rate of its joint is passed down to the base, and what it does along
//! each joint on its way is an entry of the tree's mass matrix (Walker and Orin 1982, method 3; Featherstone 2008, section
//! 6.2). The joints' rates take the entry to the coordinates: `M[a, b] = sum_jk G[j, a] G[k, b] H[j, k]`.

use crate::batch::Batch;
use crate::batch::axis::{get_axis, put_axis, turn};
use crate::batch::sweep::{Bodies, Passing};
use crate::dynamics::rnea::clear;
use crate::mechanism::shape::{Shape, for_shape};
use crate::mechanism::terms::Law;
use crate::mechanism::transform::{JointMotion, JointSlots};
use crate::mechanism::{LINK_PARAMETERS, Link};
use crate::memory::slot::{Slot, load, store};
use crate::simd::dispatch::dispatched;
use crate::simd::lane::Lane;

dispatched! {
    /// Where the joints are at a batch: all that mass matrices need of its channels.
    ///
    /// # Safety
    /// Workspace and parameters are large enough for the mechanism, as for everything below.
    pub(crate) unsafe fn turns = turns_in_lanes(batch: Batch, passing: &mut Passing)
}

#[inline(always)]
unsafe fn turns_in_lanes<T: Lane>(batch: Batch, passing: &mut Passing) {
    for (link, joint) in batch.mechanism.links.iter().zip(&mut passing.joints) {
        unsafe {
            let followed = batch.follow::<T>(&link.course, &mut passing.followed);
            turn::<T>(batch, link, followed, joint);
        }
    }
}

dispatched! {
    /// Mass matrices of a batch, where the joints' turns are known.
    ///
    /// # Safety
    /// As for [`turns`].
    pub(crate) unsafe fn masses = masses_in_lanes(batch: Batch, bodies: Bodies, passing: &mut Passing)
}

#[inline(always)]
unsafe fn masses_in_lanes<T: Lane>(batch: Batch, bodies: Bodies, passing: &mut Passing) {
    let (mechanism, na) = (batch.mechanism, batch.mechanism.coordinates);
    unsafe {
        clear::<T>(batch, &mut passing.mass[..na * (na + 1) / 2]);
        for i in 0..mechanism.links.len() {
            for k in batch.lanes::<T>() {
                store(passing.bodies[i].as_mut_ptr(), k, bodies.held.link::<T>(i, k));
            }
        }
        for (i, link) in mechanism.links.iter().enumerate().rev() {
            if !link.course.rates.is_empty() {
                begin::<T>(batch, link, &passing.bodies[i], &mut passing.force);
                pass_down::<T>(batch, i, passing);
            }
            if let Some(parent) = link.parent {
                let (joint, composites) = (&passing.joints[i], passing.bodies.as_mut_ptr());
                let (from, to) = (composites.add(i), composites.add(parent));
                for_shape!(link.shape, shape => pass_body::<T>(batch, (shape, link), joint, from.cast(), to.cast()));
            }
        }
        add_rotors::<T>(batch, bodies, passing);
    }
}

/// The wrench that moves a body at unit rate of its joint.
#[inline(always)]
unsafe fn begin<T: Lane>(batch: Batch, link: &Link, body: &[Slot; LINK_PARAMETERS], force: &mut [Slot; 6]) {
    for k in batch.lanes::<T>() {
        unsafe {
            let [_, _, xz, _, yz, zz, x, y, _, m]: [T; LINK_PARAMETERS] = load(body.as_ptr(), k);
            let none = T::splat(0.0);
            let wrench = match link.slides() {
                true => ([y, x.neg(), none], [none, none, m]),
                false => ([xz, yz, zz], [y.neg(), x, none]),
            };
            put_axis(force.as_mut_ptr(), k, wrench);
        }
    }
}

/// Pass the wrench of link `i` down to the base, and add the entries of its joint with those on the way.
#[inline(always)]
unsafe fn pass_down<T: Lane>(batch: Batch, i: usize, passing: &mut Passing) {
    let links = &batch.mechanism.links;
    let mut at = i;
    loop {
        unsafe { add_entry::<T>(batch, (&links[i], &links[at]), i == at, passing) };
        let Some(parent) = links[at].parent else { break };
        let (link, joint, force) = (&links[at], &passing.joints[at], passing.force.as_mut_ptr());
        for_shape!(link.shape, shape => unsafe { carry_force::<T>(batch, (shape, link), joint, force) });
        at = parent;
    }
}

#[inline(always)]
unsafe fn carry_force<T: Lane>(batch: Batch, (shape, link): (Shape, &Link), joint: &JointSlots, force: *mut Slot) {
    let rest = JointMotion::<T>::rest(shape, link);
    for k in batch.lanes::<T>() {
        unsafe { put_axis(force, k, rest.kept(joint.as_ptr(), k).carry_wrench(get_axis(force, k))) };
    }
}

/// Where an entry of a symmetric matrix is in its lower triangle, row by row.
#[inline(always)]
pub(crate) fn place(a: usize, b: usize) -> usize {
    let (low, high) = (a.min(b), a.max(b));
    high * (high + 1) / 2 + low
}

/// Add what the wrench does along the joint of `other` to the coordinates' entries.
#[inline(always)]
unsafe fn add_entry<T: Lane>(batch: Batch, (own, other): (&Link, &Link), same: bool, passing: &mut Passing) {
    let along = &passing.force[if other.slides() { 5 } else { 2 }];
    for &(a, left) in &own.course.rates {
        for &(b, right) in &other.course.rates {
            // Of a joint with itself both orders of two coordinates are met; else one, and the matrix has both.
            if same && a < b {
                continue;
            }
            let (entry, times) = (&mut passing.mass[place(a, b)], if !same && a == b { 2.0 } else { 1.0 });
            for k in batch.lanes::<T>() {
                unsafe {
                    let ([along], [sum]): ([T; 1], [T; 1]) = (load(along, k), load(entry, k));
                    let rates = batch.rate::<T>(left, k).mul(batch.rate(right, k)).mul(T::splat(times));
                    store(entry, k, [along.fma(rates, sum)]);
                }
            }
        }
    }
}

/// Add a body to its parent's.
#[inline(always)]
unsafe fn pass_body<T: Lane>(
    batch: Batch,
    (shape, link): (Shape, &Link),
    joint: &JointSlots,
    from: *const Slot,
    to: *mut Slot,
) {
    let rest = JointMotion::<T>::rest(shape, link);
    for k in batch.lanes::<T>() {
        unsafe {
            let carried = rest.kept(joint.as_ptr(), k).carry_body(load(from, k));
            let sum: [T; LINK_PARAMETERS] = load(to, k);
            store(to, k, core::array::from_fn::<T, LINK_PARAMETERS, _>(|p| sum[p].add(carried[p])));
        }
    }
}

#[inline(always)]
unsafe fn add_rotors<T: Lane>(batch: Batch, bodies: Bodies, passing: &mut Passing) {
    let first = batch.mechanism.inertial_columns();
    for (t, term) in batch.mechanism.terms.iter().enumerate() {
        if term.law != Law::Rotor || !bodies.sets.wanted(t) {
            continue;
        }
        for &(a, left) in &term.course.rates {
            for &(b, right) in term.course.rates.iter().filter(|rate| rate.0 <= a) {
                let entry = &mut passing.mass[place(a, b)];
                for k in batch.lanes::<T>() {
                    unsafe {
                        let ([sum], rotor): (_, T) = (load(entry, k), bodies.held.column(first + t, k));
                        let rates = batch.rate::<T>(left, k).mul(batch.rate(right, k));
                        store(entry, k, [rotor.fma(rates, sum)]);
                    }
                }
            }
        }
    }
}
