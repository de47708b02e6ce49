//! Numbers with a rate of change, so that one formula gives a value and its derivative along a motion.

use crate::number::Number;
use std::ops::{Add, Mul, Sub};

/// A number and its rate of change.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Dual<N> {
    pub(crate) value: N,
    pub(crate) rate: N,
}

impl<N: Number> Add for Dual<N> {
    type Output = Self;
    #[inline(always)]
    fn add(self, b: Self) -> Self {
        Dual { value: self.value + b.value, rate: self.rate + b.rate }
    }
}

impl<N: Number> Sub for Dual<N> {
    type Output = Self;
    #[inline(always)]
    fn sub(self, b: Self) -> Self {
        Dual { value: self.value - b.value, rate: self.rate - b.rate }
    }
}

impl<N: Number> Mul for Dual<N> {
    type Output = Self;
    #[inline(always)]
    fn mul(self, b: Self) -> Self {
        Dual { value: self.value * b.value, rate: (self.rate * b.value).plus(self.value, b.rate) }
    }
}

impl<N: Number> Number for Dual<N> {
    #[inline(always)]
    fn of(x: f64) -> Self {
        Dual { value: N::of(x), rate: N::of(0.0) }
    }
    #[inline(always)]
    fn times(self, x: f64) -> Self {
        Dual { value: self.value.times(x), rate: self.rate.times(x) }
    }
    #[inline(always)]
    fn sin_cos(self) -> (Self, Self) {
        let (s, c) = self.value.sin_cos();
        (Dual { value: s, rate: c * self.rate }, Dual { value: c, rate: N::of(0.0).minus(s, self.rate) })
    }
    #[inline(always)]
    fn plus(self, a: Self, b: Self) -> Self {
        Dual { value: self.value.plus(a.value, b.value), rate: self.rate.plus(a.rate, b.value).plus(a.value, b.rate) }
    }
    #[inline(always)]
    fn minus(self, a: Self, b: Self) -> Self {
        let rate = self.rate.minus(a.rate, b.value).minus(a.value, b.rate);
        Dual { value: self.value.minus(a.value, b.value), rate }
    }
    #[inline(always)]
    fn plus_times(self, a: Self, x: f64) -> Self {
        Dual { value: self.value.plus_times(a.value, x), rate: self.rate.plus_times(a.rate, x) }
    }
}
