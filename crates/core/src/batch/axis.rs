//! Axes of coordinates in slots, and the joint's position.

use crate::batch::{Batch, JointChannels};
use crate::linalg::vector::Vector;
use crate::mechanism::Link;
use crate::mechanism::transform::{JointTransform, TransformSlots};
use crate::memory::slot::{Slot, load, store};
use crate::simd::lane::Lane;

/// Both vectors of an axis.
pub(crate) type AxisSlots = [Slot; 6];

/// # Safety
/// `slots` are an axis's, and a lane from `k` on is inside them.
#[inline(always)]
pub(crate) unsafe fn load_axis<T: Lane>(slots: *const Slot, k: usize) -> (Vector<T>, Vector<T>) {
    let s: [T; 6] = unsafe { load(slots, k) };
    ([s[0], s[1], s[2]], [s[3], s[4], s[5]])
}

/// # Safety
/// As for [`load_axis`].
#[inline(always)]
pub(crate) unsafe fn store_axis<T: Lane>(slots: *mut Slot, k: usize, (x, u): (Vector<T>, Vector<T>)) {
    unsafe { store(slots, k, [x[0], x[1], x[2], u[0], u[1], u[2]]) }
}

/// What the joint's position changes, for the link and the axes.
#[inline(always)]
pub(crate) unsafe fn store_transform<T: Lane>(
    batch: Batch,
    link: &Link,
    followed: JointChannels,
    slots: &mut TransformSlots,
) {
    let joint = JointTransform::<T>::at_zero(link.shape, link);
    for k in batch.lanes::<T>() {
        unsafe { joint.at(followed.at(k)[0]).store(slots.as_mut_ptr(), k) };
    }
}
