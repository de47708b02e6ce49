//! Non-temporal stores: long runs of numbers that are not read again soon bypass the caches, so that their lines are
//! not fetched first.

use crate::simd::dispatch::{Backend, dispatched};
use crate::simd::lane::Lane;
use crate::simd::token::Simd;

/// Copy `count` numbers past the caches. Call [`fence`] before another thread reads them.
///
/// # Safety
///
/// `from` is valid for reading and `to` for writing `count` numbers; they do not overlap.
pub(crate) unsafe fn copy(backend: Backend, from: *const f64, to: *mut f64, count: usize) {
    // SAFETY: the caller's promise is that of the kernel.
    unsafe { copy_raw(backend, from, to, count) }
}

/// Make non-temporal stores visible to other threads.
pub(crate) fn fence() {
    // Miri has no fence, and its lanes store as usual.
    #[cfg(all(target_arch = "x86_64", not(miri)))]
    // SAFETY: `sfence` belongs to SSE, which every x86-64 processor has.
    unsafe {
        core::arch::x86_64::_mm_sfence()
    }
}

dispatched! {
    unsafe fn copy_raw = copy_in_lanes(from: *const f64, to: *mut f64, count: usize)
}

#[inline(always)]
unsafe fn copy_in_lanes<T: Lane>(simd: Simd<T>, from: *const f64, to: *mut f64, count: usize) {
    let bytes = T::WIDTH * size_of::<f64>();
    let aligned = (to.align_offset(bytes)).min(count);
    let whole = aligned + (count - aligned) / T::WIDTH * T::WIDTH;
    // SAFETY: every access is to numbers `0..count` of both arrays; from `aligned` on `to` is aligned to the lane, as
    // `stream` requires.
    unsafe {
        core::ptr::copy_nonoverlapping(from, to, aligned);
        let mut k = aligned;
        while k < whole {
            simd.load(from.add(k)).stream(to.add(k));
            k += T::WIDTH;
        }
        core::ptr::copy_nonoverlapping(from.add(whole), to.add(whole), count - whole);
    }
}
