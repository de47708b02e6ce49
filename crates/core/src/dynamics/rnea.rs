//! Torques of given parameters, by recursion: motions of the links outward from the base, their wrenches back to it.
//!
//! Every link's wrench is that of its ten parameters in its own frame (Khalil and Dombre 2002, section 9.5). What acts on
//! a joint is projected on the coordinates by the joint's rates, `tau_a = sum_j G[j, a] n_j`: a closed chain's tree is
//! opened, and its torques add up at the coordinates.

use crate::batch::axis::{get_axis, put_axis, turn};
use crate::batch::sweep::{Bodies, Passing};
use crate::batch::sweep::{each_batch, put_rows};
use crate::batch::{Batch, Followed};
use crate::dynamics::momentum::momenta;
use crate::error::{Error, expect_length};
use crate::linalg::vector::{Vector, cross, cross_add, zero};
use crate::mechanism::Mechanism;
use crate::mechanism::motion::Motion;
use crate::mechanism::parameters::Sets;
use crate::mechanism::shape::{Shape, for_shape};
use crate::mechanism::terms::Law;
use crate::mechanism::transform::Moving;
use crate::mechanism::transform::{JointMotion, JointSlots};
use crate::mechanism::{LINK_PARAMETERS, Link};
use crate::memory::shared::Shared;
use crate::memory::slot::{Slot, load, store};
use crate::simd::dispatch::dispatched;
use crate::simd::lane::Lane;

dispatched! {
    /// Torques of a batch: the acceleration of its channels counts.
    ///
    /// # Safety
    /// Workspace and parameters are large enough for the mechanism, as for everything below.
    pub(crate) unsafe fn torques = torques_in_lanes(batch: Batch, bodies: Bodies, passing: &mut Passing)
}

#[inline(always)]
unsafe fn torques_in_lanes<T: Lane>(batch: Batch, bodies: Bodies, passing: &mut Passing) {
    unsafe {
        for (i, link) in batch.mechanism.links.iter().enumerate() {
            let followed = batch.follow::<T>(&link.course, &mut passing.followed);
            turn::<T>(batch, link, followed, &mut passing.joints[i]);
            for_shape!(link.shape, shape => move_link::<T>(batch, bodies, (shape, i), followed, passing));
        }
        clear::<T>(batch, &mut passing.torque[..batch.mechanism.coordinates]);
        for (i, link) in batch.mechanism.links.iter().enumerate().rev() {
            project::<T>(batch, link, &passing.wrenches[i], &mut passing.torque);
            if let Some(parent) = link.parent {
                let (joint, wrenches) = (&passing.joints[i], passing.wrenches.as_mut_ptr());
                let (from, to) = (wrenches.add(i), wrenches.add(parent));
                for_shape!(link.shape, shape => pass_wrench::<T>(batch, (shape, link), joint, from.cast(), to.cast()));
            }
        }
        add_terms::<T>(batch, bodies, |_| true, passing);
    }
}

/// Zeros.
#[inline(always)]
pub(crate) unsafe fn clear<T: Lane>(batch: Batch, slots: &mut [Slot]) {
    for slot in slots {
        batch.lanes::<T>().for_each(|k| unsafe { store(slot, k, [T::splat(0.0)]) });
    }
}

/// The link's motion from the parent's, and the wrench that it takes.
#[inline(always)]
unsafe fn move_link<T: Lane>(
    batch: Batch,
    bodies: Bodies,
    (shape, i): (Shape, usize),
    followed: Followed,
    passing: &mut Passing,
) {
    let (link, heavy) = (&batch.mechanism.links[i], bodies.sets.heavy(i));
    let rest = JointMotion::<T>::rest(shape, link);
    for k in batch.lanes::<T>() {
        unsafe {
            let joint = rest.kept(passing.joints[i].as_ptr(), k);
            let [_, v, acceleration] = followed.at(k);
            let carried = match link.parent {
                Some(parent) => joint.carry_motion(get_motion(passing.motions[parent].as_ptr(), k)),
                None => [zero(), zero(), joint.rotate(batch.mechanism.gravity.map(|g| T::splat(-g)))],
            };
            let motion = moved(&joint, carried, (v, acceleration));
            put_motion(passing.motions[i].as_mut_ptr(), k, motion);
            let wrench = if heavy { wrench(motion, bodies.held.link(i, k)) } else { (zero(), zero()) };
            put_axis(passing.wrenches[i].as_mut_ptr(), k, wrench);
        }
    }
}

#[inline(always)]
unsafe fn get_motion<T: Lane>(slots: *const Slot, k: usize) -> Moving<T> {
    let m: [T; 9] = unsafe { load(slots, k) };
    [[m[0], m[1], m[2]], [m[3], m[4], m[5]], [m[6], m[7], m[8]]]
}

#[inline(always)]
unsafe fn put_motion<T: Lane>(slots: *mut Slot, k: usize, [w, wd, a]: Moving<T>) {
    unsafe { store(slots, k, [w[0], w[1], w[2], wd[0], wd[1], wd[2], a[0], a[1], a[2]]) }
}

/// The motion with that of the joint itself.
#[inline(always)]
fn moved<T: Lane>(joint: &JointMotion<T>, [mut w, mut wd, mut a]: Moving<T>, (v, acceleration): (T, T)) -> Moving<T> {
    if joint.slides() {
        let twice = v.add(v);
        a = [w[1].fma(twice, a[0]), w[0].fnma(twice, a[1]), a[2].add(acceleration)];
    } else {
        wd = [w[1].fma(v, wd[0]), w[0].fnma(v, wd[1]), wd[2].add(acceleration)];
        w[2] = w[2].add(v);
    }
    [w, wd, a]
}

