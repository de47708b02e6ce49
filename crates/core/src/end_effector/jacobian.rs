//! Jacobian of the end effector and mass matrix at many poses.
//!
//! The base frame's axes are turned into the frame of every link that carries the end effector, and its origin is
//! followed. A joint at p with axis z moves the end effector at `z x (o - p)`, or at z (Siciliano et al. 2009, eq. 3.30);
//! the joints' rates reduce these columns to the coordinates. Mass matrices are by composite bodies: see
//! [`crate::dynamics::crba`].
//!
//! Safety: all functions take a batch as described in [`crate::batch`], and a state that has grown to its mechanism, with
//! the joints' transforms.

use crate::batch::Batch;
use crate::batch::sweep::{RecursionState, for_each_batch_with};
use crate::dynamics::crba::{crba, joint_transforms, triangular_index};
use crate::error::{Error, expect_length};
use crate::linalg::vector::{Vector, cross, dot};
use crate::mechanism::motion::Motion;
use crate::mechanism::parameters::ParameterSets;
use crate::mechanism::shape::{JointShape, for_shape};
use crate::mechanism::transform::JointTransform;
use crate::mechanism::{Link, Mechanism};
use crate::memory::shared::SharedOutput;
use crate::memory::slot::Slot;
use crate::simd::dispatch::dispatched;
use crate::simd::inlined;
use crate::simd::lane::Lane;
use crate::simd::token::Simd;

/// Components of the end-effector velocity: linear, then angular.
const COMPONENTS: usize = 6;

/// The end effector: a point of a link.
#[derive(Debug, Clone, Copy)]
pub struct EndEffector {
    /// Index of the link.
    pub link: usize,
    /// Point in the link's frame, m.
    pub point: [f64; 3],
}

/// Chosen rows of the end effector's Jacobian at a batch of poses.
pub(crate) struct Jacobian<'a> {
    end_effector: EndEffector,
    rows: &'a [usize],
    /// Links that carry the end effector, from the base on.
    path: Vec<usize>,
    /// The base frame's axes in the link's frame, row by row: the link's orientation. Then the origin of the link, and in
    /// the end the point, in the base frame.
    frame: [Slot; 12],
    /// Axis and origin of each joint on the path, in the base frame.
    joints: Vec<[Slot; 6]>,
    /// Rows x coordinates.
    pub(crate) entries: Vec<Slot>,
}

