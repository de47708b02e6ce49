//! Part of a motion, followed in lanes: a few samples at once, each reached in one step from the one before them all.

use crate::loops::assembly::{Branch, Stop};
use crate::loops::continuation::{March, Stand};
use crate::loops::newton::Tried;
use crate::simd::dispatch::Kind;
use crate::simd::real::Real;
#[cfg(target_arch = "x86_64")]
use crate::simd::real::Wide;
#[cfg(target_arch = "x86_64")]
use crate::simd::x86::{Avx2, Avx512};
use std::ops::Range;

/// Samples that follow each other, and what is found for them.
pub(crate) struct Part<'a> {
    pub first: usize,
    pub position: &'a [f64],
    pub velocity: &'a [f64],
    pub q: &'a mut [f64],
    pub rates: &'a mut [f64],
    pub change: &'a mut [f64],
}

impl Part<'_> {
    /// Follow the part from the start; none where that does not lead to it. Returns where it ends.
    pub(crate) fn guessed(&mut self, branch: &Branch) -> Option<Result<Stand, Stop>> {
        let mut march = March::new(branch);
        let found = march.go(&self.position[..branch.active()]).then(|| self.follow(&mut march));
        found.map(|led| led.map(|()| march.stand))
    }

    /// Follow the part with a march that stands at its first sample, and is left at its last: in the processor's own
    /// vectors where it has wide ones, else sample by sample.
    pub(crate) fn follow(&mut self, march: &mut March) -> Result<(), Stop> {
        #[cfg(target_arch = "x86_64")]
        #[target_feature(enable = "avx512f,avx512dq,avx2,fma")]
        fn avx512(part: &mut Part, march: &mut March) -> Result<(), Stop> {
            follow_in_lanes::<Wide<Avx512>>(part, march)
        }
        #[cfg(target_arch = "x86_64")]
        #[target_feature(enable = "avx2,fma")]
        fn avx2(part: &mut Part, march: &mut March) -> Result<(), Stop> {
            follow_in_lanes::<Wide<Avx2>>(part, march)
        }
        match march.branch.backend.0 {
            // SAFETY: a backend value exists only where its instructions were detected.
            #[cfg(target_arch = "x86_64")]
            Kind::Avx512 => unsafe { avx512(self, march) },
            #[cfg(target_arch = "x86_64")]
            Kind::Avx2 => unsafe { avx2(self, march) },
            #[cfg(target_arch = "aarch64")]
            Kind::Neon => follow_in_lanes::<f64>(self, march),
            Kind::Portable => follow_in_lanes::<f64>(self, march),
        }
    }

    /// Follow some samples one after the other.
    fn one_by_one(&mut self, march: &mut March, samples: Range<usize>) -> Result<(), Stop> {
        let (n, a) = (march.branch.joints(), march.branch.active());
        for k in samples {
            if !march.go_on(&self.position[k * a..][..a]) {
                return Err(march.stop(self.first + k));
            }
            self.q[k * n..][..n].copy_from_slice(&march.stand.q);
        }
        Ok(())
    }
}

#[inline(always)]
fn follow_in_lanes<N: Real>(part: &mut Part, march: &mut March) -> Result<(), Stop> {
    let (branch, a) = (march.branch, march.branch.active());
    let (mut tried, mut velocity) = (Tried::<N>::new(branch), vec![N::of(0.0); a]);
    for from in (0..part.position.len() / a).step_by(N::WIDTH) {
        let samples = from..(part.position.len() / a).min(from + N::WIDTH);
        let mut targets = part.position[samples.start * a..samples.end * a].chunks_exact(a);
        gather(part.position, &samples, &mut tried.at);
        let together = targets.all(|target| march.is_near(target)) && tried.step(branch, &march.stand);
        if together {
            scatter(&tried.q, &samples, part.q);
        } else {
            part.one_by_one(march, samples.clone())?;
            gather(part.q, &samples, &mut tried.q);
        }
        if !part.rates.is_empty() {
            tried.measure(branch);
        }
        if together || !part.rates.is_empty() {
            tried.follow(branch);
        }
        if together {
            march.stand.move_to(branch, &tried, samples.len() - 1);
        }
        if !part.rates.is_empty() {
            scatter(&tried.rates, &samples, part.rates);
        }
        if !part.change.is_empty() {
            gather(part.velocity, &samples, &mut velocity);
            tried.follow_on(branch, &velocity);
            scatter(&tried.change, &samples, part.change);
        }
    }
    Ok(())
}

/// Some samples, the last one repeated up to a whole lane, from samples x numbers.
#[inline(always)]
fn gather<N: Real>(all: &[f64], samples: &Range<usize>, numbers: &mut [N]) {
    let many = numbers.len();
    for (e, number) in numbers.iter_mut().enumerate() {
        *number = N::gather(|k| all[(samples.start + k).min(samples.end - 1) * many + e]);
    }
}

/// Write some samples where they belong, samples x numbers.
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
