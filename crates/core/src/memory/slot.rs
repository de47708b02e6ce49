//! Slots: one quantity at every sample of a batch, or at a group of poses.

use crate::simd::lane::{Lane, MAX_WIDTH};
use crate::simd::token::Simd;

/// Samples in a batch.
pub(crate) const BATCH: usize = 32;

/// One quantity at every sample of a batch, aligned so that no lane crosses a cache line.
#[derive(Clone, Copy)]
#[repr(C, align(64))]
pub(crate) struct Slot(pub(crate) [f64; BATCH]);

impl Slot {
    pub(crate) const ZERO: Slot = Slot([0.0; BATCH]);
}

impl Default for Slot {
    fn default() -> Slot {
        Slot::ZERO
    }
}

/// Poses in a group: two of the widest lanes, so that one goes on while the other waits for a square root.
pub(crate) const POSES: usize = 2 * MAX_WIDTH;

/// One quantity at a group of poses, aligned so that no lane crosses a cache line.
#[derive(Clone, Copy)]
#[repr(C, align(64))]
pub(crate) struct PoseSlot(pub(crate) [f64; POSES]);

impl PoseSlot {
    pub(crate) const ZERO: PoseSlot = PoseSlot([0.0; POSES]);

    /// The lane from pose `k` on.
    ///
    /// # Safety
    ///
    /// `k + T::WIDTH <= POSES`.
    #[inline(always)]
    pub(crate) unsafe fn load<T: Lane>(&self, simd: Simd<T>, k: usize) -> T {
        debug_assert!(k + T::WIDTH <= POSES);
        // SAFETY: the caller's promise.
        unsafe { simd.load(self.0.as_ptr().add(k)) }
    }

    /// Write the lane from pose `k` on.
    ///
    /// # Safety
    ///
    /// As for [`PoseSlot::load`].
    #[inline(always)]
    pub(crate) unsafe fn store<T: Lane>(&mut self, k: usize, lane: T) {
        debug_assert!(k + T::WIDTH <= POSES);
        // SAFETY: the caller's promise.
        unsafe { lane.store(self.0.as_mut_ptr().add(k)) };
    }
}

/// Lanes of `N` successive slots, from sample `k` on.
///
/// # Safety
///
/// `first` points to `N` initialised slots that nobody writes meanwhile, and `k + T::WIDTH <= BATCH`.
#[inline(always)]
pub(crate) unsafe fn load<T: Lane, const N: usize>(simd: Simd<T>, first: *const Slot, k: usize) -> [T; N] {
    // SAFETY: `e < N` and `k + T::WIDTH <= BATCH` keep the lane inside slot e of those promised.
    core::array::from_fn(|e| unsafe { simd.load(first.add(e).cast::<f64>().add(k)) })
}

/// Write lanes to `N` successive slots, from sample `k` on.
///
/// # Safety
///
/// As for [`load`], and nobody else reads or writes the slots meanwhile.
#[inline(always)]
pub(crate) unsafe fn store<T: Lane, const N: usize>(first: *mut Slot, k: usize, lanes: [T; N]) {
    for (e, lane) in lanes.into_iter().enumerate() {
        // SAFETY: as in [`load`].
        unsafe { lane.store(first.add(e).cast::<f64>().add(k)) };
    }
}

/// First poses of a group's lanes.
#[inline(always)]
pub(crate) fn pose_lanes<T: Lane>(_: Simd<T>) -> impl Iterator<Item = usize> {
    (0..POSES / T::WIDTH).map(|lane| lane * T::WIDTH)
}

/// Extend a buffer to at least this length; the present items are kept.
pub(crate) fn grow<X: Clone>(buffer: &mut Vec<X>, wanted: usize, empty: X) {
    if buffer.len() < wanted {
        buffer.resize(wanted, empty);
    }
}
