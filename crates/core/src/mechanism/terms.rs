//! Terms: columns of the regressor in addition to link inertia, each linear in one parameter and a function of one
//! displacement.

use crate::error::Error;
use crate::mechanism::closure::JointMap;
use crate::simd::lane::Lane;
use crate::simd::token::Simd;

/// The function that a term's column is, of its displacement x, velocity v and acceleration.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Law {
    /// Rotor inertia: the acceleration.
    Rotor,
    /// Viscous friction: the velocity.
    Viscous,
    /// Coulomb friction: sgn v, or tanh(v / width) where the width is not zero.
    Coulomb {
        /// Width of the transition, rad/s or m/s; zero for none.
        width: f64,
    },
    /// Coulomb friction of forward motion only: sgn v where v > 0.
    CoulombForward {
        /// As for [`Law::Coulomb`].
        width: f64,
    },
    /// Coulomb friction of backward motion only: sgn v where v < 0.
    CoulombBackward {
        /// As for [`Law::Coulomb`].
        width: f64,
    },
    /// Stribeck friction: sgn(v) exp(-(|v| / velocity)^exponent).
    Stribeck {
        /// Stribeck velocity, rad/s or m/s.
        velocity: f64,
        /// Exponent of the velocity ratio.
        exponent: f64,
        /// As for [`Law::Coulomb`].
        width: f64,
    },
    /// Constant torque: one.
    Offset,
    /// Spring: x - rest.
    Spring {
        /// Displacement at rest, rad or m.
        rest: f64,
    },
    /// A column that the caller computes: a channel of [`crate::Motion::external`].
    External,
}

/// A term: its law, and the joint, or the linear combination of coordinates, that it acts on.
#[derive(Debug, Clone, PartialEq)]
pub struct Term {
    /// The column as a function of the displacement.
    pub law: Law,
    /// Coordinates and their weights in the displacement; no weight is zero.
    pub weights: Vec<(usize, f64)>,
    /// Displacement at zero coordinates, rad or m.
    pub offset: f64,
    /// The joint that the term acts on, in place of weights and offset; necessary where the motion prescribes the
    /// joint's position.
    pub joint: Option<usize>,
}

/// A term in the form that the kernels use.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Column {
    pub law: Law,
    pub joint_map: JointMap,
}

impl Term {
    pub(crate) fn check(&self, coordinates: usize) -> Result<(), Error> {
        for (k, &(a, weight)) in self.weights.iter().enumerate() {
            if self.weights[..k].iter().any(|earlier| earlier.0 == a) {
                return Err(Error::Repeated { name: "term coordinate", got: a });
            }
            if a >= coordinates {
                return Err(Error::Index { name: "term coordinate", got: a, limit: coordinates });
            }
            if !weight.is_finite() || weight == 0.0 {
                return Err(Error::Value {
                    name: "term weight",
                    got: weight,
                    wanted: "a finite number other than zero",
                });
            }
        }
        if !self.offset.is_finite() {
            return Err(Error::Value { name: "term offset", got: self.offset, wanted: "a finite number" });
        }
        let positive = |name, got: f64| match got.is_finite() && got > 0.0 {
            true => Ok(()),
            false => Err(Error::Value { name, got, wanted: "a finite number above zero" }),
        };
        let width = |got: f64| if got == 0.0 { Ok(()) } else { positive("width", got) };
        match self.law {
            Law::Coulomb { width: w } | Law::CoulombForward { width: w } | Law::CoulombBackward { width: w } => {
                width(w)
            }
            Law::Stribeck { velocity, exponent, width: w } => {
                positive("Stribeck velocity", velocity)?;
                positive("Stribeck exponent", exponent)?;
                width(w)
            }
            Law::Spring { rest } if !rest.is_finite() => {
                Err(Error::Value { name: "spring rest", got: rest, wanted: "a finite number" })
            }
            _ => Ok(()),
        }
    }
}

/// sgn v, or tanh(v / width) where the width is not zero; 0 at rest.
#[inline(always)]
fn sign<T: Lane>(v: T, width: f64) -> T {
    let simd = Simd::of(v);
    if width > 0.0 {
        return v.mul(simd.splat(1.0 / width)).tanh();
    }
    let (zero, one) = (simd.splat(0.0), simd.splat(1.0));
    T::select_gt(zero, v, one.neg(), T::select_gt(v, zero, one, zero))
}

/// Derivative of [`sign`]; zero where it jumps.
#[inline(always)]
fn sign_slope<T: Lane>(v: T, width: f64) -> T {
    let simd = Simd::of(v);
    if width == 0.0 {
        return simd.splat(0.0);
    }
    let sign = sign(v, width);
    sign.fnma(sign, simd.splat(1.0)).mul(simd.splat(1.0 / width))
}

/// exp(-(|v| / velocity)^exponent) and its derivative; zero at rest, where it is multiplied by zero.
#[inline(always)]
fn fading<T: Lane>(v: T, velocity: f64, exponent: f64) -> (T, T) {
    let simd = Simd::of(v);
    let (size, zero) = (v.xor_sign(v), simd.splat(0.0));
    let share = size.mul(simd.splat(1.0 / velocity)).power(exponent);
    let fading = share.neg().exp();
    let slope = share.mul(simd.splat(-exponent)).div(v).mul(fading);
    let moves = T::select_gt(size, zero, slope, zero);
    // Where the exponential vanishes the power may be infinite.
    (fading, T::select_gt(fading, zero, moves, zero))
}

impl Law {
    /// The column, for one lane. `external` is read only by [`Law::External`].
    #[inline(always)]
    pub(crate) fn column<T: Lane>(self, x: T, v: T, a: T, external: T) -> T {
        let simd = Simd::of(v);
        match self {
            Law::Rotor => a,
            Law::Viscous => v,
            Law::Coulomb { width } => sign(v, width),
            Law::CoulombForward { width } => sign(T::select_gt(v, simd.splat(0.0), v, simd.splat(0.0)), width),
            Law::CoulombBackward { width } => sign(T::select_gt(simd.splat(0.0), v, v, simd.splat(0.0)), width),
            Law::Stribeck { velocity, exponent, width } => sign(v, width).mul(fading(v, velocity, exponent).0),
            Law::Offset => simd.splat(1.0),
            Law::Spring { rest } => x.sub(simd.splat(rest)),
            Law::External => external,
        }
    }

    /// Derivatives of the column with respect to x, v and a; zero at jumps.
    #[inline(always)]
    pub(crate) fn slopes<T: Lane>(self, v: T) -> [T; 3] {
        let simd = Simd::of(v);
        let (zero, one) = (simd.splat(0.0), simd.splat(1.0));
        let by_v = match self {
            Law::Viscous => one,
            Law::Coulomb { width } => sign_slope(v, width),
            Law::CoulombForward { width } => T::select_gt(v, zero, sign_slope(v, width), zero),
            Law::CoulombBackward { width } => T::select_gt(zero, v, sign_slope(v, width), zero),
            Law::Stribeck { velocity, exponent, width } => {
                let (fading, slope) = fading(v, velocity, exponent);
                sign_slope(v, width).fma(fading, sign(v, width).mul(slope))
            }
            Law::Rotor | Law::Offset | Law::Spring { .. } | Law::External => zero,
        };
        let by_x = if matches!(self, Law::Spring { .. }) { one } else { zero };
        let by_a = if self == Law::Rotor { one } else { zero };
        [by_x, by_v, by_a]
    }
}
