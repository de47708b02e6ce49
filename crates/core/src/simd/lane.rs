//! Lanes: a few samples side by side, so that one instruction works on all of them.
//!
//! The trait is thin on purpose: the kernels are written once, and compiled once per back end (see `dispatch`).

use crate::simd::elementary;

/// Widest lane of any back end; buffers leave this much room after their last sample.
pub const MAX_WIDTH: usize = 8;

/// A few samples of one quantity. Every method is `inline(always)`: it must end up inside a function that was
/// compiled for the back end's instructions, never stand alone.
pub trait Lane: Copy {
    const WIDTH: usize;
    /// Columns that the triangle takes at a time: as many as keep their inner products in the registers.
    const PANEL: usize;
    fn splat(x: f64) -> Self;
    /// # Safety
    /// `p` is valid for reading `WIDTH` numbers.
    unsafe fn load(p: *const f64) -> Self;
    /// # Safety
    /// `p` is valid for writing `WIDTH` numbers.
    unsafe fn store(self, p: *mut f64);
    /// Store past the caches, where the machine can.
    ///
    /// # Safety
    /// As for [`Lane::store`], and `p` is aligned to the lane.
    #[inline(always)]
    unsafe fn stream(self, p: *mut f64) {
        unsafe { self.store(p) }
    }
    fn add(self, b: Self) -> Self;
    fn sub(self, b: Self) -> Self;
    fn mul(self, b: Self) -> Self;
    fn div(self, b: Self) -> Self;
    /// `self * b + c`
    fn fma(self, b: Self, c: Self) -> Self;
    /// `c - self * b`
    fn fnma(self, b: Self, c: Self) -> Self;
    /// `a > b ? x : y`, sample by sample.
    fn select_gt(a: Self, b: Self, x: Self, y: Self) -> Self;
    /// The bits, moved up by `BY`; zeros follow.
    fn shift_left<const BY: u32>(self) -> Self;
    /// The bits that differ.
    fn xor(self, b: Self) -> Self;
    /// `mask` below zero or -0 ? x : y, sample by sample.
    fn select_sign(mask: Self, x: Self, y: Self) -> Self;
    /// The number with its sign flipped where that of `sign` is minus.
    fn xor_sign(self, sign: Self) -> Self;
    /// Sum over the samples of the lane.
    fn sum(self) -> f64;

    #[inline(always)]
    fn neg(self) -> Self {
        Self::splat(0.0).sub(self)
    }

    #[inline(always)]
    fn exp(self) -> Self {
        elementary::exp(self)
    }
    #[inline(always)]
    fn tanh(self) -> Self {
        elementary::tanh(self)
    }
    /// A power of a number that is not negative; those other than 1 and 2 by the library, sample by sample.
    #[inline(always)]
    fn power(self, exponent: f64) -> Self {
        match exponent {
            1.0 => self,
            2.0 => self.mul(self),
            _ => self.map(|x| x.powf(exponent)),
        }
    }

    /// A scalar function, sample by sample.
    #[inline(always)]
    fn map(self, f: impl Fn(f64) -> f64) -> Self {
        let mut x = [0.0; MAX_WIDTH];
        // SAFETY: the array has room for the widest lane.
        unsafe {
            self.store(x.as_mut_ptr());
            for x in &mut x[..Self::WIDTH] {
                *x = f(*x);
            }
            Self::load(x.as_ptr())
        }
    }
}
