//! Slots: one quantity at every sample of a batch.

use crate::simd::inlined;
use crate::simd::lane::{Lane, MAX_WIDTH};
use crate::simd::token::Simd;

/// Samples in a batch.
pub(crate) const BATCH: usize = 32;

/// Lanes that are computed together where one alone would wait for its own results.
pub(crate) const GROUP: usize = 4;
const _: () = assert!(BATCH.is_multiple_of(GROUP * MAX_WIDTH), "a batch is whole groups");

/// One quantity at every sample of a batch, aligned so that no lane crosses a cache line.
#[derive(Clone, Copy)]
#[repr(C, align(64))]
pub(crate) struct Slot(pub(crate) [f64; BATCH]);

impl Slot {
    pub(crate) const ZERO: Slot = Slot([0.0; BATCH]);

    /// The lane from sample `k` on.
    ///
    /// # Safety
    ///
    /// `k + T::WIDTH <= BATCH`.
    #[inline(always)]
    pub(crate) unsafe fn load<T: Lane>(&self, simd: Simd<T>, k: usize) -> T {
        debug_assert!(k + T::WIDTH <= BATCH);
        // SAFETY: the caller's promise.
        unsafe { simd.load(self.0.as_ptr().add(k)) }
    }

    /// The lanes of a group, from sample `k` on.
    ///
    /// # Safety
    ///
    /// `k` is one of [`groups`].
    #[inline(always)]
    pub(crate) unsafe fn load_group<T: Lane>(&self, simd: Simd<T>, k: usize) -> [T; GROUP] {
        let mut lanes = [simd.splat(0.0); GROUP];
        for (g, lane) in lanes.iter_mut().enumerate() {
            // SAFETY: a batch is a multiple of the group.
            *lane = unsafe { self.load(simd, k + g * T::WIDTH) };
        }
        lanes
    }

    /// Write the lanes of a group, from sample `k` on.
    ///
    /// # Safety
    ///
    /// As for [`Slot::load_group`].
    #[inline(always)]
    pub(crate) unsafe fn store_group<T: Lane>(&mut self, k: usize, lanes: [T; GROUP]) {
        for (g, lane) in lanes.into_iter().enumerate() {
            // SAFETY: as above.
            unsafe { self.store(k + g * T::WIDTH, lane) };
        }
    }

    /// Write the lane from sample `k` on.
    ///
    /// # Safety
    ///
    /// As for [`Slot::load`].
    #[inline(always)]
    pub(crate) unsafe fn store<T: Lane>(&mut self, k: usize, lane: T) {
        debug_assert!(k + T::WIDTH <= BATCH);
        // SAFETY: the caller's promise.
        unsafe { lane.store(self.0.as_mut_ptr().add(k)) };
    }
}

impl Default for Slot {
    fn default() -> Slot {
        Slot::ZERO
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
    inlined::from_fn(|e| unsafe { simd.load(first.add(e).cast::<f64>().add(k)) })
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

/// Number of the first sample of each group of lanes, for this many samples.
#[inline(always)]
pub(crate) fn groups<T: Lane>(_: Simd<T>, samples: usize) -> impl Iterator<Item = usize> {
    (0..samples.div_ceil(GROUP * T::WIDTH)).map(|group| group * GROUP * T::WIDTH)
}

/// Extend a buffer to at least this length; the present items are kept.
pub(crate) fn grow<X: Clone>(buffer: &mut Vec<X>, wanted: usize, empty: X) {
    if buffer.len() < wanted {
        buffer.resize(wanted, empty);
    }
}
