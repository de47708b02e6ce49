//! FIR filter with decimation, the same for torques and regressor columns.
//!
//! A finite impulse response has no state: a row needs only the samples in its window, so that blocks, threads and
//! machines compute their rows independently. Taps that are symmetric about the centre give no delay; taps whose later
//! half is zero are causal, about their last sample.

use crate::error::{Error, expect_length};
use crate::simd::dispatch::{Backend, dispatched};
use crate::simd::lane::{Lane, MAX_WIDTH};
use crate::simd::token::Simd;

/// Taps, padded with zeros to whole lanes, and taps that give the derivative of the filtered signal, if required.
#[derive(Debug, Clone)]
pub(crate) struct FirFilter {
    pub(crate) taps: Vec<f64>,
    pub(crate) derivative_taps: Vec<f64>,
    length: usize,
    pub(crate) decimation: usize,
}

impl FirFilter {
    pub(crate) fn new(taps: &[f64], derivative_taps: &[f64], decimation: usize) -> Result<FirFilter, Error> {
        if taps.len().is_multiple_of(2) {
            return Err(Error::Length { name: "taps (an odd number)", got: taps.len(), wanted: taps.len() + 1 });
        }
        expect_decimation(decimation)?;
        Ok(FirFilter { taps: padded(taps), derivative_taps: padded(derivative_taps), length: taps.len(), decimation })
    }

    /// Whether there is neither filter, decimation nor derivative.
    pub(crate) fn is_identity(&self) -> bool {
        self.decimation == 1 && self.length == 1 && self.taps[0] == 1.0 && self.derivative_taps.is_empty()
    }

    /// Samples on either side of the centre.
    pub(crate) fn half(&self) -> usize {
        self.length / 2
    }

    /// Numbers that a window reads, padding included.
    pub(crate) fn padded_length(&self) -> usize {
        self.taps.len()
    }

    /// Add `sum_k taps[k] x[start + i * decimation + k]` to `out[i]`; `taps` are the filter's own or its derivative's.
    ///
    /// # Panics
    ///
    /// If `x` ends before the last padded window.
    pub(crate) fn add(&self, backend: Backend, taps: &[f64], x: &[f64], start: usize, out: &mut [f64]) {
        add(backend, taps, self.decimation, &x[start..], out);
    }
}

/// Each channel filtered and decimated: a row is the sum over a window of samples, weighted by `taps`, the oldest first.
/// `channels` are channels x samples, and `out` channels x `1 + (samples - taps) / decimation`.
///
/// # Example
///
/// ```
/// use haptid_core::{Backend, decimate};
/// let mut out = [0.; 2];
/// decimate(Backend::best(), &[1., 2., 3., 4.], 4, &[0.5, 0.5], 2, &mut out)?;
/// assert_eq!(out, [1.5, 3.5]);
/// # Ok::<(), haptid_core::Error>(())
/// ```
pub fn decimate(
    backend: Backend,
    channels: &[f64],
    samples: usize,
    taps: &[f64],
    decimation: usize,
    out: &mut [f64],
) -> Result<(), Error> {
    expect_decimation(decimation)?;
    if samples < taps.len().max(1) {
        return Err(Error::Length { name: "channels", got: samples, wanted: taps.len().max(1) });
    }
    let (many, rows) = (channels.len() / samples, 1 + (samples - taps.len()) / decimation);
    expect_length("channels", channels.len(), many * samples)?;
    expect_length("out", out.len(), many * rows)?;
    let taps = padded(taps);
    // The last windows, whose padding may be beyond the channel, are read from a copy of its end.
    let inside = samples.checked_sub(taps.len()).map_or(0, |room| rows.min(1 + room / decimation));
    let begin = inside * decimation;
    let mut end = vec![0.0; (rows - inside).saturating_sub(1) * decimation + taps.len()];
    let there = end.len().min(samples.saturating_sub(begin));
    out.fill(0.0);
    for (channel, out) in channels.chunks_exact(samples).zip(out.chunks_exact_mut(rows)) {
        // Half of the columns of a serial arm are zero.
        if channel.iter().any(|&x| x != 0.0) {
            let (most, last) = out.split_at_mut(inside);
            add(backend, &taps, decimation, channel, most);
            end[..there].copy_from_slice(&channel[begin.min(samples)..][..there]);
            add(backend, &taps, decimation, &end, last);
        }
    }
    Ok(())
}

fn expect_decimation(decimation: usize) -> Result<(), Error> {
    if decimation == 0 {
        return Err(Error::Value { name: "decimation", got: 0.0, wanted: "1 or more" });
    }
    Ok(())
}

/// Taps with zeros up to whole lanes.
fn padded(taps: &[f64]) -> Vec<f64> {
    let mut padded = taps.to_vec();
    padded.resize(taps.len().next_multiple_of(MAX_WIDTH), 0.0);
    padded
}

/// Add `sum_k taps[k] x[i * decimation + k]` to `out[i]`, of padded taps.
///
/// # Panics
///
/// If `x` ends before the last padded window.
fn add(backend: Backend, taps: &[f64], decimation: usize, x: &[f64], out: &mut [f64]) {
    let Some(last) = out.len().checked_sub(1) else { return };
    assert!(last * decimation + taps.len() <= x.len());
    // SAFETY: the assertion above keeps the last window, and so all of them, inside x.
    unsafe { add_raw(backend, taps, decimation, x.as_ptr(), out) }
}

dispatched! {
    unsafe fn add_raw = add_in_lanes(taps: &[f64], decimation: usize, x: *const f64, out: &mut [f64])
}

#[inline(always)]
unsafe fn add_in_lanes<T: Lane>(simd: Simd<T>, taps: &[f64], decimation: usize, x: *const f64, out: &mut [f64]) {
    // Four windows at a time hide the latency of the fused multiply-add and share the taps. The grouping changes no
    // sum.
    let (fours, rest) = out.as_chunks_mut::<4>();
    let alone = 4 * fours.len();
    for (i, out) in fours.iter_mut().enumerate() {
        // SAFETY: the caller promises x for all windows of `out`.
        unsafe { add_some::<T, 4>(simd, taps, decimation, x.add(4 * i * decimation), out) };
    }
    for (i, out) in (alone..).zip(rest) {
        // SAFETY: as above.
        unsafe { add_some::<T, 1>(simd, taps, decimation, x.add(i * decimation), core::array::from_mut(out)) };
    }
}

#[inline(always)]
unsafe fn add_some<T: Lane, const N: usize>(
    simd: Simd<T>,
    taps: &[f64],
    decimation: usize,
    x: *const f64,
    out: &mut [f64; N],
) {
    let mut sums = [simd.splat(0.0); N];
    let mut k = 0;
    while k < taps.len() {
        // SAFETY: taps are whole lanes, of which k is a beginning.
        let tap = unsafe { simd.load(taps.as_ptr().add(k)) };
        for (i, sum) in sums.iter_mut().enumerate() {
            // SAFETY: the caller promises that x has the taps' length after each window's beginning.
            *sum = tap.fma(unsafe { simd.load(x.add(i * decimation + k)) }, *sum);
        }
        k += T::WIDTH;
    }
    out.iter_mut().zip(sums).for_each(|(out, sum)| *out += sum.sum());
}
