//! Direct dynamics: accelerations from torques, and the mass matrix for itself.

use crate::batch::{Batch, Slot, load, store};
use crate::composite::{masses, place, turns};
use crate::dispatch::dispatched;
use crate::error::{Error, expect_length};
use crate::lane::Lane;
use crate::mechanism::Mechanism;
use crate::newton_euler::torques;
use crate::parameters::Sets;
use crate::regressor::{Motion, Shared};
use crate::sweep::{Passing, each_batch, put_rows, stage};
use std::sync::atomic::{AtomicUsize, Ordering};

/// A mass matrix is positive definite where every pivot exceeds this share of its diagonal entry: less is rounding.
const LEAST: f64 = f64::EPSILON;

/// Mass matrices, coordinates x coordinates for every sample, from positions and loops alone; parameters as for
/// [`crate::torque`].
pub fn mass_matrix(mechanism: &Mechanism, motion: &Motion, chi: &[f64], out: &mut [f64]) -> Result<(), Error> {
    let na = mechanism.coordinates;
    motion.check_poses(mechanism)?;
    expect_length("out", out.len(), na * na * motion.samples)?;
    let (sets, shared) = (Sets::new(mechanism, motion.samples, chi)?, Shared::new(out));
    each_batch(mechanism, motion, &sets, |batch, from, bodies, passing| {
        // SAFETY: the workspace has grown to the mechanism; nobody else writes these samples.
        unsafe {
            turns(mechanism.backend, batch, passing);
            masses(mechanism.backend, batch, bodies, passing);
            for a in 0..na {
                for b in 0..na {
                    let entry = &passing.mass[place(a, b)].0[..batch.samples];
                    for (k, &x) in entry.iter().enumerate() {
                        shared.at(((from + k) * na + a) * na + b).write(x);
                    }
                }
            }
        }
    });
    Ok(())
}

/// Accelerations of the coordinates under torques (coordinates x samples): `out[a * samples + k]`. Parameters as for
/// [`crate::torque`]; the motion's own accelerations do not count.
///
/// Returns the first sample whose mass matrix is not positive definite, if there is one: its numbers mean nothing.
pub fn acceleration(
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
    let (sets, shared) = (Sets::new(mechanism, n, chi)?, Shared::new(out));
    let failed = AtomicUsize::new(usize::MAX);
    each_batch(mechanism, motion, &sets, |batch, from, bodies, passing| {
        let count = batch.samples;
        for (a, slot) in passing.other[..na].iter_mut().enumerate() {
            stage(slot, &torque[a * n + from..][..count]);
        }
        // SAFETY: the workspace has grown to the mechanism; nobody else writes these samples.
        unsafe {
            torques(mechanism.backend, batch, bodies, passing);
            masses(mechanism.backend, batch, bodies, passing);
            solve(mechanism.backend, batch, passing);
            put_rows(&passing.other[..na], (from, count), n, shared);
        }
        if let Some(k) = passing.margin.0[..count].iter().position(|&margin| margin <= 0.0) {
            failed.fetch_min(from + k, Ordering::Relaxed);
        }
    });
    let failed = failed.into_inner();
    Ok((failed < n).then_some(failed))
}

dispatched! {
    /// From torques in `other` to accelerations there.
    ///
    /// # Safety
    /// Mass matrix and bias are there.
    unsafe fn solve = solve_in_lanes(batch: Batch, passing: &mut Passing)
}

#[inline(always)]
unsafe fn solve_in_lanes<T: Lane>(batch: Batch, passing: &mut Passing) {
    let Passing { mass, torque, other, margin, .. } = passing;
    let other = &mut other[..batch.mechanism.coordinates];
    for k in batch.lanes::<T>() {
        unsafe {
            for (asked, bias) in other.iter_mut().zip(torque.iter()) {
                store(asked, k, [lane::<T>(asked, k).sub(lane(bias, k))]);
            }
            let least = solve_lane::<T>(mass, other, k);
            store(margin, k, [least]);
        }
    }
}

#[inline(always)]
unsafe fn lane<T: Lane>(slot: &Slot, k: usize) -> T {
    let [x] = unsafe { load(slot, k) };
    x
}

/// Solve with the factors `L D L'` of a symmetric matrix, given as its lower triangle, which they replace: the inverses
/// of the pivots stand on the diagonal. Returns the least of what a pivot has above what rounding may leave of it.
#[inline(always)]
unsafe fn solve_lane<T: Lane>(mass: &mut [Slot], right: &mut [Slot], k: usize) -> T {
    let mut least = T::splat(f64::MAX);
    unsafe {
        for i in 0..right.len() {
            let (above, row) = mass.split_at_mut(i * (i + 1) / 2);
            for j in 0..i {
                let other = &above[j * (j + 1) / 2..];
                let mut entry = lane::<T>(&row[j], k);
                for m in 0..j {
                    entry = lane::<T>(&row[m], k).fnma(lane(&other[m], k), entry);
                }
                store(&mut row[j], k, [entry]);
            }
            let (whole, mut x): (T, T) = (lane(&row[i], k), lane(&right[i], k));
            let mut pivot = whole;
            for j in 0..i {
                let entry = lane::<T>(&row[j], k);
                let factor = entry.mul(lane(&above[place(j, j)], k));
                (pivot, x) = (entry.fnma(factor, pivot), factor.fnma(lane(&right[j], k), x));
                store(&mut row[j], k, [factor]);
            }
            let margin = whole.fnma(T::splat(LEAST), pivot);
            least = T::select_gt(least, margin, margin, least);
            store(&mut row[i], k, [T::splat(1.0).div(pivot)]);
            store(&mut right[i], k, [x]);
        }
        for i in (0..right.len()).rev() {
            let mut x = lane::<T>(&right[i], k).mul(lane(&mass[place(i, i)], k));
            for j in i + 1..right.len() {
                x = lane::<T>(&mass[place(j, i)], k).fnma(lane(&right[j], k), x);
            }
            store(&mut right[i], k, [x]);
        }
    }
    least
}
