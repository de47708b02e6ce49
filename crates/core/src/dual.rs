//! Numbers with a rate of change, so that one formula gives a value and its derivative along a motion.

use std::ops::{Add, Mul, Sub};

/// What the geometry of loops is computed with.
pub(crate) trait Number: Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> {
    fn of(x: f64) -> Self;
    /// Times a constant.
    fn times(self, x: f64) -> Self;
    fn sin_cos(self) -> (Self, Self);
}

impl Number for f64 {
    fn of(x: f64) -> Self {
        x
    }
    fn times(self, x: f64) -> Self {
        self * x
    }
    fn sin_cos(self) -> (Self, Self) {
        f64::sin_cos(self)
    }
}

/// A number and its rate of change.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Dual {
    pub(crate) value: f64,
    pub(crate) rate: f64,
}

impl Add for Dual {
    type Output = Self;
    fn add(self, b: Self) -> Self {
        Dual { value: self.value + b.value, rate: self.rate + b.rate }
    }
}

impl Sub for Dual {
    type Output = Self;
    fn sub(self, b: Self) -> Self {
        Dual { value: self.value - b.value, rate: self.rate - b.rate }
    }
}

impl Mul for Dual {
    type Output = Self;
    fn mul(self, b: Self) -> Self {
        Dual { value: self.value * b.value, rate: self.rate * b.value + self.value * b.rate }
    }
}

impl Number for Dual {
    fn of(x: f64) -> Self {
        Dual { value: x, rate: 0.0 }
    }
    fn times(self, x: f64) -> Self {
        Dual { value: self.value * x, rate: self.rate * x }
    }
    fn sin_cos(self) -> (Self, Self) {
        let (s, c) = self.value.sin_cos();
        (Dual { value: s, rate: c * self.rate }, Dual { value: c, rate: -s * self.rate })
    }
}
