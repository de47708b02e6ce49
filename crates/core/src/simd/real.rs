//! Numbers that the geometry of loops is computed with: f64, a lane of them, or either with its derivative.

use crate::simd::elementary::sin_cos;
use crate::simd::lane::{Lane, MAX_WIDTH};
use crate::simd::token::Simd;
use std::ops::{Add, Mul, Sub};

/// Numbers that positions are composed of. As for lanes, every method must be `inline(always)`.
pub(crate) trait Number: Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> {
    /// What constants are made with: the token of a lane, nothing for plain numbers.
    type Token: Copy;
    /// The token of a number.
    fn token(self) -> Self::Token;
    /// A constant.
    fn constant(token: Self::Token, x: f64) -> Self;
    /// `self * x` with a constant.
    fn scale(self, x: f64) -> Self;
    /// Sine and cosine.
    fn sin_cos(self) -> (Self, Self);
    /// `self + a * b`, fused where the processor can.
    #[inline(always)]
    fn add_product(self, a: Self, b: Self) -> Self {
        self + a * b
    }
    /// `self - a * b`, fused where the processor can.
    #[inline(always)]
    fn sub_product(self, a: Self, b: Self) -> Self {
        self - a * b
    }
    /// `self + a * x` with a constant.
    #[inline(always)]
    fn add_scaled(self, a: Self, x: f64) -> Self {
        self + a.scale(x)
    }
}

/// Numbers that linear equations are solved in.
pub(crate) trait Real: Number {
    /// Number of lanes.
    const WIDTH: usize;
    /// The number whose lane k is x(k).
    fn gather(token: Self::Token, x: impl Fn(usize) -> f64) -> Self;
    /// The lanes as an array.
    fn scatter(self) -> [f64; MAX_WIDTH];
    fn abs(self) -> Self;
    fn sqrt(self) -> Self;
    fn recip(self) -> Self;
    /// `a > b ? x : y`
    fn select(a: Self, b: Self, x: Self, y: Self) -> Self;
    /// Whether all lanes are greater than a bound; NaN is not.
    fn all_greater(self, least: f64) -> bool;

    /// `good` where the absolute value is below a limit, 0 elsewhere; a NaN is not below it.
    #[inline(always)]
    fn if_below(self, limit: f64, good: Self) -> Self {
        let constant = |x| Self::constant(self.token(), x);
        Self::select(constant(limit), self.abs(), good, constant(0.0))
    }
}

impl Number for f64 {
    type Token = ();
    #[inline(always)]
    fn token(self) {}
    #[inline(always)]
    fn constant((): (), x: f64) -> Self {
        x
    }
    #[inline(always)]
    fn scale(self, x: f64) -> Self {
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
    fn gather((): (), x: impl Fn(usize) -> f64) -> Self {
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
    fn sqrt(self) -> Self {
        self.sqrt()
    }
    #[inline(always)]
    fn recip(self) -> Self {
        1.0 / self
    }
    #[inline(always)]
    fn select(a: Self, b: Self, x: Self, y: Self) -> Self {
        if a > b { x } else { y }
    }
    #[inline(always)]
    fn all_greater(self, least: f64) -> bool {
        self > least
    }
}

/// A dual number: a value and its derivative with respect to time.
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
        Dual { value: self.value * b.value, rate: (self.rate * b.value).add_product(self.value, b.rate) }
    }
}

impl<N: Number> Number for Dual<N> {
    type Token = N::Token;
    #[inline(always)]
    fn token(self) -> N::Token {
        self.value.token()
    }
    #[inline(always)]
    fn constant(token: N::Token, x: f64) -> Self {
        Dual { value: N::constant(token, x), rate: N::constant(token, 0.0) }
    }
    #[inline(always)]
    fn scale(self, x: f64) -> Self {
        Dual { value: self.value.scale(x), rate: self.rate.scale(x) }
    }
    #[inline(always)]
    fn sin_cos(self) -> (Self, Self) {
        let (s, c) = self.value.sin_cos();
        let none = N::constant(self.token(), 0.0);
        (Dual { value: s, rate: c * self.rate }, Dual { value: c, rate: none.sub_product(s, self.rate) })
    }
    #[inline(always)]
    fn add_product(self, a: Self, b: Self) -> Self {
        Dual {
            value: self.value.add_product(a.value, b.value),
            rate: self.rate.add_product(a.rate, b.value).add_product(a.value, b.rate),
        }
    }
    #[inline(always)]
    fn sub_product(self, a: Self, b: Self) -> Self {
        let rate = self.rate.sub_product(a.rate, b.value).sub_product(a.value, b.rate);
        Dual { value: self.value.sub_product(a.value, b.value), rate }
    }
    #[inline(always)]
    fn add_scaled(self, a: Self, x: f64) -> Self {
        Dual { value: self.value.add_scaled(a.value, x), rate: self.rate.add_scaled(a.rate, x) }
    }
}