impl<'a> Jacobian<'a> {
    pub(crate) fn new(mechanism: &Mechanism, end_effector: &EndEffector, rows: &'a [usize]) -> Jacobian<'a> {
        let mut path = Vec::new();
        let mut link = Some(end_effector.link);
        while let Some(i) = link {
            path.push(i);
            link = mechanism.links[i].parent;
        }
        path.reverse();
        Jacobian {
            end_effector: *end_effector,
            rows,
            frame: [Slot::ZERO; 12],
            joints: vec![[Slot::ZERO; 6]; path.len()],
            path,
            entries: vec![Slot::ZERO; rows.len() * mechanism.coordinates],
        }
    }

    /// Evaluate the rows at the lanes of a batch.
    ///
    /// # Safety
    ///
    /// As in the head of the file.
    #[inline(always)]
    pub(crate) unsafe fn evaluate<T: Lane>(&mut self, simd: Simd<T>, batch: Batch, state: &RecursionState) {
        // SAFETY: batch and state are as in the head of the file.
        unsafe {
            for k in batch.lanes(simd) {
                for (e, slot) in self.frame.iter_mut().enumerate() {
                    slot.store(k, simd.splat(if e < 9 && e % 4 == 0 { 1.0 } else { 0.0 }));
                }
            }
            for (&i, own) in self.path.iter().zip(&mut self.joints) {
                let link = &batch.mechanism.links[i];
                for_shape!(link.shape, shape => follow_link(simd, batch, (shape, link), &state.joints[i], (&mut self.frame, own)));
            }
            let point = inlined::map(self.end_effector.point, |x| simd.splat(x));
            for k in batch.lanes(simd) {
                move_origin(simd, &mut self.frame, point, k);
            }
            self.columns(simd, batch);
        }
    }

    /// The columns of all joints on the path, reduced to the coordinates.
    #[inline(always)]
    unsafe fn columns<T: Lane>(&mut self, simd: Simd<T>, batch: Batch) {
        let na = batch.mechanism.coordinates;
        // SAFETY: `lanes` leaves room for a lane in the slots, and channels are readable at every lane.
        unsafe {
            for entry in &mut self.entries {
                batch.lanes(simd).for_each(|k| entry.store(k, simd.splat(0.0)));
            }
            for (&i, own) in self.path.iter().zip(&self.joints) {
                let link = &batch.mechanism.links[i];
                for k in batch.lanes(simd) {
                    let axis: Vector<T> = inlined::from_fn(|e| own[e].load(simd, k));
                    let arm = inlined::from_fn(|e| self.frame[9 + e].load(simd, k).sub(own[3 + e].load(simd, k)));
                    let (linear, angular) = match link.is_prismatic() {
                        true => (axis, [simd.splat(0.0); 3]),
                        false => (cross(axis, arm), axis),
                    };
                    for &(a, rate) in &link.joint_map.rates {
                        let rate: T = batch.rate(simd, rate, k);
                        for (place, &row) in self.rows.iter().enumerate() {
                            let part = if row < 3 { linear[row] } else { angular[row - 3] };
                            let entry = &mut self.entries[place * na + a];
                            entry.store(k, part.fma(rate, entry.load(simd, k)));
                        }
                    }
                }
            }
        }
    }
}

/// Orientation and origin of a link from its parent's, and axis and origin of its joint, in the base frame.
#[inline(always)]
unsafe fn follow_link<T: Lane>(
    simd: Simd<T>,
    batch: Batch,
    (shape, link): (JointShape, &Link),
    joint: &[Slot; 3],
    (frame, own): (&mut [Slot; 12], &mut [Slot; 6]),
) {
    let at_zero = JointTransform::at_zero(simd, shape, link);
    for k in batch.lanes(simd) {
        // SAFETY: `lanes` leaves room for a lane in the slots.
        unsafe {
            let joint = at_zero.load(joint.as_ptr(), k);
            if let Some(origin) = joint.offset() {
                move_origin(simd, frame, origin, k);
            }
            for row in 0..3 {
                let axes = &mut frame[3 * row..][..3];
                let turned = joint.rotate(inlined::from_fn(|e| axes[e].load(simd, k)));
                for (slot, x) in axes.iter_mut().zip(turned) {
                    slot.store(k, x);
                }
                own[row].store(k, turned[2]);
                own[3 + row].store(k, frame[9 + row].load(simd, k));
            }
        }
    }
}

/// Move the frame's origin by a vector in its own axes.
#[inline(always)]
unsafe fn move_origin<T: Lane>(simd: Simd<T>, frame: &mut [Slot; 12], by: Vector<T>, k: usize) {
    for row in 0..3 {
        // SAFETY: the caller promises room for a lane from k on.
        unsafe {
            let axes: Vector<T> = inlined::from_fn(|e| frame[3 * row + e].load(simd, k));
            let moved = frame[9 + row].load(simd, k).add(dot(axes, by));
            frame[9 + row].store(k, moved);
        }
    }
}

dispatched! {
    unsafe fn evaluate = evaluate_in_lanes(batch: Batch, state: &RecursionState, jacobian: &mut Jacobian)
}

#[inline(always)]
unsafe fn evaluate_in_lanes<T: Lane>(simd: Simd<T>, batch: Batch, state: &RecursionState, jacobian: &mut Jacobian) {
    // SAFETY: the caller's promise.
    unsafe { jacobian.evaluate(simd, batch, state) }
}

/// Check what all kernels at the end effector are given.
pub(crate) fn check(
    mechanism: &Mechanism,
    motion: &Motion,
    end_effector: &EndEffector,
    rows: &[usize],
) -> Result<(), Error> {
    motion.check_poses(mechanism)?;
    let limit = mechanism.links.len();
    if end_effector.link >= limit {
        return Err(Error::Index { name: "handle link", got: end_effector.link, limit });
    }
    check_indices("row", rows, COMPONENTS)
}

/// Chosen rows of the end effector's Jacobian (rows x coordinates), then the mass matrix (coordinates x coordinates),
/// as one row of `out` for each pose. Rows are velocities in the base frame: 0 to 2 linear, 3 to 5 angular. Of the
/// motion only positions and loops are read; `chi` are parameters as for [`crate::mass_matrix`].
///
/// # Example
///
/// ```
/// # use haptid_core::*;
/// # let joint = Joint { parent: None, rotation: [1., 0., 0., 0., 1., 0., 0., 0., 1.], translation: [0.; 3], prismatic: false };
/// # let pendulum = Mechanism::new(&[joint], &Closure::open(1), [0., -9.81, 0.], &[], Backend::best())?;
/// # let chi = [0., 0., 0., 0., 0., 0.5, 1., 0., 0., 2.];
/// // A pendulum of 2 kg whose end effector is the mass, at 0.5 m: J by angular velocity, then ZZ.
/// let poses = Motion { samples: 1, position: &[0.3], velocity: &[], acceleration: None, external: &[], loops: &[] };
/// let end_effector = EndEffector { link: 0, point: [0.5, 0., 0.] };
/// let mut out = [0.; 2];
/// end_effector_dynamics(&pendulum, &poses, &end_effector, &chi, &[5], &mut out)?;
/// assert!((out[0] - 1.).abs() < 1e-12 && (out[1] - 0.5).abs() < 1e-12);
/// # Ok::<(), haptid_core::Error>(())
/// ```
pub fn end_effector_dynamics(
    mechanism: &Mechanism,
    motion: &Motion,
    end_effector: &EndEffector,
    chi: &[f64],
    rows: &[usize],
    out: &mut [f64],
) -> Result<(), Error> {
    check(mechanism, motion, end_effector, rows)?;
    let (na, backend) = (mechanism.coordinates, mechanism.backend);
    let width = (rows.len() + na) * na;
    expect_length("out", out.len(), motion.samples * width)?;
    let (sets, shared) = (ParameterSets::new(mechanism, motion.samples, chi)?, SharedOutput::new(out));
    let start = || Jacobian::new(mechanism, end_effector, rows);
    for_each_batch_with(mechanism, motion, &sets, start, |batch, from, bodies, state, jacobian| {
        // SAFETY: [`for_each_batch_with`] gives a batch and a state of the mechanism; batches are disjoint ranges of
        // samples, whose entries of `out` only this call writes.
        unsafe {
            joint_transforms(backend, batch, state);
            crba(backend, batch, bodies, state);
            evaluate(backend, batch, state, jacobian);
            let mass = (0..na * na).map(|e| &state.mass[triangular_index(e / na, e % na)]);
            for (e, slot) in jacobian.entries.iter().chain(mass).enumerate() {
                for (k, &x) in slot.0[..batch.samples].iter().enumerate() {
                    shared.at((from + k) * width + e).write(x);
                }
            }
        }
    });
    Ok(())
}

/// Check that indices are below a limit, each at most once.
pub(crate) fn check_indices(name: &'static str, indices: &[usize], limit: usize) -> Result<(), Error> {
    for (k, &got) in indices.iter().enumerate() {
        if got >= limit {
            return Err(Error::Index { name, got, limit });
        }
        if indices[..k].contains(&got) {
            return Err(Error::Repeated { name, got });
        }
    }
    Ok(())
}
