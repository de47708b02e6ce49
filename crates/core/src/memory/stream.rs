//! Long runs of numbers to memory that will not be read soon: past the caches, so that lines are not fetched first.

use crate::simd::dispatch::{Backend, dispatched};
use crate::simd::lane::Lane;

/// Copy `count` numbers to where no cache needs them. [`settle`] before anybody else reads them.
///
/// # Safety
/// Both are valid for `count` numbers, and do not overlap.
pub(crate) unsafe fn copy(backend: Backend, from: *const f64, to: *mut f64, count: usize) {
    unsafe { copy_raw(backend, from, to, count) }
}

/// Make streamed numbers visible to other threads.
pub(crate) fn settle() {
    #[cfg(target_arch = "x86_64")]
    // SAFETY: every x86-64 machine has this instruction.
    unsafe {
        core::arch::x86_64::_mm_sfence()
    }
}

dispatched! {
    unsafe fn copy_raw = copy_in_lanes(from: *const f64, to: *mut f64, count: usize)
}

#[inline(always)]
unsafe fn copy_in_lanes<T: Lane>(from: *const f64, to: *mut f64, count: usize) {
    let bytes = T::WIDTH * size_of::<f64>();
    let aligned = (to.align_offset(bytes)).min(count);
    let whole = aligned + (count - aligned) / T::WIDTH * T::WIDTH;
    unsafe {
        core::ptr::copy_nonoverlapping(from, to, aligned);
        let mut k = aligned;
        while k < whole {
            T::load(from.add(k)).stream(to.add(k));
            k += T::WIDTH;
        }
        core::ptr::copy_nonoverlapping(from.add(whole), to.add(whole), count - whole);
    }
}
