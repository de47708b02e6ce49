//! The portable back end: plain arrays.

use crate::simd::lane::Lane;
use crate::simd::token::Simd;

/// Samples of a lane: as many registers as an aarch64 has to spare; one register of x86_64 without AVX2, which has few, and
/// for which wider arrays take a quarter of the time of compiling the crate.
const SAMPLES: usize = if cfg!(target_arch = "aarch64") { 8 } else { 2 };

/// The sign bit of f64.
const SIGN: u64 = 1 << 63;

/// Some samples as a plain array, which the compiler vectorises, to NEON on aarch64. `FUSED`: the target has a fused
/// multiply-add instruction; without it `mul_add` would be a library call.
#[derive(Clone, Copy)]
#[cfg_attr(target_arch = "aarch64", repr(align(64)))]
#[cfg_attr(not(target_arch = "aarch64"), repr(align(16)))]
pub(crate) struct Portable<const FUSED: bool>([f64; SAMPLES]);

impl<const FUSED: bool> Portable<FUSED> {
    #[inline(always)]
    fn with(mut self, b: Self, f: impl Fn(f64, f64) -> f64) -> Self {
        for (x, y) in self.0.iter_mut().zip(b.0) {
            *x = f(*x, y);
        }
        self
    }
}

impl<const FUSED: bool> Lane for Portable<FUSED> {
    const WIDTH: usize = SAMPLES;
    const PANEL: usize = 2;

    #[inline(always)]
    fn splat(_: Simd<Self>, x: f64) -> Self {
        Portable([x; SAMPLES])
    }
    #[inline(always)]
    unsafe fn load(_: Simd<Self>, p: *const f64) -> Self {
        // SAFETY: the caller's promise; `[f64; SAMPLES]` needs no more than the alignment of f64.
        Portable(unsafe { *p.cast::<[f64; SAMPLES]>() })
    }
    #[inline(always)]
    unsafe fn store(self, p: *mut f64) {
        // SAFETY: the caller's promise.
        unsafe { *p.cast::<[f64; SAMPLES]>() = self.0 }
    }
    #[inline(always)]
    fn add(self, b: Self) -> Self {
        self.with(b, |x, y| x + y)
    }
    #[inline(always)]
    fn sub(self, b: Self) -> Self {
        self.with(b, |x, y| x - y)
    }
    #[inline(always)]
    fn mul(self, b: Self) -> Self {
        self.with(b, |x, y| x * y)
    }
    #[inline(always)]
    fn div(self, b: Self) -> Self {
        self.with(b, |x, y| x / y)
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        Portable(self.0.map(f64::sqrt))
    }
    #[inline(always)]
    fn fma(self, b: Self, c: Self) -> Self {
        let mut out = c;
        for k in 0..SAMPLES {
            out.0[k] = if FUSED { self.0[k].mul_add(b.0[k], c.0[k]) } else { self.0[k] * b.0[k] + c.0[k] };
        }
        out
    }
    #[inline(always)]
    fn fnma(self, b: Self, c: Self) -> Self {
        let mut out = c;
        for k in 0..SAMPLES {
            out.0[k] = if FUSED { (-self.0[k]).mul_add(b.0[k], c.0[k]) } else { c.0[k] - self.0[k] * b.0[k] };
        }
        out
    }
    #[inline(always)]
    fn select_gt(a: Self, b: Self, x: Self, mut y: Self) -> Self {
        for k in 0..SAMPLES {
            y.0[k] = if a.0[k] > b.0[k] { x.0[k] } else { y.0[k] };
        }
        y
    }
    #[inline(always)]
    fn any_gt(a: Self, b: Self) -> bool {
        a.0.iter().zip(b.0).any(|(a, b)| *a > b)
    }
    #[inline(always)]
    fn shift_left<const BY: u32>(self) -> Self {
        Portable(self.0.map(|x| f64::from_bits(x.to_bits() << BY)))
    }
    #[inline(always)]
    fn xor(self, b: Self) -> Self {
        self.with(b, |x, y| f64::from_bits(x.to_bits() ^ y.to_bits()))
    }
    #[inline(always)]
    fn select_sign(mask: Self, x: Self, mut y: Self) -> Self {
        for k in 0..SAMPLES {
            y.0[k] = if mask.0[k].is_sign_negative() { x.0[k] } else { y.0[k] };
        }
        y
    }
    #[inline(always)]
    fn xor_sign(self, sign: Self) -> Self {
        self.with(sign, |x, sign| f64::from_bits(x.to_bits() ^ (sign.to_bits() & SIGN)))
    }
    #[inline(always)]
    fn sum(self) -> f64 {
        self.0.into_iter().sum()
    }
}
