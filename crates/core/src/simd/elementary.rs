//! exp, tanh, sine and cosine of lanes.

use crate::simd::lane::Lane;
use crate::simd::token::Simd;

/// exp overflows above the first bound and vanishes below the second.
const HIGHEST: f64 = 710.0;
const LOWEST: f64 = -746.0;
/// ln 2 in two parts; the first times a whole number below 2^20 is exact.
const LN2: [f64; 2] = [6.931_471_803_691_238e-1, 1.908_214_929_270_587_7e-10];
/// Added to a whole number k, this leaves the exponent field of 2^k in the lowest bits.
const EXPONENT: f64 = WHOLE + 1023.0;

/// exp of a lane: 2^k exp(r), |r| < ln(2)/2, by a Taylor polynomial of degree 13. The error is below 2 ulp, for
/// subnormal results too: 2^k is applied in two factors, so that neither is out of range.
#[inline(always)]
pub(crate) fn exp<T: Lane>(x: T) -> T {
    let s = |c| Simd::of(x).splat(c);
    let x = T::select_gt(x, s(HIGHEST), s(HIGHEST), x);
    let x = T::select_gt(s(LOWEST), x, s(LOWEST), x);
    let k = x.fma(s(core::f64::consts::LOG2_E), s(WHOLE)).sub(s(WHOLE));
    let r = k.fnma(s(LN2[1]), k.fnma(s(LN2[0]), x));
    let tail = s(1.605_904_383_682_161_3e-10)
        .fma(r, s(2.087_675_698_786_81e-9))
        .fma(r, s(2.505_210_838_544_172e-8))
        .fma(r, s(2.755_731_922_398_589_3e-7))
        .fma(r, s(2.755_731_922_398_589e-6))
        .fma(r, s(2.480_158_730_158_73e-5))
        .fma(r, s(1.984_126_984_126_984e-4))
        .fma(r, s(1.388_888_888_888_889e-3))
        .fma(r, s(8.333_333_333_333_333e-3))
        .fma(r, s(4.166_666_666_666_666_4e-2))
        .fma(r, s(1.666_666_666_666_666_6e-1))
        .fma(r, s(0.5));
    let power = tail.fma(r.mul(r), r).add(s(1.0));
    let half = k.fma(s(0.5), s(EXPONENT));
    let rest = k.sub(half.sub(s(EXPONENT))).add(s(EXPONENT));
    power.mul(half.shift_left::<52>()).mul(rest.shift_left::<52>())
}

/// Boundary between the two forms of tanh.
const TANH_BOUNDARY: f64 = 0.625;

/// tanh of a lane, to 2 ulp: below [`TANH_BOUNDARY`] the rational function of the Cephes library (Moshier 1989), above
/// it 1 - 2 / (exp(2x) + 1).
#[inline(always)]
pub(crate) fn tanh<T: Lane>(x: T) -> T {
    let (s, a) = (|c| Simd::of(x).splat(c), x.xor_sign(x));
    let z = a.mul(a);
    let above = z
        .fma(s(-9.643_991_794_250_523e-1), s(-9.928_772_310_019_186e1))
        .fma(z, s(-1.614_687_684_417_084_5e3))
        .mul(z)
        .mul(a);
    let below =
        z.add(s(1.128_116_784_916_329_3e2)).fma(z, s(2.235_488_390_601_004_5e3)).fma(z, s(4.844_063_053_251_255e3));
    let far = |yes, no| T::select_gt(a, s(TANH_BOUNDARY), yes, no);
    let share = far(s(-2.0), above).div(far(a.add(a).exp().add(s(1.0)), below));
    far(s(1.0), a).add(share).xor_sign(x)
}

/// Added to a number, this leaves the nearest whole number in the lowest bits (for |x| < 2^50).
pub(crate) const WHOLE: f64 = 6_755_399_441_055_744.0;

