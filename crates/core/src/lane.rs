//! Lanes: a few samples side by side, so that one instruction works on all of them.
//!
//! The trait is thin on purpose: the kernels are written once, and compiled once per back end (see `dispatch`).

/// Widest lane of any back end; buffers leave this much room after their last sample.
pub const MAX_WIDTH: usize = 8;

/// The sign bit.
const SIGN: u64 = 1 << 63;

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
    /// `self * b + c`
    fn fma(self, b: Self, c: Self) -> Self;
    /// `c - self * b`
    fn fnma(self, b: Self, c: Self) -> Self;
    /// `a > b ? x : y`, sample by sample.
    fn select_gt(a: Self, b: Self, x: Self, y: Self) -> Self;
    /// The bits, moved up by `BY`; zeros follow.
    fn raise<const BY: u32>(self) -> Self;
    /// The bits that differ.
    fn xor(self, b: Self) -> Self;
    /// `mask` below zero or -0 ? x : y, sample by sample.
    fn select_sign(mask: Self, x: Self, y: Self) -> Self;
    /// The number with its sign flipped where that of `sign` is minus.
    fn flip(self, sign: Self) -> Self;
    /// Sum over the samples of the lane.
    fn sum(self) -> f64;

    #[inline(always)]
    fn neg(self) -> Self {
        Self::splat(0.0).sub(self)
    }

    /// A scalar function, sample by sample: for the few columns that need `exp` or `tanh`.
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

/// Eight samples as a plain array: safe everywhere, and what the compiler turns into NEON on aarch64.
/// `FUSED` says whether the target has a fused multiply-add; without one, `mul_add` would be a library call.
#[derive(Clone, Copy)]
#[repr(C, align(64))]
pub struct Plain<const FUSED: bool>([f64; 8]);

impl<const FUSED: bool> Plain<FUSED> {
    #[inline(always)]
    fn with(mut self, b: Self, f: impl Fn(f64, f64) -> f64) -> Self {
        for (x, y) in self.0.iter_mut().zip(b.0) {
            *x = f(*x, y);
        }
        self
    }
}

impl<const FUSED: bool> Lane for Plain<FUSED> {
    const WIDTH: usize = 8;
    const PANEL: usize = 2;

    #[inline(always)]
    fn splat(x: f64) -> Self {
        Plain([x; 8])
    }
    #[inline(always)]
    unsafe fn load(p: *const f64) -> Self {
        // SAFETY: the caller's promise; the array type asks only for the alignment of f64.
        Plain(unsafe { *p.cast::<[f64; 8]>() })
    }
    #[inline(always)]
    unsafe fn store(self, p: *mut f64) {
        // SAFETY: the caller's promise.
        unsafe { *p.cast::<[f64; 8]>() = self.0 }
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
    fn fma(self, b: Self, c: Self) -> Self {
        let mut out = c;
        for k in 0..8 {
            out.0[k] = if FUSED { self.0[k].mul_add(b.0[k], c.0[k]) } else { self.0[k] * b.0[k] + c.0[k] };
        }
        out
    }
    #[inline(always)]
    fn fnma(self, b: Self, c: Self) -> Self {
        let mut out = c;
        for k in 0..8 {
            out.0[k] = if FUSED { (-self.0[k]).mul_add(b.0[k], c.0[k]) } else { c.0[k] - self.0[k] * b.0[k] };
        }
        out
    }
    #[inline(always)]
    fn select_gt(a: Self, b: Self, x: Self, mut y: Self) -> Self {
        for k in 0..8 {
            y.0[k] = if a.0[k] > b.0[k] { x.0[k] } else { y.0[k] };
        }
        y
    }
    #[inline(always)]
    fn raise<const BY: u32>(self) -> Self {
        Plain(self.0.map(|x| f64::from_bits(x.to_bits() << BY)))
    }
    #[inline(always)]
    fn xor(self, b: Self) -> Self {
        self.with(b, |x, y| f64::from_bits(x.to_bits() ^ y.to_bits()))
    }
    #[inline(always)]
    fn select_sign(mask: Self, x: Self, mut y: Self) -> Self {
        for k in 0..8 {
            y.0[k] = if mask.0[k].is_sign_negative() { x.0[k] } else { y.0[k] };
        }
        y
    }
    #[inline(always)]
    fn flip(self, sign: Self) -> Self {
        self.with(sign, |x, sign| f64::from_bits(x.to_bits() ^ (sign.to_bits() & SIGN)))
    }
    #[inline(always)]
    fn sum(self) -> f64 {
        let x = self.0;
        ((x[0] + x[4]) + (x[1] + x[5])) + ((x[2] + x[6]) + (x[3] + x[7]))
    }
}

#[cfg(target_arch = "x86_64")]
pub mod x86 {
    //! Thin back ends over the processor's own vectors. Only functions compiled with the matching
    //! `target_feature` use them (see `dispatch`), which is what makes the intrinsics safe to call.
    use super::Lane;
    use core::arch::x86_64::*;

