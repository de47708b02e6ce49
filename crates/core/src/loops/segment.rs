//! Segments: parts of a motion followed in lanes, several samples at once, each predicted from the sample before them
//! all.

use crate::loops::assembly::{AssemblyMode, ContinuationStop};
use crate::loops::continuation::{ClosedConfiguration, Continuation};
use crate::loops::newton::NewtonIterate;
use crate::simd::dispatch::Kind;
#[cfg(target_arch = "x86_64")]
use crate::simd::real::LaneNumber;
use crate::simd::real::Real;
#[cfg(target_arch = "x86_64")]
use crate::simd::x86::{Avx2, Avx512};
use std::ops::Range;

/// Consecutive samples, and the results at them.
pub(crate) struct Segment<'a> {
    pub first: usize,
    pub position: &'a [f64],
    pub velocity: &'a [f64],
    pub q: &'a mut [f64],
    pub rates: &'a mut [f64],
    pub rate_derivatives: &'a mut [f64],
}

impl Segment<'_> {
    /// Follow the segment from the start pose; `None` where that does not lead to it. Returns the configuration at its
    /// end.
    pub(crate) fn follow_from_start(
        &mut self,
        mode: &AssemblyMode,
    ) -> Option<Result<ClosedConfiguration, ContinuationStop>> {
        let mut continuation = Continuation::new(mode);
        let found = continuation.advance_to(&self.position[..mode.active()]).then(|| self.follow(&mut continuation));
        found.map(|led| led.map(|()| continuation.configuration))
    }

    /// Follow the segment with a continuation that is at its first sample, and is left at its last: in the processor's
    /// vectors where it has wide ones, otherwise sample by sample.
    pub(crate) fn follow(&mut self, continuation: &mut Continuation) -> Result<(), ContinuationStop> {
        match continuation.mode.backend.0 {
            #[cfg(target_arch = "x86_64")]
            Kind::Avx512(simd) => simd.run(
                #[inline(always)]
                || follow_in_lanes::<LaneNumber<Avx512>>(simd, self, continuation),
            ),
            #[cfg(target_arch = "x86_64")]
            Kind::Avx2(simd) => simd.run(
                #[inline(always)]
                || follow_in_lanes::<LaneNumber<Avx2>>(simd, self, continuation),
            ),
            #[cfg(target_arch = "aarch64")]
            Kind::Neon(_) => follow_in_lanes::<f64>((), self, continuation),
            Kind::Portable(_) => follow_in_lanes::<f64>((), self, continuation),
        }
    }

    /// Follow samples one after the other.
    fn one_by_one(&mut self, continuation: &mut Continuation, samples: Range<usize>) -> Result<(), ContinuationStop> {
        let (n, a) = (continuation.mode.joints(), continuation.mode.active());
        for k in samples {
            if !continuation.advance_or_restart(&self.position[k * a..][..a]) {
                return Err(continuation.stop(self.first + k));
            }
            self.q[k * n..][..n].copy_from_slice(&continuation.configuration.q);
        }
        Ok(())
    }
}

#[inline(always)]
fn follow_in_lanes<N: Real>(
    token: N::Token,
    segment: &mut Segment,
    continuation: &mut Continuation,
) -> Result<(), ContinuationStop> {
    let (mode, a) = (continuation.mode, continuation.mode.active());
    let (mut iterate, mut velocity) = (NewtonIterate::<N>::new(token, mode), vec![N::constant(token, 0.0); a]);
    for from in (0..segment.position.len() / a).step_by(N::WIDTH) {
        let samples = from..(segment.position.len() / a).min(from + N::WIDTH);
        let mut targets = segment.position[samples.start * a..samples.end * a].chunks_exact(a);
        gather(token, segment.position, &samples, &mut iterate.target);
        let together =
            targets.all(|target| continuation.is_near(target)) && iterate.step(mode, &continuation.configuration);
        if together {
            scatter(&iterate.q, &samples, segment.q);
        } else {
            segment.one_by_one(continuation, samples.clone())?;
            gather(token, segment.q, &samples, &mut iterate.q);
        }
        if !segment.rates.is_empty() {
            iterate.evaluate(mode);
        }
        if together || !segment.rates.is_empty() {
            iterate.solve_rates(mode);
        }
        if together {
            continuation.configuration.adopt(mode, &iterate, samples.len() - 1);
        }
        if !segment.rates.is_empty() {
            scatter(&iterate.rates, &samples, segment.rates);
        }
        if !segment.rate_derivatives.is_empty() {
            gather(token, segment.velocity, &samples, &mut velocity);
            iterate.solve_rate_derivatives(mode, &velocity);
            scatter(&iterate.rate_derivatives, &samples, segment.rate_derivatives);
        }
    }
    Ok(())
}

/// Lanes of consecutive samples, the last one repeated up to a whole lane, from samples x numbers.
#[inline(always)]
fn gather<N: Real>(token: N::Token, all: &[f64], samples: &Range<usize>, numbers: &mut [N]) {
    let count = numbers.len();
    for (e, number) in numbers.iter_mut().enumerate() {
        *number = N::gather(token, |k| all[(samples.start + k).min(samples.end - 1) * count + e]);
    }
}

/// Write lanes back to samples x numbers.
#[inline(always)]
fn scatter<N: Real>(numbers: &[N], samples: &Range<usize>, all: &mut [f64]) {
    let all = &mut all[samples.start * numbers.len()..samples.end * numbers.len()];
    for (e, number) in numbers.iter().enumerate() {
        let each = number.scatter();
        for (place, x) in all[e..].iter_mut().step_by(numbers.len()).zip(each) {
            *place = x;
        }
    }
}
