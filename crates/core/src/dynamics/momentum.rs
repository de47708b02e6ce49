//! Momenta of given parameters, by recursion, and the rest of the torque beside their rates of change.
//!
//! With the momentum h of a link and all that it carries, in the link's frame, a joint's momentum is that along its axis,
//! and what its torque is beside the rate of that is `v x* h`, and weight, along the axis (Featherstone 2008, section
//! 2.9). Of coordinates whose rates G change it is less by `(dG/dt)' p`: see also `momentum`.

use crate::batch::Batch;
use crate::batch::axis::{get_axis, put_axis, turn};
use crate::batch::link_velocity::LinkVelocities;
use crate::batch::sweep::{Bodies, Passing};
use crate::dynamics::rnea::{add_terms, clear, pass_wrench, under};
use crate::linalg::vector::{Vector, cross, cross_add};
use crate::mechanism::closure::Course;
use crate::mechanism::terms::Law;
use crate::mechanism::transform::JointMotion;
use crate::mechanism::{LINK_PARAMETERS, Link};
use crate::memory::slot::{load, store};
use crate::simd::dispatch::dispatched;
use crate::simd::lane::Lane;

/// Angular and linear part of a momentum, or moment and force.
type Wrench<T> = (Vector<T>, Vector<T>);

dispatched! {
    /// Momenta of a batch, and the rest of its torques.
    ///
    /// # Safety
    /// Workspace and parameters are large enough for the mechanism, as for everything below.
    pub(crate) unsafe fn momenta = momenta_in_lanes(batch: Batch, bodies: Bodies, passing: &mut Passing)
}

#[inline(always)]
unsafe fn momenta_in_lanes<T: Lane>(batch: Batch, bodies: Bodies, passing: &mut Passing) {
    let na = batch.mechanism.coordinates;
    unsafe {
        for i in 0..batch.mechanism.links.len() {
            move_link::<T>(batch, bodies, i, passing);
        }
        clear::<T>(batch, &mut passing.torque[..na]);
        clear::<T>(batch, &mut passing.other[..na]);
        for (i, link) in batch.mechanism.links.iter().enumerate().rev() {
            project::<T>(batch, link, i, passing);
            if let Some(parent) = link.parent {
                for wrenches in [&mut passing.wrenches, &mut passing.weights] {
                    let (from, to) = (wrenches.as_mut_ptr().add(i), wrenches.as_mut_ptr().add(parent));
                    pass_wrench::<T>(batch, (link.shape, link), &passing.joints[i], from.cast(), to.cast());
                }
            }
        }
        add_rotors::<T>(batch, bodies, passing);
        add_terms::<T>(batch, bodies, |law| law != Law::Rotor, passing);
    }
}

/// The link's velocity from the parent's, its momentum and its weight.
#[inline(always)]
unsafe fn move_link<T: Lane>(batch: Batch, bodies: Bodies, i: usize, passing: &mut Passing) {
    let link = &batch.mechanism.links[i];
    let rest = JointMotion::<T>::rest(link.shape, link);
    unsafe {
        let followed = batch.follow::<T>(&link.course, &mut passing.followed);
        turn::<T>(batch, link, followed, &mut passing.joints[i]);
        let own = LinkVelocities(passing.motions[i].as_mut_ptr());
        let parent = link.parent.map(|p| LinkVelocities(passing.motions[p].as_mut_ptr()));
        for k in batch.lanes::<T>() {
            let ([_, speed, _], joint) = (followed.at(k), rest.kept(passing.joints[i].as_ptr(), k));
            match parent {
                Some(parent) => own.follow(parent, &joint, speed, k),
                None => own.begin(batch.mechanism.gravity, &joint, speed, k),
            }
            let (momentum, weight) = carried(own.get::<T>(k), bodies.held.link(i, k));
            put_axis(passing.wrenches[i].as_mut_ptr(), k, momentum);
            put_axis(passing.weights[i].as_mut_ptr(), k, weight);
        }
    }
}

/// Momentum of a body at a velocity (angular w, linear v), and what holds it against gravity.
#[inline(always)]
fn carried<T: Lane>([w, v, a]: [Vector<T>; 3], c: [T; LINK_PARAMETERS]) -> (Wrench<T>, Wrench<T>) {
    let first = [c[6], c[7], c[8]];
    let momentum = (cross_add(first, v, under(&c, w)), cross_add(w, first, v.map(|v| v.mul(c[9]))));
    (momentum, (cross(first, a), a.map(|a| a.mul(c[9]))))
}

/// Add a joint's momentum, and the rest of its torque, to the coordinates that move it.
#[inline(always)]
unsafe fn project<T: Lane>(batch: Batch, link: &Link, i: usize, passing: &mut Passing) {
    let velocities = LinkVelocities(passing.motions[i].as_mut_ptr());
    for k in batch.lanes::<T>() {
        unsafe {
            let [w, v, _] = velocities.get::<T>(k);
            let (angular, linear) = get_axis(passing.wrenches[i].as_ptr(), k);
            let (moment, force): Wrench<T> = get_axis(passing.weights[i].as_ptr(), k);
            let about = |a: Vector<T>, b: Vector<T>, c: T| a[1].fnma(b[0], a[0].fma(b[1], c));
            let (momentum, left) = match link.slides() {
                true => (linear[2], about(w, linear, force[2])),
                false => (angular[2], about(w, angular, about(v, linear, moment[2]))),
            };
            add_to_coordinates(batch, &link.course, (momentum, left), k, passing);
        }
    }
}

/// # Safety
/// A lane from `k` on is inside the batch.
#[inline(always)]
unsafe fn add_to_coordinates<T: Lane>(
    batch: Batch,
    course: &Course,
    (momentum, left): (T, T),
    k: usize,
    passing: &mut Passing,
) {
    for &(a, rate) in &course.rates {
        unsafe {
            let (p, rest) = (&mut passing.other[a], &mut passing.torque[a]);
            let ([sum], [of_rest]): ([T; 1], [T; 1]) = (load(p, k), load(rest, k));
            let own: T = batch.rate(rate, k);
            let of_rest = left.fma(own, of_rest);
            store(p, k, [momentum.fma(own, sum)]);
            store(rest, k, [batch.change(rate, k).map_or(of_rest, |change| momentum.fnma(change, of_rest))]);
        }
    }
}

/// Rotors have momentum, and a rest where a rate changes.
#[inline(always)]
unsafe fn add_rotors<T: Lane>(batch: Batch, bodies: Bodies, passing: &mut Passing) {
    let first = batch.mechanism.inertial_columns();
    for (t, term) in batch.mechanism.terms.iter().enumerate() {
        if term.law != Law::Rotor || !bodies.sets.wanted(t) {
            continue;
        }
        unsafe {
            let followed = batch.follow::<T>(&term.course, &mut passing.followed);
            for k in batch.lanes::<T>() {
                let [_, speed, _]: [T; 3] = followed.at(k);
                let momentum = speed.mul(bodies.held.column(first + t, k));
                add_to_coordinates(batch, &term.course, (momentum, T::splat(0.0)), k, passing);
            }
        }
    }
}
