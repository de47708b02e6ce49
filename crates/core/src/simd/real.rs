//! What the geometry of loops is computed with: plain numbers, a few of them side by side, or either with a rate.

use crate::simd::elementary::sin_cos;
use crate::simd::lane::{Lane, MAX_WIDTH};
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
        let (s, c) = sin_cos(self.0);
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