/// Sine and cosine of a lane, for |x| below about 1e5: Cody-Waite reduction in three parts and the fdlibm minimax
/// polynomials; the error is below 2 ulp of 1.
#[inline(always)]
pub(crate) fn sin_cos<T: Lane>(x: T) -> (T, T) {
    let s = |c| Simd::of(x).splat(c);
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
    // The lowest bit of k, moved to the sign: sine and cosine are exchanged; the next bit: the sine is negative.
    let (odd, half) = (quarters.shift_left::<63>(), quarters.shift_left::<62>());
    (T::select_sign(odd, cosine, sine).xor_sign(half), T::select_sign(odd, sine, cosine).xor_sign(half.xor(odd)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simd::dispatch::{Backend, dispatched};
    use crate::simd::lane::MAX_WIDTH;

    dispatched! {
        unsafe fn evaluate = evaluate_in_lanes(x: &[f64], out: &mut [Vec<f64>; 4])
    }

    #[inline(always)]
    unsafe fn evaluate_in_lanes<T: Lane>(simd: Simd<T>, x: &[f64], [e, t, s, c]: &mut [Vec<f64>; 4]) {
        for k in (0..x.len()).step_by(T::WIDTH) {
            // SAFETY: all arrays have the same length, a multiple of the widest lane.
            unsafe {
                let x = simd.load(x.as_ptr().add(k));
                x.exp().store(e.as_mut_ptr().add(k));
                x.tanh().store(t.as_mut_ptr().add(k));
                let (sine, cosine) = sin_cos(x);
                sine.store(s.as_mut_ptr().add(k));
                cosine.store(c.as_mut_ptr().add(k));
            }
        }
    }

    /// exp, tanh, sine and cosine on every back end.
    fn evaluated(x: &[f64]) -> impl Iterator<Item = (Backend, [Vec<f64>; 4])> {
        assert_eq!(x.len() % MAX_WIDTH, 0);
        Backend::available().into_iter().map(move |backend| {
            let mut out = core::array::from_fn(|_| vec![0.0; x.len()]);
            // SAFETY: all arrays have the same length, a multiple of the widest lane.
            unsafe { evaluate(backend, x, &mut out) };
            (backend, out)
        })
    }

    /// Error in units in the last place of the expected value.
    fn apart(got: f64, wanted: f64) -> f64 {
        if got == wanted {
            return 0.0;
        }
        (got - wanted).abs() / (wanted.abs().next_up() - wanted.abs())
    }

    #[test]
    fn exp_and_tanh_agree_with_the_standard_library_within_two_units_in_the_last_place() {
        let fine = (-40_000..40_000).map(|k| f64::from(k) * 1e-4);
        let wide = (-7_600..7_200).map(|k| f64::from(k) * 0.1);
        let small = (0..400).flat_map(|k| [1.0, -1.0].map(|sign| sign * 0.8_f64.powi(k)));
        let x: Vec<f64> = fine.chain(wide).chain(small).collect();
        for (backend, [e, t, ..]) in evaluated(&x) {
            for (k, &x) in x.iter().enumerate() {
                let (of_e, of_t) = (apart(e[k], x.exp()), apart(t[k], x.tanh()));
                assert!(of_e <= 2.0, "{backend:?}: exp({x}) is {:e}, {of_e} ulp away", e[k]);
                assert!(of_t <= 2.0, "{backend:?}: tanh({x}) is {:e}, {of_t} ulp away", t[k]);
            }
        }
    }

    #[test]
    fn exp_and_tanh_have_the_right_limits() {
        let huge = f64::MAX;
        let x = [0.0, -0.0, huge, -huge, f64::INFINITY, f64::NEG_INFINITY, f64::NAN, -710.0];
        for (backend, [e, t, ..]) in evaluated(&x) {
            assert_eq!(e[..6], [1.0, 1.0, f64::INFINITY, 0.0, f64::INFINITY, 0.0], "{backend:?}");
            assert!(e[6].is_nan() && t[6].is_nan(), "{backend:?}");
            assert!(e[7] > 0.0 && !e[7].is_normal(), "{backend:?}: {:e}", e[7]);
            assert_eq!(t[..6], [0.0, -0.0, 1.0, -1.0, 1.0, -1.0], "{backend:?}");
            assert!(t[1].is_sign_negative() && t[0].is_sign_positive(), "{backend:?}");
        }
    }

    #[test]
    fn sine_and_cosine_agree_with_the_standard_library_within_two_units_in_the_last_place_of_one() {
        let fine = (-40_000..40_000).map(|k| f64::from(k) * 1e-3);
        let quarters = (-2_000..2_000).map(|k| f64::from(k) * std::f64::consts::FRAC_PI_2);
        let wide = (-2_000..2_000).map(|k| f64::from(k) * 49.37);
        let x: Vec<f64> = fine.chain(quarters).chain(wide).collect();
        for (backend, [_, _, sine, cosine]) in evaluated(&x) {
            for (k, &x) in x.iter().enumerate() {
                let worst = (sine[k] - x.sin()).abs().max((cosine[k] - x.cos()).abs());
                assert!(worst <= 2.0 * f64::EPSILON, "{backend:?} at {x}: {worst:e}");
            }
        }
    }
}
