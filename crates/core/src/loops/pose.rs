//! Poses of frames and their rates, for the geometry of loops.

use crate::simd::real::Number;

pub(crate) type Vector<N> = [N; 3];

/// A constant placement: a rotation, if it is not the identity, and a translation.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Placement {
    pub(crate) rotation: Option<[f64; 9]>,
    pub(crate) shift: [f64; 3],
}

impl Placement {
    pub(crate) fn new(rotation: [f64; 9], shift: [f64; 3]) -> Placement {
        Placement { rotation: Some(rotation).filter(|r| *r != [1., 0., 0., 0., 1., 0., 0., 0., 1.]), shift }
    }
}

/// Axes and origin of a link or frame, in the base frame.
#[derive(Clone, Copy)]
pub(crate) struct Pose<N> {
    pub(crate) axes: [Vector<N>; 3],
    pub(crate) origin: Vector<N>,
}

// These are functions, not closures: a closure that is not inlined would pass the lanes through memory.

#[inline(always)]
pub(crate) fn dot<N: Number>(a: Vector<N>, b: Vector<N>) -> N {
    (a[0] * b[0]).add_product(a[1], b[1]).add_product(a[2], b[2])
}

#[inline(always)]
pub(crate) fn sub<N: Number>(a: Vector<N>, b: Vector<N>) -> Vector<N> {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

#[inline(always)]
pub(crate) fn cross<N: Number>(a: Vector<N>, b: Vector<N>) -> Vector<N> {
    [
        (a[1] * b[2]).sub_product(a[2], b[1]),
        (a[2] * b[0]).sub_product(a[0], b[2]),
        (a[0] * b[1]).sub_product(a[1], b[0]),
    ]
}

#[inline(always)]
pub(crate) fn scale<N: Number>(a: Vector<N>, x: N) -> Vector<N> {
    [a[0] * x, a[1] * x, a[2] * x]
}

/// a + b x
#[inline(always)]
pub(crate) fn add_product<N: Number>(a: Vector<N>, b: Vector<N>, x: N) -> Vector<N> {
    [a[0].add_product(b[0], x), a[1].add_product(b[1], x), a[2].add_product(b[2], x)]
}

/// a - b x
#[inline(always)]
pub(crate) fn sub_product<N: Number>(a: Vector<N>, b: Vector<N>, x: N) -> Vector<N> {
    [a[0].sub_product(b[0], x), a[1].sub_product(b[1], x), a[2].sub_product(b[2], x)]
}

/// a + b x with constant x.
#[inline(always)]
pub(crate) fn add_scaled<N: Number>(a: Vector<N>, b: Vector<N>, x: f64) -> Vector<N> {
    [a[0].add_scaled(b[0], x), a[1].add_scaled(b[1], x), a[2].add_scaled(b[2], x)]
}

impl<N: Number> Pose<N> {
    #[inline(always)]
    pub(crate) fn base(token: N::Token) -> Self {
        let (one, none) = (N::constant(token, 1.0), N::constant(token, 0.0));
        Pose { axes: [[one, none, none], [none, one, none], [none, none, one]], origin: [none; 3] }
    }

    /// Rates of a frame that does not move.
    #[inline(always)]
    pub(crate) fn zero(token: N::Token) -> Self {
        let zero = [N::constant(token, 0.0); 3];
        Pose { axes: [zero; 3], origin: zero }
    }

    /// Rates of axes and origin with respect to a joint that carries them, given its link.
    #[inline(always)]
    pub(crate) fn rates_by(&self, link: &Pose<N>, prismatic: bool) -> Self {
        let ([x, y, z], about) = (self.axes, link.axes[2]);
        if prismatic {
            return Pose { origin: about, ..Pose::zero(about[0].token()) };
        }
        let axes = [cross(about, x), cross(about, y), cross(about, z)];
        Pose { axes, origin: cross(about, sub(self.origin, link.origin)) }
    }

    /// The point at coordinates `x` along the axes from a point.
    #[inline(always)]
    pub(crate) fn along(&self, from: Vector<N>, x: [f64; 3]) -> Vector<N> {
        let [a, b, c] = self.axes;
        add_scaled(add_scaled(add_scaled(from, a, x[0]), b, x[1]), c, x[2])
    }

    /// A frame placed in this one.
    #[inline(always)]
    pub(crate) fn place(&self, at: &Placement) -> Self {
        let origin = self.along(self.origin, at.shift);
        let none = [N::constant(origin[0].token(), 0.0); 3];
        let axes = match at.rotation {
            None => self.axes,
            Some([a, b, c, d, e, f, g, h, i]) => {
                [self.along(none, [a, d, g]), self.along(none, [b, e, h]), self.along(none, [c, f, i])]
            }
        };
        Pose { axes, origin }
    }

    /// Rotated about, or translated along, its own z.
    #[inline(always)]
    pub(crate) fn move_joint(&self, prismatic: bool, q: N) -> Self {
        let [x, y, z] = self.axes;
        if prismatic {
            return Pose { axes: self.axes, origin: add_product(self.origin, z, q) };
        }
        let (s, c) = q.sin_cos();
        Pose { axes: [add_product(scale(x, c), y, s), sub_product(scale(y, c), x, s), z], origin: self.origin }
    }
}
