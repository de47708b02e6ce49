//! One joint in lanes: how vectors and axes of the parent's frame look in the link's.

use crate::batch::{Slot, load, store};
use crate::lane::{Lane, sin_cos};
use crate::mechanism::{Link, Shape, Turn, Way};
use crate::vector::{Vector, cross_add, zero};

/// A joint at one position. Where its shape is a constant to the compiler, so is what need not be computed.
#[derive(Clone, Copy)]
pub(crate) struct JointMotion<T> {
    pub(crate) shape: Shape,
    /// Rotation from the parent's frame to the joint's, row-major.
    pub(crate) inverse: [f64; 9],
    pub(crate) cosine: T,
    pub(crate) sine: T,
    /// Origin of the link in the parent's frame.
    pub(crate) origin: Vector<T>,
}

/// What a joint's position changes, at a batch of samples: cosine and sine, or the origin of a link that slides.
pub(crate) type JointSlots = [Slot; 3];

impl<T: Lane> JointMotion<T> {
    /// The joint at position zero; `shape` is the link's, as a constant where it is one.
    #[inline(always)]
    pub(crate) fn rest(shape: Shape, link: &Link) -> Self {
        let (cosine, sine) = (T::splat(1.0), T::splat(0.0));
        JointMotion { shape, inverse: link.inverse, cosine, sine, origin: link.translation.map(T::splat) }
    }

    #[inline(always)]
    pub(crate) fn at(mut self, q: T) -> Self {
        if self.slides() {
            // The joint's z in the parent's frame is the last row of the inverse rotation.
            self.origin = core::array::from_fn(|e| T::splat(self.inverse[6 + e]).fma(q, self.origin[e]));
        } else {
            (self.sine, self.cosine) = sin_cos(q);
        }
        self
    }

    /// Keep what the position changes.
    ///
    /// # Safety
    /// A lane from `k` on is inside the slots.
    #[inline(always)]
    pub(crate) unsafe fn keep(&self, slots: *mut Slot, k: usize) {
        unsafe {
            match self.slides() {
                true => store(slots, k, self.origin),
                false => store(slots, k, [self.cosine, self.sine]),
            }
        }
    }

    /// The joint where it was kept.
    ///
    /// # Safety
    /// As for [`JointMotion::keep`].
    #[inline(always)]
    pub(crate) unsafe fn kept(mut self, slots: *const Slot, k: usize) -> Self {
        unsafe {
            match self.slides() {
                true => self.origin = load(slots, k),
                false => [self.cosine, self.sine] = load(slots, k),
            }
        }
        self
    }

    #[inline(always)]
    pub(crate) fn slides(&self) -> bool {
        self.shape.way == Way::Slides
    }

    /// A vector of the parent's frame in the link's.
    #[inline(always)]
    pub(crate) fn rotate(&self, v: Vector<T>) -> Vector<T> {
        let r = |k: usize| T::splat(self.inverse[k]);
        let row = |k: usize| v[2].fma(r(k + 2), v[1].fma(r(k + 1), v[0].mul(r(k))));
        let [x, y, z] = match self.shape.turn {
            Turn::Identity => v,
            Turn::AboutX => [v[0], v[2], v[1].neg()],
            Turn::AboutMinusX => [v[0], v[2].neg(), v[1]],
            Turn::General => [row(0), row(3), row(6)],
        };
        if self.slides() {
            return [x, y, z];
        }
        [x.fma(self.cosine, y.mul(self.sine)), x.fnma(self.sine, y.mul(self.cosine)), z]
    }

    /// The parent's axis of a coordinate (angular x, linear u) carried to this link.
    #[inline(always)]
    pub(crate) fn carry(&self, (x, u): (Vector<T>, Vector<T>)) -> (Vector<T>, Vector<T>) {
        let at_origin = if self.shape.way == Way::TurnsInPlace { u } else { cross_add(x, self.origin, u) };
        (self.rotate(x), self.rotate(at_origin))
    }

    /// The vector, at the parent's origin, that a field `b r + a` has at the link's, in the link's frame.
    #[inline(always)]
    pub(crate) fn carry_field(&self, a: Vector<T>, b: impl FnOnce() -> [T; 9]) -> Vector<T> {
        if self.shape.way == Way::TurnsInPlace {
            return self.rotate(a);
        }
        let (b, p) = (b(), self.origin);
        let row = |k: usize| b[3 * k + 2].fma(p[2], b[3 * k + 1].fma(p[1], b[3 * k].fma(p[0], a[k])));
        self.rotate([row(0), row(1), row(2)])
    }

    /// Where the joint's z points in the parent's frame.
    #[inline(always)]
    pub(crate) fn along(&self) -> Vector<T> {
        core::array::from_fn(|e| T::splat(self.inverse[6 + e]))
    }

    /// Origin of the link in the parent's frame; none where it is the parent's own.
    #[inline(always)]
    pub(crate) fn moved_by(&self) -> Option<Vector<T>> {
        (self.shape.way != Way::TurnsInPlace).then_some(self.origin)
    }

    /// A vector of the link's frame in the parent's: [`JointMotion::rotate`] backwards.
    #[inline(always)]
    pub(crate) fn rotate_back(&self, v: Vector<T>) -> Vector<T> {
        let [x, y, z] = match self.slides() {
            true => v,
            false => [v[1].fnma(self.sine, v[0].mul(self.cosine)), v[1].fma(self.cosine, v[0].mul(self.sine)), v[2]],
        };
        let r = |k: usize| T::splat(self.inverse[k]);
        let column = |k: usize| z.fma(r(k + 6), y.fma(r(k + 3), x.mul(r(k))));
        match self.shape.turn {
            Turn::Identity => [x, y, z],
            Turn::AboutX => [x, z.neg(), y],
            Turn::AboutMinusX => [x, z, y.neg()],
            Turn::General => [column(0), column(1), column(2)],
        }
    }

    /// An axis with the joint's own motion added, at a rate.
    #[inline(always)]
    pub(crate) fn moved(&self, (mut x, mut u): (Vector<T>, Vector<T>), rate: T) -> (Vector<T>, Vector<T>) {
        let own = if self.slides() { &mut u[2] } else { &mut x[2] };
        *own = own.add(rate);
        (x, u)
    }

    /// The axis of a coordinate that moves this joint and no joint before it.
    #[inline(always)]
    pub(crate) fn own(&self, rate: T) -> (Vector<T>, Vector<T>) {
        let along = [T::splat(0.0), T::splat(0.0), rate];
        if self.slides() { (zero(), along) } else { (along, zero()) }
    }
}
