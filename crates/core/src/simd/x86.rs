//! Back ends over the vector registers of x86-64. A lane is made with its token or of other lanes only, see
//! [`crate::simd::token`]: where one exists the processor has its instructions, which makes the intrinsics safe to call.

use crate::simd::lane::Lane;
use crate::simd::token::Simd;
use core::arch::x86_64::*;

#[derive(Clone, Copy)]
pub(crate) struct Avx2(__m256d);
#[derive(Clone, Copy)]
pub(crate) struct Avx512(__m512d);

macro_rules! intrinsic {
    ($name:ident, $width:literal, $panel:literal, $splat:ident, $load:ident, $store:ident, $stream:ident, $add:ident, $sub:ident, $mul:ident,
     $div:ident, $sqrt:ident, $inverse_sqrt:ident, $fma:ident, $fnma:ident, $select:expr, $any_gt:expr, $shift_left:expr, $xor:ident, $select_sign:expr, $xor_sign:expr, $sum:expr, $four:expr) => {
        impl Lane for $name {
            const WIDTH: usize = $width;
            const PANEL: usize = $panel;
            #[inline(always)]
            fn splat(_: Simd<Self>, x: f64) -> Self {
                // SAFETY: the token proves AVX2 and FMA, or AVX-512F and DQ; below a lane does (see the head of the
                // file).
                unsafe { $name($splat(x)) }
            }
            #[inline(always)]
            unsafe fn load(_: Simd<Self>, p: *const f64) -> Self {
                // SAFETY: the token proves the instructions; the caller promises that `p` is readable.
                unsafe { $name($load(p)) }
            }
            #[inline(always)]
            unsafe fn store(self, p: *mut f64) {
                // SAFETY: the lane proves the instructions; the caller promises that `p` is writable.
                unsafe { $store(p, self.0) }
            }
            #[inline(always)]
            unsafe fn stream(self, p: *mut f64) {
                // SAFETY: as for `store`, and the caller promises the alignment.
                unsafe { $stream(p, self.0) }
            }
            #[inline(always)]
            fn add(self, b: Self) -> Self {
                // SAFETY: the lane proves the instructions.
                unsafe { $name($add(self.0, b.0)) }
            }
            #[inline(always)]
            fn sub(self, b: Self) -> Self {
                // SAFETY: the lane proves the instructions.
                unsafe { $name($sub(self.0, b.0)) }
            }
            #[inline(always)]
            fn mul(self, b: Self) -> Self {
                // SAFETY: the lane proves the instructions.
                unsafe { $name($mul(self.0, b.0)) }
            }
            #[inline(always)]
            fn div(self, b: Self) -> Self {
                // SAFETY: the lane proves the instructions.
                unsafe { $name($div(self.0, b.0)) }
            }
            #[inline(always)]
            fn sqrt(self) -> Self {
                // SAFETY: the lane proves the instructions.
                unsafe { $name($sqrt(self.0)) }
            }
            #[inline(always)]
            fn inverse_sqrt(self) -> Self {
                // SAFETY: the lane proves the instructions.
                unsafe { $name($inverse_sqrt(self.0)) }
            }
            #[inline(always)]
            fn fma(self, b: Self, c: Self) -> Self {
                // SAFETY: the lane proves the instructions.
                unsafe { $name($fma(self.0, b.0, c.0)) }
            }
            #[inline(always)]
            fn fnma(self, b: Self, c: Self) -> Self {
                // SAFETY: the lane proves the instructions.
                unsafe { $name($fnma(self.0, b.0, c.0)) }
            }
            #[inline(always)]
            fn select_gt(a: Self, b: Self, x: Self, y: Self) -> Self {
                // SAFETY: the lane proves the instructions.
                unsafe { $name($select(a.0, b.0, x.0, y.0)) }
            }
            #[inline(always)]
            fn any_gt(a: Self, b: Self) -> bool {
                // SAFETY: the lane proves the instructions.
                unsafe { $any_gt(a.0, b.0) }
            }
            #[inline(always)]
            fn shift_left<const BY: u32>(self) -> Self {
                // SAFETY: the lane proves the instructions.
                unsafe { $name($shift_left(self.0, BY)) }
            }
            #[inline(always)]
            fn xor(self, b: Self) -> Self {
                // SAFETY: the lane proves the instructions.
                unsafe { $name($xor(self.0, b.0)) }
            }
            #[inline(always)]
            fn select_sign(mask: Self, x: Self, y: Self) -> Self {
                // SAFETY: the lane proves the instructions.
                unsafe { $name($select_sign(mask.0, x.0, y.0)) }
            }
            #[inline(always)]
            fn xor_sign(self, sign: Self) -> Self {
                // SAFETY: the lane proves the instructions.
                unsafe { $name($xor_sign(self.0, sign.0)) }
            }
            #[inline(always)]
            fn sum(self) -> f64 {
                // SAFETY: the lane proves the instructions.
                unsafe { $sum(self.0) }
            }
            #[inline(always)]
            fn sums<const N: usize>(lanes: [Self; N]) -> [f64; N] {
                let mut made = [0.0; N];
                for (made, lanes) in made.chunks_mut(4).zip(lanes.chunks(4)) {
                    if let &[a, b, c, d] = lanes {
                        // SAFETY: the lanes prove the instructions; four sums have room for four numbers.
                        unsafe { _mm256_storeu_pd(made.as_mut_ptr(), $four(a.0, b.0, c.0, d.0)) };
                    } else {
                        made.iter_mut().zip(lanes).for_each(|(made, lane)| *made = lane.sum());
                    }
                }
                made
            }
        }
    };
}