    #[derive(Clone, Copy)]
    pub struct Avx2(__m256d);
    #[derive(Clone, Copy)]
    pub struct Avx512(__m512d);

    macro_rules! intrinsic {
        ($name:ident, $width:literal, $panel:literal, $splat:ident, $load:ident, $store:ident, $stream:ident, $add:ident, $sub:ident, $mul:ident,
         $fma:ident, $fnma:ident, $select:expr, $raise:expr, $xor:ident, $select_sign:expr, $flip:expr, $sum:expr) => {
            impl Lane for $name {
                const WIDTH: usize = $width;
                const PANEL: usize = $panel;
                #[inline(always)]
                fn splat(x: f64) -> Self {
                    unsafe { $name($splat(x)) }
                }
                #[inline(always)]
                unsafe fn load(p: *const f64) -> Self {
                    unsafe { $name($load(p)) }
                }
                #[inline(always)]
                unsafe fn store(self, p: *mut f64) {
                    unsafe { $store(p, self.0) }
                }
                #[inline(always)]
                unsafe fn stream(self, p: *mut f64) {
                    unsafe { $stream(p, self.0) }
                }
                #[inline(always)]
                fn add(self, b: Self) -> Self {
                    unsafe { $name($add(self.0, b.0)) }
                }
                #[inline(always)]
                fn sub(self, b: Self) -> Self {
                    unsafe { $name($sub(self.0, b.0)) }
                }
                #[inline(always)]
                fn mul(self, b: Self) -> Self {
                    unsafe { $name($mul(self.0, b.0)) }
                }
                #[inline(always)]
                fn fma(self, b: Self, c: Self) -> Self {
                    unsafe { $name($fma(self.0, b.0, c.0)) }
                }
                #[inline(always)]
                fn fnma(self, b: Self, c: Self) -> Self {
                    unsafe { $name($fnma(self.0, b.0, c.0)) }
                }
                #[inline(always)]
                fn select_gt(a: Self, b: Self, x: Self, y: Self) -> Self {
                    unsafe { $name($select(a.0, b.0, x.0, y.0)) }
                }
                #[inline(always)]
                fn raise<const BY: u32>(self) -> Self {
                    unsafe { $name($raise(self.0, BY)) }
                }
                #[inline(always)]
                fn xor(self, b: Self) -> Self {
                    unsafe { $name($xor(self.0, b.0)) }
                }
                #[inline(always)]
                fn select_sign(mask: Self, x: Self, y: Self) -> Self {
                    unsafe { $name($select_sign(mask.0, x.0, y.0)) }
                }
                #[inline(always)]
                fn flip(self, sign: Self) -> Self {
                    unsafe { $name($flip(self.0, sign.0)) }
                }
                #[inline(always)]
                fn sum(self) -> f64 {
                    unsafe { $sum(self.0) }
                }
            }
        };
    }

