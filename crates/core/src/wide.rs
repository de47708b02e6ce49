//! Lanes as numbers: the geometry of loops for a few samples at once.

use crate::lane::{self, Lane, MAX_WIDTH};
use crate::number::{Number, Real};
use std::ops::{Add, Mul, Sub};

/// A lane as a number.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Wide<T>(T);

impl<T: Lane> Add for Wide<T> {
    type Output = Self;
    #[inline(always)]
    fn add(self, b: Self) -> Self {
        Wide(self.0.add(b.0))
    }
}

impl<T: Lane> Sub for Wide<T> {
    type Output = Self;
    #[inline(always)]
    fn sub(self, b: Self) -> Self {
        Wide(self.0.sub(b.0))
    }
}

impl<T: Lane> Mul for Wide<T> {
    type Output = Self;
    #[inline(always)]
    fn mul(self, b: Self) -> Self {
        Wide(self.0.mul(b.0))
    }
}

impl<T: Lane> Number for Wide<T> {
    #[inline(always)]
    fn of(x: f64) -> Self {
        Wide(T::splat(x))
    }
    #[inline(always)]
    fn times(self, x: f64) -> Self {
        Wide(self.0.mul(T::splat(x)))
    }
    #[inline(always)]
    fn sin_cos(self) -> (Self, Self) {
        let (s, c) = lane::sin_cos(self.0);
        (Wide(s), Wide(c))
    }
    #[inline(always)]
    fn plus(self, a: Self, b: Self) -> Self {
        Wide(a.0.fma(b.0, self.0))
    }
    #[inline(always)]
    fn minus(self, a: Self, b: Self) -> Self {
        Wide(a.0.fnma(b.0, self.0))
    }
    #[inline(always)]
    fn plus_times(self, a: Self, x: f64) -> Self {
        Wide(a.0.fma(T::splat(x), self.0))
    }
}

impl<T: Lane> Real for Wide<T> {
    const WIDTH: usize = T::WIDTH;
    #[inline(always)]
    fn gather(x: impl Fn(usize) -> f64) -> Self {
        let mut each = [0.0; MAX_WIDTH];
        (0..T::WIDTH).for_each(|k| each[k] = x(k));
        // SAFETY: the array has room for the widest lane.
        Wide(unsafe { T::load(each.as_ptr()) })
    }
    #[inline(always)]
    fn scatter(self) -> [f64; MAX_WIDTH] {
        let mut each = [0.0; MAX_WIDTH];
        // SAFETY: as above.
        unsafe { self.0.store(each.as_mut_ptr()) };
        each
    }
    #[inline(always)]
    fn abs(self) -> Self {
        Wide(self.0.flip(self.0))
    }
    #[inline(always)]
    fn root(self) -> Self {
        Wide(self.0.map(f64::sqrt))
    }
    #[inline(always)]
    fn inverse(self) -> Self {
        Wide(self.0.map(f64::recip))
    }
    #[inline(always)]
    fn select(a: Self, b: Self, x: Self, y: Self) -> Self {
        Wide(T::select_gt(a.0, b.0, x.0, y.0))
    }
    #[inline(always)]
    fn exceeds(self, least: f64) -> bool {
        let (one, none) = (T::splat(1.0), T::splat(0.0));
        T::select_gt(self.0, T::splat(least), one, none).sum() == T::WIDTH as f64
    }
}
