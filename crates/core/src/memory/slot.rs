//! Slots: one quantity at every sample of a batch.

use crate::simd::lane::Lane;

/// Samples carried through the mechanism together.
pub(crate) const BATCH: usize = 32;

/// One quantity of every sample of a batch, where no lane crosses a line of the caches.
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

/// Numbers of a slot, or a channel, as lanes.
///
/// # Safety
/// `first` has `N` slots, and a lane from `k` on is inside them.
#[inline(always)]
pub(crate) unsafe fn load<T: Lane, const N: usize>(first: *const Slot, k: usize) -> [T; N] {
    core::array::from_fn(|e| unsafe { T::load(first.add(e).cast::<f64>().add(k)) })
}

/// # Safety
/// As for [`load`], and nobody else reads or writes them.
#[inline(always)]
pub(crate) unsafe fn store<T: Lane, const N: usize>(first: *mut Slot, k: usize, lanes: [T; N]) {
    for (e, lane) in lanes.into_iter().enumerate() {
        unsafe { lane.store(first.add(e).cast::<f64>().add(k)) };
    }
}

/// Lengthen a buffer to what is wanted; what is there stays.
pub(crate) fn grow<X: Clone>(buffer: &mut Vec<X>, wanted: usize, empty: X) {
    if buffer.len() < wanted {
        buffer.resize(wanted, empty);
    }
}