/// A lane as a number.
#[derive(Debug, Clone, Copy)]
pub(crate) struct LaneNumber<T>(T);

impl<T: Lane> Add for LaneNumber<T> {
    type Output = Self;
    #[inline(always)]
    fn add(self, b: Self) -> Self {
        LaneNumber(self.0.add(b.0))
    }
}

impl<T: Lane> Sub for LaneNumber<T> {
    type Output = Self;
    #[inline(always)]
    fn sub(self, b: Self) -> Self {
        LaneNumber(self.0.sub(b.0))
    }
}

impl<T: Lane> Mul for LaneNumber<T> {
    type Output = Self;
    #[inline(always)]
    fn mul(self, b: Self) -> Self {
        LaneNumber(self.0.mul(b.0))
    }
}

impl<T: Lane> Number for LaneNumber<T> {
    type Token = Simd<T>;
    #[inline(always)]
    fn token(self) -> Simd<T> {
        Simd::of(self.0)
    }
    #[inline(always)]
    fn constant(simd: Simd<T>, x: f64) -> Self {
        LaneNumber(simd.splat(x))
    }
    #[inline(always)]
    fn scale(self, x: f64) -> Self {
        LaneNumber(self.0.mul(self.token().splat(x)))
    }
    #[inline(always)]
    fn sin_cos(self) -> (Self, Self) {
        let (s, c) = sin_cos(self.0);
        (LaneNumber(s), LaneNumber(c))
    }
    #[inline(always)]
    fn add_product(self, a: Self, b: Self) -> Self {
        LaneNumber(a.0.fma(b.0, self.0))
    }
    #[inline(always)]
    fn sub_product(self, a: Self, b: Self) -> Self {
        LaneNumber(a.0.fnma(b.0, self.0))
    }
    #[inline(always)]
    fn add_scaled(self, a: Self, x: f64) -> Self {
        LaneNumber(a.0.fma(self.token().splat(x), self.0))
    }
}

impl<T: Lane> Real for LaneNumber<T> {
    const WIDTH: usize = T::WIDTH;
    #[inline(always)]
    fn gather(simd: Simd<T>, x: impl Fn(usize) -> f64) -> Self {
        let mut each = [0.0; MAX_WIDTH];
        (0..T::WIDTH).for_each(|k| each[k] = x(k));
        // SAFETY: the array has room for the widest lane.
        LaneNumber(unsafe { simd.load(each.as_ptr()) })
    }
    #[inline(always)]
    fn scatter(self) -> [f64; MAX_WIDTH] {
        let mut each = [0.0; MAX_WIDTH];
        // SAFETY: the array has room for the widest lane.
        unsafe { self.0.store(each.as_mut_ptr()) };
        each
    }
    #[inline(always)]
    fn abs(self) -> Self {
        LaneNumber(self.0.xor_sign(self.0))
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        LaneNumber(self.0.map(f64::sqrt))
    }
    #[inline(always)]
    fn recip(self) -> Self {
        LaneNumber(self.0.map(f64::recip))
    }
    #[inline(always)]
    fn select(a: Self, b: Self, x: Self, y: Self) -> Self {
        LaneNumber(T::select_gt(a.0, b.0, x.0, y.0))
    }
    #[inline(always)]
    fn all_greater(self, least: f64) -> bool {
        let splat = |x| self.token().splat(x);
        T::select_gt(self.0, splat(least), splat(1.0), splat(0.0)).sum() == T::WIDTH as f64
    }
}
