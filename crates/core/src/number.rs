//! What the geometry of loops is computed with: plain numbers, a few of them side by side, or either with a rate.

use crate::lane::MAX_WIDTH;
use std::ops::{Add, Mul, Sub};

/// Numbers that positions are made of. As in lanes, what is used there must be `inline(always)`.
pub(crate) trait Number: Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> {
    fn of(x: f64) -> Self;
    /// Times a constant.
    fn times(self, x: f64) -> Self;
    fn sin_cos(self) -> (Self, Self);
    /// Plus a product, rounded once where the processor can.
    #[inline(always)]
    fn plus(self, a: Self, b: Self) -> Self {
        self + a * b
    }
    /// Minus a product.
    #[inline(always)]
    fn minus(self, a: Self, b: Self) -> Self {
        self - a * b
    }
    /// Plus a multiple.
    #[inline(always)]
    fn plus_times(self, a: Self, x: f64) -> Self {
        self + a.times(x)
    }
}

/// Numbers that equations are solved with.
pub(crate) trait Real: Number {
    /// How many stand side by side.
    const WIDTH: usize;
    /// The k-th is x(k).
    fn gather(x: impl Fn(usize) -> f64) -> Self;
    /// The k-th in place k.
    fn scatter(self) -> [f64; MAX_WIDTH];
    fn abs(self) -> Self;
    fn root(self) -> Self;
    fn inverse(self) -> Self;
    /// `a > b ? x : y`
    fn select(a: Self, b: Self, x: Self, y: Self) -> Self;
    /// Whether all are greater; what is not a number is not.
    fn exceeds(self, least: f64) -> bool;

    /// `good`, or none where the size of the number is not below a limit, as of what is not a number.
    #[inline(always)]
    fn if_below(self, limit: f64, good: Self) -> Self {
        Self::select(Self::of(limit), self.abs(), good, Self::of(0.0))
    }
}

impl Number for f64 {
    #[inline(always)]
    fn of(x: f64) -> Self {
        x
    }
    #[inline(always)]
    fn times(self, x: f64) -> Self {
        self * x
    }
    #[inline(always)]
    fn sin_cos(self) -> (Self, Self) {
        f64::sin_cos(self)
    }
}

impl Real for f64 {
    const WIDTH: usize = 1;
    #[inline(always)]
    fn gather(x: impl Fn(usize) -> f64) -> Self {
        x(0)
    }
    #[inline(always)]
    fn scatter(self) -> [f64; MAX_WIDTH] {
        [self; MAX_WIDTH]
    }
    #[inline(always)]
    fn abs(self) -> Self {
        f64::abs(self)
    }
    #[inline(always)]
    fn root(self) -> Self {
        self.sqrt()
    }
    #[inline(always)]
    fn inverse(self) -> Self {
        1.0 / self
    }
    #[inline(always)]
    fn select(a: Self, b: Self, x: Self, y: Self) -> Self {
        if a > b { x } else { y }
    }
    #[inline(always)]
    fn exceeds(self, least: f64) -> bool {
        self > least
    }
}
