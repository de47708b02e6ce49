//! Tokens: proof, in the types, that the processor has the instructions of a lane.
//!
//! A token takes no memory and comes from detection, or from a lane that exists already. Lanes are made with a token
//! only, and a kernel takes one by value. So no lane exists where its instructions have not been detected; and the only
//! functions with a `target_feature` are those of a token's method `run`.

use crate::simd::lane::Lane;
use crate::simd::portable::Portable;
#[cfg(target_arch = "x86_64")]
use crate::simd::x86::{Avx2, Avx512};
use core::marker::PhantomData;

/// Proof that this processor has the instructions of the lane `T`.
#[derive(Clone, Copy)]
pub(crate) struct Simd<T>(PhantomData<T>);

impl<T: Lane> Simd<T> {
    /// The token of a lane: where one exists, its instructions do.
    #[inline(always)]
    pub(crate) fn of(_: T) -> Simd<T> {
        Simd(PhantomData)
    }

    /// The same number in every sample.
    #[inline(always)]
    pub(crate) fn splat(self, x: f64) -> T {
        T::splat(self, x)
    }

    /// Load a lane.
    ///
    /// # Safety
    ///
    /// As for [`Lane::load`].
    #[inline(always)]
    pub(crate) unsafe fn load(self, p: *const f64) -> T {
        // SAFETY: the caller's promise.
        unsafe { T::load(self, p) }
    }
}

#[cfg(target_arch = "x86_64")]
impl Simd<Avx2> {
    /// The token, where AVX2 and FMA are detected.
    pub(crate) fn detect() -> Option<Simd<Avx2>> {
        (is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma")).then_some(Simd(PhantomData))
    }

    /// Do `work`, if it is `inline(always)` compiled with these instructions.
    #[inline(always)]
    pub(crate) fn run<R>(self, work: impl FnOnce() -> R) -> R {
        #[target_feature(enable = "avx2,fma")]
        fn compiled<R>(work: impl FnOnce() -> R) -> R {
            work()
        }
        // SAFETY: the token proves the instructions.
        unsafe { compiled(work) }
    }
}

#[cfg(target_arch = "x86_64")]
impl Simd<Avx512> {
    /// The token, where AVX-512F and DQ, AVX2 and FMA are detected.
    pub(crate) fn detect() -> Option<Simd<Avx512>> {
        let wide = is_x86_feature_detected!("avx512f") && is_x86_feature_detected!("avx512dq");
        (wide && Simd::<Avx2>::detect().is_some()).then_some(Simd(PhantomData))
    }

    /// As for AVX2.
    #[inline(always)]
    pub(crate) fn run<R>(self, work: impl FnOnce() -> R) -> R {
        #[target_feature(enable = "avx512f,avx512dq,avx2,fma")]
        fn compiled<R>(work: impl FnOnce() -> R) -> R {
            work()
        }
        // SAFETY: the token proves the instructions.
        unsafe { compiled(work) }
    }
}

impl<const FUSED: bool> Simd<Portable<FUSED>> {
    /// The token of plain arrays, which need no instructions of their own.
    pub(crate) fn portable() -> Simd<Portable<FUSED>> {
        Simd(PhantomData)
    }
}
