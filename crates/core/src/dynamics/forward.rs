//! Forward dynamics: accelerations from torques; and the mass matrix.

use crate::batch::Batch;
use crate::batch::sweep::{RecursionState, for_each_batch, stage_slot, write_rows};
use crate::dynamics::crba::{crba, joint_transforms, triangular_index};
use crate::dynamics::rnea::rnea;
use crate::error::{Error, expect_length};
use crate::mechanism::Mechanism;
use crate::mechanism::motion::Motion;
use crate::mechanism::parameters::ParameterSets;
use crate::memory::shared::SharedOutput;
use crate::memory::slot::{Slot, load, store};
use crate::simd::dispatch::dispatched;
use crate::simd::lane::Lane;
use crate::simd::token::Simd;
use std::sync::atomic::{AtomicUsize, Ordering};

/// The mass matrix counts as positive definite where every pivot exceeds this share of its diagonal entry; less is
/// rounding error.
const MIN_PIVOT: f64 = f64::EPSILON;

/// Mass matrices, samples x coordinates x coordinates, kg m^2 or kg, by the composite-rigid-body algorithm. Only
/// positions and loops of the motion are read; parameters as for [`crate::inverse_dynamics`].
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
/// let mut mass = [0.; 3];
/// mass_matrix(&pendulum, &motion, &chi, &mut mass)?;
/// assert!(mass.iter().all(|m| (m - 0.5).abs() < 1e-12));
/// # Ok::<(), haptid_core::Error>(())
/// ```
pub fn mass_matrix(mechanism: &Mechanism, motion: &Motion, chi: &[f64], out: &mut [f64]) -> Result<(), Error> {
    let na = mechanism.coordinates;
    motion.check_poses(mechanism)?;
    expect_length("out", out.len(), na * na * motion.samples)?;
    let (sets, shared) = (ParameterSets::new(mechanism, motion.samples, chi)?, SharedOutput::new(out));
    for_each_batch(mechanism, motion, &sets, |batch, from, bodies, state| {
        // SAFETY: [`for_each_batch`] gives a batch and a state of the mechanism; batches are disjoint ranges of
        // samples, whose entries of `out` only this call writes.
        unsafe {
            joint_transforms(mechanism.backend, batch, state);
            crba(mechanism.backend, batch, bodies, state);
            for a in 0..na {
                for b in 0..na {
                    let entry = &state.mass[triangular_index(a, b)].0[..batch.samples];
                    for (k, &x) in entry.iter().enumerate() {
                        shared.at(((from + k) * na + a) * na + b).write(x);
                    }
                }
            }
        }
    });
    Ok(())
}

/// Accelerations of the coordinates, `out[a * samples + k]`, under given torques (coordinates x samples): `M^-1 (torque
/// - bias)`. Parameters as for [`crate::inverse_dynamics`]; the motion's own accelerations are ignored.
///
/// Returns the first sample whose mass matrix is not positive definite, if there is one; its accelerations are
/// meaningless.
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
/// let mut acceleration = [0.; 3];
/// let singular = forward_dynamics(&pendulum, &motion, &[9.81 + 0.5, 0., 0.], &chi, &mut acceleration)?;
/// assert!(singular.is_none() && (acceleration[0] - 1.).abs() < 1e-12);
/// # Ok::<(), haptid_core::Error>(())
/// ```
pub fn forward_dynamics(
    mechanism: &Mechanism,
    motion: &Motion,
    torque: &[f64],
    chi: &[f64],
    out: &mut [f64],
) -> Result<Option<usize>, Error> {
    let (motion, n, na) = (&Motion { acceleration: None, ..*motion }, motion.samples, mechanism.coordinates);
    motion.check(mechanism)?;
    expect_length("torque", torque.len(), na * n)?;
    expect_length("out", out.len(), na * n)?;
    let (sets, shared) = (ParameterSets::new(mechanism, n, chi)?, SharedOutput::new(out));
    let failed = AtomicUsize::new(usize::MAX);
    for_each_batch(mechanism, motion, &sets, |batch, from, bodies, state| {
        let count = batch.samples;
        for (a, slot) in state.other[..na].iter_mut().enumerate() {
            stage_slot(slot, &torque[a * n + from..][..count]);
        }
        // SAFETY: [`for_each_batch`] gives a batch and a state of the mechanism; batches are disjoint ranges of
        // samples, which only this call writes.
        unsafe {
            rnea(mechanism.backend, batch, bodies, state);
            crba(mechanism.backend, batch, bodies, state);
            solve(mechanism.backend, batch, state);
            write_rows(&state.other[..na], (from, count), n, shared);
        }
        if let Some(k) = state.margin.0[..count].iter().position(|&margin| margin <= 0.0) {
            failed.fetch_min(from + k, Ordering::Relaxed);
        }
    });
    let failed = failed.into_inner();
    Ok((failed < n).then_some(failed))
}

