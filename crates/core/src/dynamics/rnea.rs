//! Inverse dynamics by the recursive Newton-Euler algorithm (RNEA): motions of the links from the base outward, their
//! wrenches back to it.
//!
//! Each link's wrench is that of its ten parameters in its own frame (Khalil and Dombre 2002, section 9.5). The joint
//! torques are projected on the coordinates by the joints' rates, `tau_a = sum_j G[j, a] n_j`: a closed chain is opened
//! to a tree, whose torques add up at the coordinates.
//!
//! Safety: as in [`crate::dynamics::crba`].

use crate::batch::axis::{load_axis, store_axis, store_transform};
use crate::batch::sweep::{BatchParameters, RecursionState, for_each_batch, write_rows};
use crate::batch::{Batch, JointChannels};
use crate::dynamics::momentum::momentum_recursion;
use crate::error::{Error, expect_length};
use crate::linalg::vector::{Vector, cross, cross_add, zero};
use crate::mechanism::motion::Motion;
use crate::mechanism::parameters::ParameterSets;
use crate::mechanism::shape::{JointShape, for_shape};
use crate::mechanism::terms::Law;
use crate::mechanism::transform::{JointTransform, SpatialMotion, TransformSlots};
use crate::mechanism::{LINK_PARAMETERS, Link, Mechanism};
use crate::memory::shared::SharedOutput;
use crate::memory::slot::{Slot, load, store};
use crate::simd::dispatch::dispatched;
use crate::simd::inlined;
use crate::simd::lane::Lane;
use crate::simd::token::Simd;

dispatched! {
    /// Torques of a batch, with the accelerations of its channels.
    ///
    /// # Safety
    ///
    /// As in [`crate::dynamics::crba`].
    pub(crate) unsafe fn rnea = rnea_in_lanes(batch: Batch, bodies: BatchParameters, state: &mut RecursionState)
}

#[inline(always)]
unsafe fn rnea_in_lanes<T: Lane>(simd: Simd<T>, batch: Batch, bodies: BatchParameters, state: &mut RecursionState) {
    // SAFETY: batch and state are as in the head of the file; a parent is another link than its child.
    unsafe {
        for (i, link) in batch.mechanism.links.iter().enumerate() {
            let followed = batch.follow(simd, &link.joint_map, &mut state.followed);
            store_transform(simd, batch, link, followed, &mut state.joints[i]);
            for_shape!(link.shape, shape => propagate_motion(simd, batch, bodies, (shape, i), followed, state));
        }
        clear(simd, batch, &mut state.torque[..batch.mechanism.coordinates]);
        for (i, link) in batch.mechanism.links.iter().enumerate().rev() {
            project(simd, batch, link, &state.wrenches[i], &mut state.torque);
            if let Some(parent) = link.parent {
                let (joint, wrenches) = (&state.joints[i], state.wrenches.as_mut_ptr());
                let (from, to) = (wrenches.add(i), wrenches.add(parent));
                for_shape!(link.shape, shape => add_wrench_to_parent(simd, batch, (shape, link), joint, from.cast(), to.cast()));
            }
        }
        add_terms(simd, batch, bodies, |_| true, state);
    }
}

/// Set slots to zero.
#[inline(always)]
pub(crate) unsafe fn clear<T: Lane>(simd: Simd<T>, batch: Batch, slots: &mut [Slot]) {
    for slot in slots {
        // SAFETY: `lanes` leaves room for a lane in the slot.
        batch.lanes(simd).for_each(|k| unsafe { store(slot, k, [simd.splat(0.0)]) });
    }
}

/// Motion of the link from its parent's, and its inertial wrench.
#[inline(always)]
unsafe fn propagate_motion<T: Lane>(
    simd: Simd<T>,
    batch: Batch,
    bodies: BatchParameters,
    (shape, i): (JointShape, usize),
    followed: JointChannels,
    state: &mut RecursionState,
) {
    let (link, has_mass) = (&batch.mechanism.links[i], bodies.sets.has_mass(i));
    let at_zero = JointTransform::at_zero(simd, shape, link);
    for k in batch.lanes(simd) {
        // SAFETY: batch and state are as in the head of the file.
        unsafe {
            let joint = at_zero.load(state.joints[i].as_ptr(), k);
            let [_, v, acceleration] = followed.at(simd, k);
            let carried = match link.parent {
                Some(parent) => joint.transform_motion(load_motion(simd, state.motions[parent].as_ptr(), k)),
                None => {
                    [zero(simd), zero(simd), joint.rotate(inlined::map(batch.mechanism.gravity, |g| simd.splat(-g)))]
                }
            };
            let motion = add_joint_rate(&joint, carried, (v, acceleration));
            store_motion(state.motions[i].as_mut_ptr(), k, motion);
            let wrench =
                if has_mass { wrench(motion, bodies.slots.link(simd, i, k)) } else { (zero(simd), zero(simd)) };
            store_axis(state.wrenches[i].as_mut_ptr(), k, wrench);
        }
    }
}