/// A vector under a body's tensor.
#[inline(always)]
pub(crate) fn under<T: Lane>(c: &[T; LINK_PARAMETERS], x: Vector<T>) -> Vector<T> {
    [
        c[0].fma(x[0], c[1].fma(x[1], c[2].mul(x[2]))),
        c[1].fma(x[0], c[3].fma(x[1], c[4].mul(x[2]))),
        c[2].fma(x[0], c[4].fma(x[1], c[5].mul(x[2]))),
    ]
}

/// Moment at the origin and force that a body takes to move so.
#[inline(always)]
fn wrench<T: Lane>([w, wd, a]: Moving<T>, c: [T; LINK_PARAMETERS]) -> (Vector<T>, Vector<T>) {
    let first = [c[6], c[7], c[8]];
    let n = cross_add(w, under(&c, w), cross_add(first, a, under(&c, wd)));
    let f = cross_add(wd, first, cross_add(w, cross(w, first), a.map(|a| a.mul(c[9]))));
    (n, f)
}

/// Add what acts along a joint to the coordinates that move it.
#[inline(always)]
unsafe fn project<T: Lane>(batch: Batch, link: &Link, wrench: &[Slot; 6], torque: &mut [Slot]) {
    let along = &wrench[if link.slides() { 5 } else { 2 }];
    for &(a, rate) in &link.course.rates {
        for k in batch.lanes::<T>() {
            unsafe {
                let ([own], [sum]): ([T; 1], [T; 1]) = (load(along, k), load(&torque[a], k));
                store(&mut torque[a], k, [own.fma(batch.rate(rate, k), sum)]);
            }
        }
    }
}

/// Add a link's wrench to its parent's.
#[inline(always)]
pub(crate) unsafe fn pass_wrench<T: Lane>(
    batch: Batch,
    (shape, link): (Shape, &Link),
    joint: &JointSlots,
    from: *const Slot,
    to: *mut Slot,
) {
    let rest = JointMotion::<T>::rest(shape, link);
    for k in batch.lanes::<T>() {
        unsafe {
            let (n, f) = rest.kept(joint.as_ptr(), k).carry_wrench(get_axis(from, k));
            let (sum_n, sum_f): (Vector<T>, Vector<T>) = get_axis(to, k);
            let sum = |x: Vector<T>, y: Vector<T>| core::array::from_fn(|e| x[e].add(y[e]));
            put_axis(to, k, (sum(n, sum_n), sum(f, sum_f)));
        }
    }
}

/// Add the torques of those terms that the caller chooses by their laws.
#[inline(always)]
pub(crate) unsafe fn add_terms<T: Lane>(
    batch: Batch,
    bodies: Bodies,
    chosen: impl Fn(Law) -> bool,
    passing: &mut Passing,
) {
    let mut external = 3 * batch.mechanism.coordinates;
    let first = batch.mechanism.inertial_columns();
    for (t, term) in batch.mechanism.terms.iter().enumerate() {
        let own = if term.law == Law::External { external } else { 0 };
        external += usize::from(term.law == Law::External);
        if !bodies.sets.wanted(t) || !chosen(term.law) || term.course.rates.is_empty() {
            continue;
        }
        unsafe {
            let followed = batch.follow::<T>(&term.course, &mut passing.followed);
            let own = batch.channels.channel(own);
            for k in batch.lanes::<T>() {
                let [x, v, a] = followed.at(k);
                let parameter: T = bodies.held.column(first + t, k);
                let torque = term.law.column(x, v, a, T::load(own.add(k))).mul(parameter);
                for &(a, rate) in &term.course.rates {
                    let [sum] = load(&passing.torque[a], k);
                    store(&mut passing.torque[a], k, [torque.fma(batch.rate(rate, k), sum)]);
                }
            }
        }
    }
}

/// Torques of parameters `chi` of all columns: `out[r * samples + k]`, rows as in [`crate::regressor`], momenta and what
/// is left of the torques where there are no accelerations.
///
/// There may be several sets of parameters, one after another: the samples are shared out among them evenly, in order. Of
/// terms whose parameters are all zero nothing is read.
pub fn torque(mechanism: &Mechanism, motion: &Motion, chi: &[f64], out: &mut [f64]) -> Result<(), Error> {
    let (n, na, backend) = (motion.samples, mechanism.coordinates, mechanism.backend);
    motion.check(mechanism)?;
    expect_length("out", out.len(), motion.sets() * na * n)?;
    let (sets, shared) = (Sets::new(mechanism, n, chi)?, Shared::new(out));
    each_batch(mechanism, motion, &sets, |batch, from, bodies, passing| {
        let samples = (from, batch.samples);
        // SAFETY: the workspace has grown to the mechanism; nobody else writes these samples.
        unsafe {
            if motion.acceleration.is_some() {
                torques(backend, batch, bodies, passing);
                put_rows(&passing.torque[..na], samples, n, shared);
            } else {
                momenta(backend, batch, bodies, passing);
                put_rows(&passing.other[..na], samples, n, shared);
                put_rows(&passing.torque[..na], (na * n + from, batch.samples), n, shared);
            }
        }
    });
    Ok(())
}
