//! Arrays made item by item, always inlined.
//!
//! The standard library's functions for arrays are not: where the compiler leaves a call of one, its closure is compiled
//! apart, without the lanes' instructions, and every operation of the closure becomes a call through memory.

use core::mem::MaybeUninit;

/// Array of `f(0)`, `f(1)` and so on.
#[inline(always)]
pub(crate) fn from_fn<X: Copy, const N: usize>(mut f: impl FnMut(usize) -> X) -> [X; N] {
    let mut made = [const { MaybeUninit::uninit() }; N];
    let mut k = 0;
    while k < N {
        made[k] = MaybeUninit::new(f(k));
        k += 1;
    }
    // SAFETY: every item has been written, and `MaybeUninit<X>` has the layout of `X`.
    unsafe { (&raw const made).cast::<[X; N]>().read() }
}

/// Array of `f` of each item.
#[inline(always)]
pub(crate) fn map<X: Copy, Y: Copy, const N: usize>(items: [X; N], mut f: impl FnMut(X) -> Y) -> [Y; N] {
    from_fn(|k| f(items[k]))
}
