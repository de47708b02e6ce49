//! Axes of coordinates in slots, and transforms of joints at a batch.

use crate::batch::{Batch, JointChannels};
use crate::linalg::vector::Vector;
use crate::mechanism::Link;
use crate::mechanism::transform::{JointTransform, TransformSlots};
use crate::memory::slot::{Slot, load, store};
use crate::simd::lane::Lane;
use crate::simd::token::Simd;

/// Angular and linear part of an axis.
pub(crate) type AxisSlots = [Slot; 6];

/// Load an axis.
///
/// # Safety
///
/// `slots` points to the six slots of an axis, and `k + T::WIDTH <= BATCH`.
#[inline(always)]
pub(crate) unsafe fn load_axis<T: Lane>(simd: Simd<T>, slots: *const Slot, k: usize) -> (Vector<T>, Vector<T>) {
    // SAFETY: the caller promises six slots and room for a lane.
    let s: [T; 6] = unsafe { load(simd, slots, k) };
    ([s[0], s[1], s[2]], [s[3], s[4], s[5]])
}

/// Store an axis.
///
/// # Safety
///
/// As for [`load_axis`], and nobody else uses the slots meanwhile.
#[inline(always)]
pub(crate) unsafe fn store_axis<T: Lane>(slots: *mut Slot, k: usize, (x, u): (Vector<T>, Vector<T>)) {
    // SAFETY: the caller promises six slots and room for a lane.
    unsafe { store(slots, k, [x[0], x[1], x[2], u[0], u[1], u[2]]) }
}

/// Store the joint's transform at every sample of a batch.
///
/// # Safety
///
/// See [`crate::batch`].
#[inline(always)]
pub(crate) unsafe fn store_transform<T: Lane>(
    simd: Simd<T>,
    batch: Batch,
    link: &Link,
    followed: JointChannels,
    slots: &mut TransformSlots,
) {
    let joint = JointTransform::at_zero(simd, link.shape, link);
    for k in batch.lanes(simd) {
        // SAFETY: `lanes` leaves room for a lane in the three slots.
        unsafe { joint.at(followed.at(simd, k)[0]).store(slots.as_mut_ptr(), k) };
    }
}
