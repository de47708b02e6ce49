//! Lanes: a few samples in one SIMD register.
//!
//! The trait is minimal: kernels are written once over it, and compiled once per back end (see
//! [`crate::simd::dispatch`]).

use crate::simd::elementary;
use crate::simd::token::Simd;

/// Width of the widest lane. Buffers have room for this many numbers after their last sample.
pub(crate) const MAX_WIDTH: usize = 8;

/// A few samples of one quantity. Every method is `inline(always)`: it must be inlined into a function that is compiled
/// with the back end's instructions. A lane is made with a token only, so that it proves the instructions itself.
pub(crate) trait Lane: Copy {
    const WIDTH: usize;
    /// Columns of a QR panel: as many as keep their inner products in registers.
    const PANEL: usize;
    /// The same number in every sample.
    fn splat(simd: Simd<Self>, x: f64) -> Self;
    /// Load a lane.
    ///
    /// # Safety
    ///
    /// `p` is valid for reading `WIDTH` numbers.
    unsafe fn load(simd: Simd<Self>, p: *const f64) -> Self;
    /// Store a lane.
    ///
    /// # Safety
    ///
    /// `p` is valid for writing `WIDTH` numbers.
    unsafe fn store(self, p: *mut f64);
    /// Store past the caches, where the processor can.
    ///
    /// # Safety
    ///
    /// As for [`Lane::store`], and `p` is aligned to the size of the lane.
    #[inline(always)]
    unsafe fn stream(self, p: *mut f64) {
        // SAFETY: the caller's promise includes that of `store`.
        unsafe { self.store(p) }
    }
    fn add(self, b: Self) -> Self;
    fn sub(self, b: Self) -> Self;
    fn mul(self, b: Self) -> Self;
    fn div(self, b: Self) -> Self;
    fn sqrt(self) -> Self;
    /// One by the square root of a normal number, to 4 ulp: without a division where the processor can. Of zero it is
    /// infinite or no number.
    #[inline(always)]
    fn inverse_sqrt(self) -> Self {
        Simd::of(self).splat(1.0).div(self.sqrt())
    }
    /// `self * b + c`
    fn fma(self, b: Self, c: Self) -> Self;
    /// `c - self * b`
    fn fnma(self, b: Self, c: Self) -> Self;
    /// `a > b ? x : y`, per sample.
    fn select_gt(a: Self, b: Self, x: Self, y: Self) -> Self;
    /// Whether `a > b` for any sample.
    fn any_gt(a: Self, b: Self) -> bool;
    /// The bit patterns shifted to the left by `BY`.
    fn shift_left<const BY: u32>(self) -> Self;
    /// Exclusive or of the bit patterns.
    fn xor(self, b: Self) -> Self;
    /// `sign bit of mask ? x : y`, per sample.
    fn select_sign(mask: Self, x: Self, y: Self) -> Self;
    /// The number with its sign flipped where `sign` is negative; `x.xor_sign(x)` is |x|.
    fn xor_sign(self, sign: Self) -> Self;
    /// Sum over the samples of the lane.
    fn sum(self) -> f64;
    /// The sums of several lanes, which together take less than one after the other.
    #[inline(always)]
    fn sums<const N: usize>(lanes: [Self; N]) -> [f64; N] {
        lanes.map(Self::sum)
    }

    #[inline(always)]
    fn neg(self) -> Self {
        Simd::of(self).splat(0.0).sub(self)
    }

    #[inline(always)]
    fn exp(self) -> Self {
        elementary::exp(self)
    }
    #[inline(always)]
    fn tanh(self) -> Self {
        elementary::tanh(self)
    }
    /// Power of a number that is not negative. Exponents other than 1 and 2 take the standard library, sample by
    /// sample.
    #[inline(always)]
    fn power(self, exponent: f64) -> Self {
        match exponent {
            1.0 => self,
            2.0 => self.mul(self),
            _ => self.map(|x| x.powf(exponent)),
        }
    }

    /// A scalar function of each sample.
    #[inline(always)]
    fn map(self, f: impl Fn(f64) -> f64) -> Self {
        let mut x = [0.0; MAX_WIDTH];
        // SAFETY: the array has room for the widest lane.
        unsafe {
            self.store(x.as_mut_ptr());
            for x in &mut x[..Self::WIDTH] {
                *x = f(*x);
            }
            Self::load(Simd::of(self), x.as_ptr())
        }
    }
}