#[inline(always)]
unsafe fn load_motion<T: Lane>(simd: Simd<T>, slots: *const Slot, k: usize) -> SpatialMotion<T> {
    // SAFETY: the caller promises nine slots with room for a lane from k on.
    let m: [T; 9] = unsafe { load(simd, slots, k) };
    [[m[0], m[1], m[2]], [m[3], m[4], m[5]], [m[6], m[7], m[8]]]
}

#[inline(always)]
unsafe fn store_motion<T: Lane>(slots: *mut Slot, k: usize, [w, wd, a]: SpatialMotion<T>) {
    // SAFETY: the caller promises nine slots with room for a lane from k on.
    unsafe { store(slots, k, [w[0], w[1], w[2], wd[0], wd[1], wd[2], a[0], a[1], a[2]]) }
}

/// Add the joint's own motion.
#[inline(always)]
fn add_joint_rate<T: Lane>(
    joint: &JointTransform<T>,
    [mut w, mut wd, mut a]: SpatialMotion<T>,
    (v, acceleration): (T, T),
) -> SpatialMotion<T> {
    if joint.is_prismatic() {
        let twice = v.add(v);
        a = [w[1].fma(twice, a[0]), w[0].fnma(twice, a[1]), a[2].add(acceleration)];
    } else {
        wd = [w[1].fma(v, wd[0]), w[0].fnma(v, wd[1]), wd[2].add(acceleration)];
        w[2] = w[2].add(v);
    }
    [w, wd, a]
}

/// Product of a body's inertia tensor and a vector.
#[inline(always)]
pub(crate) fn tensor_times<T: Lane>(c: &[T; LINK_PARAMETERS], x: Vector<T>) -> Vector<T> {
    [
        c[0].fma(x[0], c[1].fma(x[1], c[2].mul(x[2]))),
        c[1].fma(x[0], c[3].fma(x[1], c[4].mul(x[2]))),
        c[2].fma(x[0], c[4].fma(x[1], c[5].mul(x[2]))),
    ]
}

/// Inertial wrench of a body, about the origin of its frame.
#[inline(always)]
fn wrench<T: Lane>([w, wd, a]: SpatialMotion<T>, c: [T; LINK_PARAMETERS]) -> (Vector<T>, Vector<T>) {
    let first = [c[6], c[7], c[8]];
    let n = cross_add(w, tensor_times(&c, w), cross_add(first, a, tensor_times(&c, wd)));
    let f = cross_add(wd, first, cross_add(w, cross(w, first), inlined::map(a, |a| a.mul(c[9]))));
    (n, f)
}

/// Add the joint's component of a wrench to the coordinates that move it.
#[inline(always)]
unsafe fn project<T: Lane>(simd: Simd<T>, batch: Batch, link: &Link, wrench: &[Slot; 6], torque: &mut [Slot]) {
    let along = &wrench[if link.is_prismatic() { 5 } else { 2 }];
    for &(a, rate) in &link.joint_map.rates {
        for k in batch.lanes(simd) {
            // SAFETY: `lanes` leaves room for a lane in slots and channels.
            unsafe {
                let ([own], [sum]): ([T; 1], [T; 1]) = (load(simd, along, k), load(simd, &torque[a], k));
                store(&mut torque[a], k, [own.fma(batch.rate(simd, rate, k), sum)]);
            }
        }
    }
}

/// Add a link's wrench to its parent's.
#[inline(always)]
pub(crate) unsafe fn add_wrench_to_parent<T: Lane>(
    simd: Simd<T>,
    batch: Batch,
    (shape, link): (JointShape, &Link),
    joint: &TransformSlots,
    from: *const Slot,
    to: *mut Slot,
) {
    let at_zero = JointTransform::at_zero(simd, shape, link);
    for k in batch.lanes(simd) {
        // SAFETY: the caller's pointers are to the six slots of two different links, with room for a lane.
        unsafe {
            let (n, f) = at_zero.load(joint.as_ptr(), k).wrench_to_parent(load_axis(simd, from, k));
            let (sum_n, sum_f): (Vector<T>, Vector<T>) = load_axis(simd, to, k);
            let sum = |x: Vector<T>, y: Vector<T>| inlined::from_fn(|e| x[e].add(y[e]));
            store_axis(to, k, (sum(n, sum_n), sum(f, sum_f)));
        }
    }
}