/// Sums of two lanes of alternating numbers: those of the first, then those of the second.
#[inline(always)]
unsafe fn across(ab: __m256d, cd: __m256d) -> __m256d {
    // SAFETY: the caller has lanes, which prove AVX2.
    unsafe { _mm256_add_pd(_mm256_permute2f128_pd::<0x20>(ab, cd), _mm256_permute2f128_pd::<0x31>(ab, cd)) }
}

/// Sums of the numbers four apart of two wide lanes, of which each has every second number.
#[inline(always)]
unsafe fn halved(a: __m512d, b: __m512d) -> __m256d {
    // SAFETY: the caller has wide lanes, which prove AVX-512F.
    unsafe {
        let pairs = _mm512_add_pd(_mm512_unpacklo_pd(a, b), _mm512_unpackhi_pd(a, b));
        _mm256_add_pd(_mm512_castpd512_pd256(pairs), _mm512_extractf64x4_pd::<1>(pairs))
    }
}

/// One by the square root.
#[inline(always)]
unsafe fn inverse_sqrt(x: __m256d) -> __m256d {
    // SAFETY: the caller has lanes, which prove AVX2.
    unsafe { _mm256_div_pd(_mm256_set1_pd(1.0), _mm256_sqrt_pd(x)) }
}

/// One by the square root, from 14 bits by two steps of Newton's method, which double them.
#[inline(always)]
unsafe fn wide_inverse_sqrt(x: __m512d) -> __m512d {
    // SAFETY: the caller has wide lanes, which prove AVX-512F.
    unsafe {
        let (half, most) = (_mm512_mul_pd(x, _mm512_set1_pd(0.5)), _mm512_set1_pd(1.5));
        let mut y = _mm512_rsqrt14_pd(x);
        for _ in 0..2 {
            y = _mm512_mul_pd(y, _mm512_fnmadd_pd(half, _mm512_mul_pd(y, y), most));
        }
        y
    }
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
    _mm256_div_pd,
    _mm256_sqrt_pd,
    inverse_sqrt,
    _mm256_fmadd_pd,
    _mm256_fnmadd_pd,
    |a, b, x, y| _mm256_blendv_pd(y, x, _mm256_cmp_pd::<_CMP_GT_OQ>(a, b)),
    |a, b| _mm256_movemask_pd(_mm256_cmp_pd::<_CMP_GT_OQ>(a, b)) != 0,
    |x, by| _mm256_castsi256_pd(_mm256_sll_epi64(_mm256_castpd_si256(x), _mm_cvtsi32_si128(by as i32))),
    _mm256_xor_pd,
    |mask, x, y| _mm256_blendv_pd(y, x, mask),
    |x, sign| _mm256_xor_pd(x, _mm256_and_pd(sign, _mm256_set1_pd(-0.0))),
    |v| {
        let half = _mm_add_pd(_mm256_castpd256_pd128(v), _mm256_extractf128_pd::<1>(v));
        _mm_cvtsd_f64(_mm_add_sd(half, _mm_unpackhi_pd(half, half)))
    },
    |a, b, c, d| across(_mm256_hadd_pd(a, b), _mm256_hadd_pd(c, d))
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
    _mm512_div_pd,
    _mm512_sqrt_pd,
    wide_inverse_sqrt,
    _mm512_fmadd_pd,
    _mm512_fnmadd_pd,
    |a, b, x, y| _mm512_mask_blend_pd(_mm512_cmp_pd_mask::<_CMP_GT_OQ>(a, b), y, x),
    |a, b| _mm512_cmp_pd_mask::<_CMP_GT_OQ>(a, b) != 0,
    |x, by| _mm512_castsi512_pd(_mm512_sll_epi64(_mm512_castpd_si512(x), _mm_cvtsi32_si128(by as i32))),
    _mm512_xor_pd,
    |mask, x, y| _mm512_mask_blend_pd(_mm512_movepi64_mask(_mm512_castpd_si512(mask)), y, x),
    |x, sign| _mm512_xor_pd(x, _mm512_and_pd(sign, _mm512_set1_pd(-0.0))),
    |v| _mm512_reduce_add_pd(v),
    |a, b, c, d| across(halved(a, b), halved(c, d))
);