    intrinsic!(
        Avx2,
        4,
        3,
        _mm256_set1_pd,
        _mm256_loadu_pd,
        _mm256_storeu_pd,
        _mm256_stream_pd,
        _mm256_add_pd,
        _mm256_sub_pd,
        _mm256_mul_pd,
        _mm256_fmadd_pd,
        _mm256_fnmadd_pd,
        |a, b, x, y| _mm256_blendv_pd(y, x, _mm256_cmp_pd::<_CMP_GT_OQ>(a, b)),
        |x, by| _mm256_castsi256_pd(_mm256_sll_epi64(_mm256_castpd_si256(x), _mm_cvtsi32_si128(by as i32))),
        _mm256_xor_pd,
        |mask, x, y| _mm256_blendv_pd(y, x, mask),
        |x, sign| _mm256_xor_pd(x, _mm256_and_pd(sign, _mm256_set1_pd(-0.0))),
        |v| {
            let half = _mm_add_pd(_mm256_castpd256_pd128(v), _mm256_extractf128_pd::<1>(v));
            _mm_cvtsd_f64(_mm_add_sd(half, _mm_unpackhi_pd(half, half)))
        }
    );
    intrinsic!(
        Avx512,
        8,
        4,
        _mm512_set1_pd,
        _mm512_loadu_pd,
        _mm512_storeu_pd,
        _mm512_stream_pd,
        _mm512_add_pd,
        _mm512_sub_pd,
        _mm512_mul_pd,
        _mm512_fmadd_pd,
        _mm512_fnmadd_pd,
        |a, b, x, y| _mm512_mask_blend_pd(_mm512_cmp_pd_mask::<_CMP_GT_OQ>(a, b), y, x),
        |x, by| _mm512_castsi512_pd(_mm512_sll_epi64(_mm512_castpd_si512(x), _mm_cvtsi32_si128(by as i32))),
        _mm512_xor_pd,
        |mask, x, y| _mm512_mask_blend_pd(_mm512_movepi64_mask(_mm512_castpd_si512(mask)), y, x),
        |x, sign| _mm512_xor_pd(x, _mm512_and_pd(sign, _mm512_set1_pd(-0.0))),
        |v| _mm512_reduce_add_pd(v)
    );
}

/// Added to a number, it leaves the nearest whole number in the lowest bits (for |x| below 2^50).
const WHOLE: f64 = 6_755_399_441_055_744.0;

/// Sine and cosine of a lane, for |x| below about 1e5: Cody-Waite reduction in three parts and the fdlibm
/// minimax polynomials; the error is below 2 ulp of 1.
#[inline(always)]
pub fn sin_cos<T: Lane>(x: T) -> (T, T) {
    let s = T::splat;
    let quarters = x.fma(s(core::f64::consts::FRAC_2_PI), s(WHOLE));
    let k = quarters.sub(s(WHOLE));
    let r = k.fnma(s(1.570_796_326_734_125_6), x);
    let r = k.fnma(s(6.077_100_506_303_966e-11), r);
    let r = k.fnma(s(2.022_266_248_795_950_6e-21), r);
    let z = r.mul(r);
    let sine = z
        .fma(s(1.589_690_995_211_55e-10), s(-2.505_076_025_340_686_3e-8))
        .fma(z, s(2.755_731_370_707_006_8e-6))
        .fma(z, s(-1.984_126_982_985_795e-4))
        .fma(z, s(8.333_333_333_322_49e-3))
        .fma(z, s(-1.666_666_666_666_663_2e-1))
        .mul(z)
        .fma(r, r);
    let cosine = z
        .fma(s(-1.135_964_755_778_819_5e-11), s(2.087_572_321_298_175e-9))
        .fma(z, s(-2.755_731_435_139_066_3e-7))
        .fma(z, s(2.480_158_728_947_673e-5))
        .fma(z, s(-1.388_888_888_887_411e-3))
        .fma(z, s(4.166_666_666_666_66e-2))
        .mul(z.mul(z))
        .add(z.fnma(s(0.5), s(1.0)));
    // The lowest bit of k, as a sign: sine and cosine change places; the next one: the sine is negative.
    let (odd, half) = (quarters.raise::<63>(), quarters.raise::<62>());
    (T::select_sign(odd, cosine, sine).flip(half), T::select_sign(odd, sine, cosine).flip(half.xor(odd)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dispatch::{Backend, dispatched};

    dispatched! {
        unsafe fn evaluate = evaluate_in_lanes(x: &[f64], sine: &mut [f64], cosine: &mut [f64])
    }

    #[inline(always)]
    unsafe fn evaluate_in_lanes<T: Lane>(x: &[f64], sine: &mut [f64], cosine: &mut [f64]) {
        for k in (0..x.len()).step_by(T::WIDTH) {
            // SAFETY: the test's arrays are whole lanes long.
            unsafe {
                let (s, c) = sin_cos(T::load(x.as_ptr().add(k)));
                s.store(sine.as_mut_ptr().add(k));
                c.store(cosine.as_mut_ptr().add(k));
            }
        }
    }

    #[test]
    fn sine_and_cosine_are_the_libraries_within_two_units_in_the_last_place_of_one() {
        let fine = (-40_000..40_000).map(|k| f64::from(k) * 1e-3);
        let quarters = (-2_000..2_000).map(|k| f64::from(k) * std::f64::consts::FRAC_PI_2);
        let wide = (-2_000..2_000).map(|k| f64::from(k) * 49.37);
        let x: Vec<f64> = fine.chain(quarters).chain(wide).collect();
        assert_eq!(x.len() % MAX_WIDTH, 0);
        for backend in Backend::available() {
            let (mut sine, mut cosine) = (vec![0.0; x.len()], vec![0.0; x.len()]);
            // SAFETY: all three are equally long, and whole lanes.
            unsafe { evaluate(backend, &x, &mut sine, &mut cosine) };
            for (k, &x) in x.iter().enumerate() {
                let worst = (sine[k] - x.sin()).abs().max((cosine[k] - x.cos()).abs());
                assert!(worst <= 2.0 * f64::EPSILON, "{backend:?} at {x}: {worst:e}");
            }
        }
    }
}