/// Add the torques of the terms whose laws are chosen.
#[inline(always)]
pub(crate) unsafe fn add_terms<T: Lane>(
    simd: Simd<T>,
    batch: Batch,
    bodies: BatchParameters,
    chosen: impl Fn(Law) -> bool,
    state: &mut RecursionState,
) {
    let mut external = 3 * batch.mechanism.coordinates;
    let first = batch.mechanism.inertial_columns();
    for (t, term) in batch.mechanism.terms.iter().enumerate() {
        let own = if term.law == Law::External { external } else { 0 };
        external += usize::from(term.law == Law::External);
        if !bodies.sets.is_used(t) || !chosen(term.law) || term.joint_map.rates.is_empty() {
            continue;
        }
        // SAFETY: batch and state are as in the head of the file; an external term has a channel of its own.
        unsafe {
            let followed = batch.follow(simd, &term.joint_map, &mut state.followed);
            let own = batch.channels.channel(own);
            for k in batch.lanes(simd) {
                let [x, v, a] = followed.at(simd, k);
                let parameter: T = bodies.slots.column(simd, first + t, k);
                let torque = term.law.column(x, v, a, simd.load(own.add(k))).mul(parameter);
                for &(a, rate) in &term.joint_map.rates {
                    let [sum] = load(simd, &state.torque[a], k);
                    store(&mut state.torque[a], k, [torque.fma(batch.rate(simd, rate, k), sum)]);
                }
            }
        }
    }
}

/// Inverse dynamics: torques of the parameters `chi` of all columns, `out[r * samples + k]`, rows as in
/// [`crate::regressor()`]: torques, N m or N; without accelerations momenta and the remainder of the torques.
///
/// Several sets of parameters may follow each other: the samples are divided among them evenly, in order. Terms whose
/// parameters are zero in all sets are not evaluated.
///
/// # Example
///
/// ```
/// # use haptid_core::*;
/// # let joint = Joint { parent: None, rotation: [1., 0., 0., 0., 1., 0., 0., 0., 1.], translation: [0.; 3], prismatic: false };
/// # let pendulum = Mechanism::new(&[joint], &Closure::open(1), [0., -9.81, 0.], &[], Backend::best())?;
/// # let motion = Motion {
/// #     samples: 3,
/// #     position: &[0., 1., 2.],
/// #     velocity: &[0., 0.5, 1.],
/// #     acceleration: Some(&[1., 0., -1.]),
/// #     external: &[],
/// #     loops: &[],
/// # };
/// # let chi = [0., 0., 0., 0., 0., 0.5, 1., 0., 0., 2.];
/// // A pendulum of 2 kg at 0.5 m: ZZ = 0.5 kg m^2, MX = 1 kg m. Gravity acts along -y.
/// let mut torque = [0.; 3];
/// inverse_dynamics(&pendulum, &motion, &chi, &mut torque)?;
/// assert!((torque[0] - (0.5 + 9.81)).abs() < 1e-12);
/// # Ok::<(), haptid_core::Error>(())
/// ```
pub fn inverse_dynamics(mechanism: &Mechanism, motion: &Motion, chi: &[f64], out: &mut [f64]) -> Result<(), Error> {
    let (n, na, backend) = (motion.samples, mechanism.coordinates, mechanism.backend);
    motion.check(mechanism)?;
    expect_length("out", out.len(), motion.sets() * na * n)?;
    let (sets, shared) = (ParameterSets::new(mechanism, n, chi)?, SharedOutput::new(out));
    for_each_batch(mechanism, motion, &sets, |batch, from, bodies, state| {
        let samples = (from, batch.samples);
        // SAFETY: [`for_each_batch`] gives a batch and a state of the mechanism; batches are disjoint ranges of
        // samples, which only this call writes.
        unsafe {
            if motion.acceleration.is_some() {
                rnea(backend, batch, bodies, state);
                write_rows(&state.torque[..na], samples, n, shared);
            } else {
                momentum_recursion(backend, batch, bodies, state);
                write_rows(&state.other[..na], samples, n, shared);
                write_rows(&state.torque[..na], (na * n + from, batch.samples), n, shared);
            }
        }
    });
    Ok(())
}
