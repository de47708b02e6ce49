//! Generalised momenta of given parameters, by recursion, and the remainder of the torque.
//!
//! With the momentum h of a link and all that it carries, in the link's frame, a joint's momentum is the component
//! along its axis, and the remainder of its torque, in addition to the momentum's rate, is the component of `v x* h`
//! and of the weight (Featherstone 2008, section 2.9). Where the rates G vary, the remainder of the coordinates is
//! smaller by `(dG/dt)' p`: see also [`crate::batch::link_velocity`].
//!
//! Safety: as in [`crate::dynamics::crba`].

use crate::batch::Batch;
use crate::batch::axis::{load_axis, store_axis, store_transform};
use crate::batch::link_velocity::LinkVelocities;
use crate::batch::sweep::{BatchParameters, RecursionState};
use crate::dynamics::rnea::{add_terms, add_wrench_to_parent, clear, tensor_times};
use crate::linalg::vector::{Vector, cross, cross_add};
use crate::mechanism::closure::JointMap;
use crate::mechanism::terms::Law;
use crate::mechanism::transform::JointTransform;
use crate::mechanism::{LINK_PARAMETERS, Link};
use crate::memory::slot::{load, store};
use crate::simd::dispatch::dispatched;
use crate::simd::inlined;
use crate::simd::lane::Lane;
use crate::simd::token::Simd;

/// Angular and linear part of a momentum, or moment and force.
type Wrench<T> = (Vector<T>, Vector<T>);

dispatched! {
    /// Momenta of a batch, and the remainder of its torques.
    ///
    /// # Safety
    ///
    /// As in [`crate::dynamics::crba`].
    pub(crate) unsafe fn momentum_recursion = momentum_recursion_in_lanes(batch: Batch, bodies: BatchParameters, state: &mut RecursionState)
}

#[inline(always)]
unsafe fn momentum_recursion_in_lanes<T: Lane>(
    simd: Simd<T>,
    batch: Batch,
    bodies: BatchParameters,
    state: &mut RecursionState,
) {
    let na = batch.mechanism.coordinates;
    // SAFETY: batch and state are as in the head of the file; a parent is another link than its child.
    unsafe {
        for i in 0..batch.mechanism.links.len() {
            propagate_motion(simd, batch, bodies, i, state);
        }
        clear(simd, batch, &mut state.torque[..na]);
        clear(simd, batch, &mut state.other[..na]);
        for (i, link) in batch.mechanism.links.iter().enumerate().rev() {
            project(simd, batch, link, i, state);
            if let Some(parent) = link.parent {
                for wrenches in [&mut state.wrenches, &mut state.weights] {
                    let (from, to) = (wrenches.as_mut_ptr().add(i), wrenches.as_mut_ptr().add(parent));
                    add_wrench_to_parent(simd, batch, (link.shape, link), &state.joints[i], from.cast(), to.cast());
                }
            }
        }
        add_rotors(simd, batch, bodies, state);
        add_terms(simd, batch, bodies, |law| law != Law::Rotor, state);
    }
}

/// Velocity of the link from its parent's, its momentum and its weight.
#[inline(always)]
unsafe fn propagate_motion<T: Lane>(
    simd: Simd<T>,
    batch: Batch,
    bodies: BatchParameters,
    i: usize,
    state: &mut RecursionState,
) {
    let link = &batch.mechanism.links[i];
    let at_zero = JointTransform::at_zero(simd, link.shape, link);
    // SAFETY: batch and state are as in the head of the file.
    unsafe {
        let followed = batch.follow(simd, &link.joint_map, &mut state.followed);
        store_transform(simd, batch, link, followed, &mut state.joints[i]);
        let own = LinkVelocities(state.motions[i].as_mut_ptr());
        let parent = link.parent.map(|p| LinkVelocities(state.motions[p].as_mut_ptr()));
        for k in batch.lanes(simd) {
            let ([_, speed, _], joint) = (followed.at(simd, k), at_zero.load(state.joints[i].as_ptr(), k));
            match parent {
                Some(parent) => own.propagate(simd, parent, &joint, speed, k),
                None => own.begin_at_base(simd, batch.mechanism.gravity, &joint, speed, k),
            }
            let (momentum, weight) = carried(own.get(simd, k), bodies.slots.link(simd, i, k));
            store_axis(state.wrenches[i].as_mut_ptr(), k, momentum);
            store_axis(state.weights[i].as_mut_ptr(), k, weight);
        }
    }
}

