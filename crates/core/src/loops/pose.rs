//! Poses of frames and their rates, for the geometry of loops.

use crate::simd::real::Number;

pub(crate) type Vector<N> = [N; 3];

/// A rotation, where there is one, and a shift.
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

/// Where a link or a frame is: axes and origin, seen from the base.
#[derive(Clone, Copy)]
pub(crate) struct Pose<N> {
    pub(crate) axes: [Vector<N>; 3],
    pub(crate) origin: Vector<N>,
}

// No closure stands between these and the lanes: one that is not inlined would pass them through memory.

#[inline(always)]
pub(crate) fn dot<N: Number>(a: Vector<N>, b: Vector<N>) -> N {
    (a[0] * b[0]).plus(a[1], b[1]).plus(a[2], b[2])
}

#[inline(always)]
pub(crate) fn sub<N: Number>(a: Vector<N>, b: Vector<N>) -> Vector<N> {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

#[inline(always)]
pub(crate) fn cross<N: Number>(a: Vector<N>, b: Vector<N>) -> Vector<N> {
    [(a[1] * b[2]).minus(a[2], b[1]), (a[2] * b[0]).minus(a[0], b[2]), (a[0] * b[1]).minus(a[1], b[0])]
}

#[inline(always)]
pub(crate) fn times<N: Number>(a: Vector<N>, x: N) -> Vector<N> {
    [a[0] * x, a[1] * x, a[2] * x]
}

/// a + b x
#[inline(always)]
pub(crate) fn plus<N: Number>(a: Vector<N>, b: Vector<N>, x: N) -> Vector<N> {
    [a[0].plus(b[0], x), a[1].plus(b[1], x), a[2].plus(b[2], x)]
}

/// a - b x
#[inline(always)]
pub(crate) fn minus<N: Number>(a: Vector<N>, b: Vector<N>, x: N) -> Vector<N> {
    [a[0].minus(b[0], x), a[1].minus(b[1], x), a[2].minus(b[2], x)]
}

/// a + b x, where x is constant.
#[inline(always)]
pub(crate) fn plus_times<N: Number>(a: Vector<N>, b: Vector<N>, x: f64) -> Vector<N> {
    [a[0].plus_times(b[0], x), a[1].plus_times(b[1], x), a[2].plus_times(b[2], x)]
}

impl<N: Number> Pose<N> {
    #[inline(always)]
    pub(crate) fn base() -> Self {
        let (one, none) = (N::of(1.0), N::of(0.0));
        Pose { axes: [[one, none, none], [none, one, none], [none, none, one]], origin: [none; 3] }
    }

    /// Rates of a frame that stands still.
    #[inline(always)]
    pub(crate) fn still() -> Self {
        let zero = [N::of(0.0); 3];
        Pose { axes: [zero; 3], origin: zero }
    }

    /// Rates of the axes and the origin with a joint that carries them, whose link is given.
    #[inline(always)]
    pub(crate) fn turned_by(&self, link: &Pose<N>, prismatic: bool) -> Self {
        let ([x, y, z], about) = (self.axes, link.axes[2]);
        if prismatic {
            return Pose { origin: about, ..Pose::still() };
        }
        let axes = [cross(about, x), cross(about, y), cross(about, z)];
        Pose { axes, origin: cross(about, sub(self.origin, link.origin)) }
    }

    /// A point, and how far it is from there along the axes.
    #[inline(always)]
    pub(crate) fn along(&self, from: Vector<N>, x: [f64; 3]) -> Vector<N> {
        let [a, b, c] = self.axes;
        plus_times(plus_times(plus_times(from, a, x[0]), b, x[1]), c, x[2])
    }

    /// A frame that stands in this one.
    #[inline(always)]
    pub(crate) fn placed(&self, at: &Placement) -> Self {
        let (origin, none) = (self.along(self.origin, at.shift), [N::of(0.0); 3]);
        let axes = match at.rotation {
            None => self.axes,
            Some([a, b, c, d, e, f, g, h, i]) => {
                [self.along(none, [a, d, g]), self.along(none, [b, e, h]), self.along(none, [c, f, i])]
            }
        };
        Pose { axes, origin }
    }

    /// Turned about, or moved along, its own z.
    #[inline(always)]
    pub(crate) fn moved(&self, prismatic: bool, q: N) -> Self {
        let [x, y, z] = self.axes;
        if prismatic {
            return Pose { axes: self.axes, origin: plus(self.origin, z, q) };
        }
        let (s, c) = q.sin_cos();
        Pose { axes: [plus(times(x, c), y, s), minus(times(y, c), x, s), z], origin: self.origin }
    }
}