dispatched! {
    /// Solve for the accelerations: `other` holds torques, and then accelerations.
    ///
    /// # Safety
    ///
    /// Batch and state as in [`crate::dynamics::crba`].
    unsafe fn solve = solve_in_lanes(batch: Batch, state: &mut RecursionState)
}

#[inline(always)]
unsafe fn solve_in_lanes<T: Lane>(simd: Simd<T>, batch: Batch, state: &mut RecursionState) {
    let RecursionState { mass, torque, other, margin, .. } = state;
    let other = &mut other[..batch.mechanism.coordinates];
    for k in batch.lanes(simd) {
        // SAFETY: `lanes` leaves room for a lane in the slots.
        unsafe {
            for (asked, bias) in other.iter_mut().zip(torque.iter()) {
                store(asked, k, [lane(simd, asked, k).sub(lane(simd, bias, k))]);
            }
            let least = solve_lane(simd, mass, other, k);
            store(margin, k, [least]);
        }
    }
}

#[inline(always)]
unsafe fn lane<T: Lane>(simd: Simd<T>, slot: &Slot, k: usize) -> T {
    // SAFETY: the caller promises room for a lane from k on.
    let [x] = unsafe { load(simd, slot, k) };
    x
}

/// Solve by `L D L'` factorisation of a symmetric matrix, given as its lower triangle, which the factors replace; the
/// reciprocals of the pivots stand on the diagonal. Returns the smallest margin of a pivot over its rounding error.
#[inline(always)]
unsafe fn solve_lane<T: Lane>(simd: Simd<T>, mass: &mut [Slot], right: &mut [Slot], k: usize) -> T {
    let mut least = simd.splat(f64::MAX);
    // SAFETY: the caller promises room for a lane from k on, in every slot.
    unsafe {
        for i in 0..right.len() {
            let (above, row) = mass.split_at_mut(i * (i + 1) / 2);
            for j in 0..i {
                let other = &above[j * (j + 1) / 2..];
                let mut entry = lane(simd, &row[j], k);
                for m in 0..j {
                    entry = lane(simd, &row[m], k).fnma(lane(simd, &other[m], k), entry);
                }
                store(&mut row[j], k, [entry]);
            }
            let (whole, mut x): (T, T) = (lane(simd, &row[i], k), lane(simd, &right[i], k));
            let mut pivot = whole;
            for j in 0..i {
                let entry = lane(simd, &row[j], k);
                let factor = entry.mul(lane(simd, &above[triangular_index(j, j)], k));
                (pivot, x) = (entry.fnma(factor, pivot), factor.fnma(lane(simd, &right[j], k), x));
                store(&mut row[j], k, [factor]);
            }
            let margin = whole.fnma(simd.splat(MIN_PIVOT), pivot);
            least = T::select_gt(least, margin, margin, least);
            store(&mut row[i], k, [simd.splat(1.0).div(pivot)]);
            store(&mut right[i], k, [x]);
        }
        for i in (0..right.len()).rev() {
            let mut x = lane(simd, &right[i], k).mul(lane(simd, &mass[triangular_index(i, i)], k));
            for j in i + 1..right.len() {
                x = lane(simd, &mass[triangular_index(j, i)], k).fnma(lane(simd, &right[j], k), x);
            }
            store(&mut right[i], k, [x]);
        }
    }
    least
}