/// Momentum of a body at a velocity (angular w, linear v), and the wrench that balances its weight.
#[inline(always)]
fn carried<T: Lane>([w, v, a]: [Vector<T>; 3], c: [T; LINK_PARAMETERS]) -> (Wrench<T>, Wrench<T>) {
    let first = [c[6], c[7], c[8]];
    let momentum = (cross_add(first, v, tensor_times(&c, w)), cross_add(w, first, inlined::map(v, |v| v.mul(c[9]))));
    (momentum, (cross(first, a), inlined::map(a, |a| a.mul(c[9]))))
}

/// Add a joint's momentum, and the remainder of its torque, to the coordinates that move it.
#[inline(always)]
unsafe fn project<T: Lane>(simd: Simd<T>, batch: Batch, link: &Link, i: usize, state: &mut RecursionState) {
    let velocities = LinkVelocities(state.motions[i].as_mut_ptr());
    for k in batch.lanes(simd) {
        // SAFETY: `lanes` leaves room for a lane in slots and channels.
        unsafe {
            let [w, v, _] = velocities.get(simd, k);
            let (angular, linear) = load_axis(simd, state.wrenches[i].as_ptr(), k);
            let (moment, force): Wrench<T> = load_axis(simd, state.weights[i].as_ptr(), k);
            let about = |a: Vector<T>, b: Vector<T>, c: T| a[1].fnma(b[0], a[0].fma(b[1], c));
            let (momentum, left) = match link.is_prismatic() {
                true => (linear[2], about(w, linear, force[2])),
                false => (angular[2], about(w, angular, about(v, linear, moment[2]))),
            };
            add_to_coordinates(simd, batch, &link.joint_map, (momentum, left), k, state);
        }
    }
}

/// # Safety
///
/// `k` is one of the batch's lanes.
#[inline(always)]
unsafe fn add_to_coordinates<T: Lane>(
    simd: Simd<T>,
    batch: Batch,
    joint_map: &JointMap,
    (momentum, left): (T, T),
    k: usize,
    state: &mut RecursionState,
) {
    for &(a, rate) in &joint_map.rates {
        // SAFETY: slots and channels have room for every lane of the batch.
        unsafe {
            let (p, remainder) = (&mut state.other[a], &mut state.torque[a]);
            let ([sum], [remainder_sum]): ([T; 1], [T; 1]) = (load(simd, p, k), load(simd, remainder, k));
            let own: T = batch.rate(simd, rate, k);
            let remainder_sum = left.fma(own, remainder_sum);
            store(p, k, [momentum.fma(own, sum)]);
            store(
                remainder,
                k,
                [batch
                    .rate_derivative(simd, rate, k)
                    .map_or(remainder_sum, |change| momentum.fnma(change, remainder_sum))],
            );
        }
    }
}

/// Momenta of the rotors, and their remainder where a rate varies.
#[inline(always)]
unsafe fn add_rotors<T: Lane>(simd: Simd<T>, batch: Batch, bodies: BatchParameters, state: &mut RecursionState) {
    let first = batch.mechanism.inertial_columns();
    for (t, term) in batch.mechanism.terms.iter().enumerate() {
        if term.law != Law::Rotor || !bodies.sets.is_used(t) {
            continue;
        }
        // SAFETY: batch and state are as in the head of the file.
        unsafe {
            let followed = batch.follow(simd, &term.joint_map, &mut state.followed);
            for k in batch.lanes(simd) {
                let [_, speed, _]: [T; 3] = followed.at(simd, k);
                let momentum = speed.mul(bodies.slots.column(simd, first + t, k));
                add_to_coordinates(simd, batch, &term.joint_map, (momentum, simd.splat(0.0)), k, state);
            }
        }
    }
}
