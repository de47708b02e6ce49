//! Recursive filters along channels, forwards and backwards, so that nothing is delayed.
//!
//! A recursion waits for its own results: lanes are channels here, each with its own filter, not samples.

use crate::error::{Error, expect_length};
use crate::memory::aligned::Aligned;
use crate::simd::dispatch::{Backend, dispatched};
use crate::simd::inlined;
use crate::simd::lane::{Lane, MAX_WIDTH};
use crate::simd::token::Simd;

/// Numbers of a second-order section: `b0 b1 b2 1 a1 a2`, of `y[k] + a1 y[k-1] + a2 y[k-2] = b0 x[k] + b1 x[k-1] + b2
/// x[k-2]`.
const SECTION: usize = 6;

/// Each channel through its own second-order sections, forwards and backwards: `out`, channels x samples, like
/// `channels`. `sections` are channels x sections x 6.
///
/// Both ends are extended by `padding` samples of the signal turned about its end point, and either pass starts in the
/// steady state of its first sample (Gustafsson 1996, IEEE Trans. Signal Processing 44(4), for the alternatives). There
/// must be more samples than `padding`.
///
/// # Example
///
/// ```
/// use haptid_core::{Backend, filter_both_ways};
/// // y[k] = 0.5 y[k-1] + 0.5 x[k], whose gain of a constant is one.
/// let (low_pass, mut out) = ([0.5, 0., 0., 1., -0.5, 0.], [0.; 4]);
/// filter_both_ways(Backend::best(), &low_pass, &[3.; 4], 4, 2, &mut out)?;
/// assert_eq!(out, [3.; 4]);
/// # Ok::<(), haptid_core::Error>(())
/// ```
pub fn filter_both_ways(
    backend: Backend,
    sections: &[f64],
    channels: &[f64],
    samples: usize,
    padding: usize,
    out: &mut [f64],
) -> Result<(), Error> {
    if samples <= padding {
        return Err(Error::Length { name: "channels", got: samples, wanted: padding + 1 });
    }
    let many = channels.len() / samples;
    expect_length("channels", channels.len(), many * samples)?;
    expect_length("out", out.len(), channels.len())?;
    let own = sections.len() / many.max(1);
    expect_length("sections", sections.len(), many * (own / SECTION * SECTION))?;
    filter(backend, &Filters { sections, own, channels, samples, padding }, out);
    Ok(())
}

/// Channels with their filters.
struct Filters<'a> {
    sections: &'a [f64],
    /// Numbers of a channel's sections.
    own: usize,
    channels: &'a [f64],
    samples: usize,
    padding: usize,
}

dispatched! {
    fn filter = filter_in_lanes(filters: &Filters, out: &mut [f64])
}

#[inline(always)]
fn filter_in_lanes<T: Lane>(simd: Simd<T>, filters: &Filters, out: &mut [f64]) {
    let &Filters { sections, own, channels, samples, padding } = filters;
    let length = samples + 2 * padding;
    let mut wide = Aligned::default();
    wide.clear(length * T::WIDTH);
    for (group, out) in out.chunks_mut(T::WIDTH * samples).enumerate() {
        let first = group * T::WIDTH;
        let together = out.len() / samples;
        let mut coefficients = vec![[0.0; MAX_WIDTH]; own];
        for lane in 0..together {
            extend(
                &channels[(first + lane) * samples..][..samples],
                padding,
                wide[lane..].iter_mut().step_by(T::WIDTH),
            );
            let filter = &sections[(first + lane) * own..][..own];
            coefficients.iter_mut().zip(filter).for_each(|(to, &number)| to[lane] = number);
        }
        one_pass(simd, &coefficients, &mut wide[..length * T::WIDTH], |k| k);
        one_pass(simd, &coefficients, &mut wide[..length * T::WIDTH], |k| length - 1 - k);
        for (lane, out) in out.chunks_exact_mut(samples).enumerate() {
            let inner = wide[lane..].iter().step_by(T::WIDTH).skip(padding);
            out.iter_mut().zip(inner).for_each(|(to, &x)| *to = x);
        }
    }
}

/// A signal with both ends turned about their points.
#[inline(always)]
fn extend<'a>(signal: &[f64], padding: usize, mut to: impl Iterator<Item = &'a mut f64>) {
    let last = signal.len() - 1;
    let mut put = |x: f64| {
        if let Some(to) = to.next() {
            *to = x;
        }
    };
    (1..=padding).rev().for_each(|k| put(2.0 * signal[0] - signal[k]));
    signal.iter().for_each(|&x| put(x));
    (1..=padding).for_each(|k| put(2.0 * signal[last] - signal[last - k]));
}

/// All sections, one after another, in place, over lanes in the order that `at` gives.
#[inline(always)]
fn one_pass<T: Lane>(simd: Simd<T>, coefficients: &[[f64; MAX_WIDTH]], wide: &mut [f64], at: impl Fn(usize) -> usize) {
    let (length, numbers) = (wide.len() / T::WIDTH, wide.as_mut_ptr());
    let lane_at = |k: usize| {
        debug_assert!(k < length);
        // SAFETY: `at` permutes the lanes of `wide`.
        unsafe { numbers.add(at(k) * T::WIDTH) }
    };
    // SAFETY: the first lane of `wide`, which is not empty.
    let start = unsafe { simd.load(lane_at(0)) };
    let (mut before, mut constant) = (start, start);
    let zero = simd.splat(0.0);
    let count = coefficients.len() / SECTION;
    for (s, section) in coefficients.chunks_exact(SECTION).enumerate() {
        // SAFETY: every coefficient has room for the widest lane.
        let [b0, b1, b2, a0, a1, a2]: [T; SECTION] = inlined::from_fn(|e| unsafe { simd.load(section[e].as_ptr()) });
        constant = constant.mul(b0.add(b1).add(b2)).div(a0.add(a1).add(a2));
        let after = if s + 1 == count { constant } else { zero };
        let ([mut x1, mut x2], [mut y1, mut y2]) = ([zero; 2], [zero; 2]);
        for k in 0..length {
            let place = lane_at(k);
            // SAFETY: a lane of `wide`.
            let x = unsafe { simd.load(place) }.sub(before);
            let y = a1.fnma(y1, a2.fnma(y2, b2.fma(x2, b1.fma(x1, b0.mul(x)))));
            // SAFETY: as above.
            unsafe { y.add(after).store(place) };
            ([x1, x2], [y1, y2]) = ([x, x1], [y, y1]);
        }
        before = zero;
    }
}
