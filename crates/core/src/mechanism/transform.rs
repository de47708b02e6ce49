//! Coordinate transforms of one joint, in lanes: motion vectors from the parent's frame to the link's (X), wrenches and
//! inertias from the link's to the parent's (X').

use crate::linalg::vector::{Vector, cross, cross_add, zero};
use crate::mechanism::shape::{JointShape, JointType, Rotation};
use crate::mechanism::{LINK_PARAMETERS, Link};
use crate::memory::slot::{Slot, load, store};
use crate::simd::elementary::sin_cos;
use crate::simd::inlined;
use crate::simd::lane::Lane;
use crate::simd::token::Simd;

/// The transform of a joint at one position. Where `shape` is a compile-time constant, multiplications by 0 and 1 are
/// removed.
#[derive(Clone, Copy)]
pub(crate) struct JointTransform<T> {
    pub(crate) shape: JointShape,
    /// Rotation matrix from the parent's frame to the joint's, row-major.
    pub(crate) inverse: [f64; 9],
    pub(crate) cosine: T,
    pub(crate) sine: T,
    /// Origin of the link in the parent's frame.
    pub(crate) origin: Vector<T>,
}

/// The part of a transform that depends on the position, at a batch of samples: cosine and sine, or the origin of a
/// prismatic link.
pub(crate) type TransformSlots = [Slot; 3];

impl<T: Lane> JointTransform<T> {
    /// The transform at position zero. `shape` is the link's, as a compile-time constant where it is one.
    #[inline(always)]
    pub(crate) fn at_zero(simd: Simd<T>, shape: JointShape, link: &Link) -> Self {
        let (cosine, sine) = (simd.splat(1.0), simd.splat(0.0));
        JointTransform {
            shape,
            inverse: link.inverse,
            cosine,
            sine,
            origin: inlined::map(link.translation, |x| simd.splat(x)),
        }
    }

    /// The transform at position `q`.
    #[inline(always)]
    pub(crate) fn at(mut self, q: T) -> Self {
        if self.is_prismatic() {
            // The joint's z in the parent's frame is the last row of the inverse rotation.
            self.origin = inlined::from_fn(|e| self.simd().splat(self.inverse[6 + e]).fma(q, self.origin[e]));
        } else {
            (self.sine, self.cosine) = sin_cos(q);
        }
        self
    }

    /// Store what depends on the position.
    ///
    /// # Safety
    ///
    /// `slots` are [`TransformSlots`], and `k + T::WIDTH <= BATCH`.
    #[inline(always)]
    pub(crate) unsafe fn store(&self, slots: *mut Slot, k: usize) {
        // SAFETY: at most three slots are written, which the caller promises.
        unsafe {
            match self.is_prismatic() {
                true => store(slots, k, self.origin),
                false => store(slots, k, [self.cosine, self.sine]),
            }
        }
    }

    /// Load what depends on the position.
    ///
    /// # Safety
    ///
    /// As for [`JointTransform::store`].
    #[inline(always)]
    pub(crate) unsafe fn load(mut self, slots: *const Slot, k: usize) -> Self {
        // SAFETY: at most three slots are read, which the caller promises.
        unsafe {
            match self.is_prismatic() {
                true => self.origin = load(self.simd(), slots, k),
                false => [self.cosine, self.sine] = load(self.simd(), slots, k),
            }
        }
        self
    }

    /// The token of the transform's lanes.
    #[inline(always)]
    fn simd(&self) -> Simd<T> {
        Simd::of(self.cosine)
    }

    #[inline(always)]
    pub(crate) fn is_prismatic(&self) -> bool {
        self.shape.joint_type == JointType::Prismatic
    }

    /// Rotate a vector of the parent's frame to the link's.
    #[inline(always)]
    pub(crate) fn rotate(&self, v: Vector<T>) -> Vector<T> {
        let r = |k: usize| self.simd().splat(self.inverse[k]);
        let row = |k: usize| v[2].fma(r(k + 2), v[1].fma(r(k + 1), v[0].mul(r(k))));
        let [x, y, z] = match self.shape.rotation {
            Rotation::Identity => v,
            Rotation::AboutX => [v[0], v[2], v[1].neg()],
            Rotation::AboutMinusX => [v[0], v[2].neg(), v[1]],
            Rotation::General => [row(0), row(3), row(6)],
        };
        if self.is_prismatic() {
            return [x, y, z];
        }
        [x.fma(self.cosine, y.mul(self.sine)), x.fnma(self.sine, y.mul(self.cosine)), z]
    }

    /// Transform an axis (angular x, linear u) from the parent to this link.
    #[inline(always)]
    pub(crate) fn transform_axis(&self, (x, u): (Vector<T>, Vector<T>)) -> (Vector<T>, Vector<T>) {
        let at_origin =
            if self.shape.joint_type == JointType::RevoluteInPlace { u } else { cross_add(x, self.origin, u) };
        (self.rotate(x), self.rotate(at_origin))
    }

    /// Value at the link's origin of the field `b r + a` about the parent's origin, in the link's frame.
    #[inline(always)]
    pub(crate) fn transform_field(&self, a: Vector<T>, b: impl FnOnce() -> [T; 9]) -> Vector<T> {
        if self.shape.joint_type == JointType::RevoluteInPlace {
            return self.rotate(a);
        }
        let (b, p) = (b(), self.origin);
        let row = |k: usize| b[3 * k + 2].fma(p[2], b[3 * k + 1].fma(p[1], b[3 * k].fma(p[0], a[k])));
        self.rotate([row(0), row(1), row(2)])
    }

    /// The joint's z axis in the parent's frame.
    #[inline(always)]
    pub(crate) fn axis_in_parent(&self) -> Vector<T> {
        inlined::from_fn(|e| self.simd().splat(self.inverse[6 + e]))
    }

    /// Origin of the link in the parent's frame; `None` where it coincides with the parent's.
    #[inline(always)]
    pub(crate) fn offset(&self) -> Option<Vector<T>> {
        (self.shape.joint_type != JointType::RevoluteInPlace).then_some(self.origin)
    }

    /// Transpose of [`JointTransform::rotate`], for adjoints. It differs from [`JointTransform::rotate_to_parent`] in which
    /// product of a sum is rounded first.
    #[inline(always)]
    pub(crate) fn rotate_transposed(&self, v: Vector<T>) -> Vector<T> {
        let [x, y, z] = match self.is_prismatic() {
            true => v,
            false => [v[1].fnma(self.sine, v[0].mul(self.cosine)), v[1].fma(self.cosine, v[0].mul(self.sine)), v[2]],
        };
        let r = |k: usize| self.simd().splat(self.inverse[k]);
        let column = |k: usize| z.fma(r(k + 6), y.fma(r(k + 3), x.mul(r(k))));
        match self.shape.rotation {
            Rotation::Identity => [x, y, z],
            Rotation::AboutX => [x, z.neg(), y],
            Rotation::AboutMinusX => [x, z, y.neg()],
            Rotation::General => [column(0), column(1), column(2)],
        }
    }

    /// Add the joint's own motion, at a rate, to an axis.
    #[inline(always)]
    pub(crate) fn add_joint_rate(&self, (mut x, mut u): (Vector<T>, Vector<T>), rate: T) -> (Vector<T>, Vector<T>) {
        let own = if self.is_prismatic() { &mut u[2] } else { &mut x[2] };
        *own = own.add(rate);
        (x, u)
    }

    /// The axis of a coordinate that moves this joint and none before it.
    #[inline(always)]
    pub(crate) fn joint_axis(&self, rate: T) -> (Vector<T>, Vector<T>) {
        let along = [self.simd().splat(0.0), self.simd().splat(0.0), rate];
        if self.is_prismatic() { (zero(self.simd()), along) } else { (along, zero(self.simd())) }
    }
}

/// Angular velocity and acceleration of a link, and acceleration of its origin minus gravity, in its own frame.
pub(crate) type SpatialMotion<T> = [Vector<T>; 3];

/// A symmetric tensor: XX XY XZ YY YZ ZZ.
type Tensor<T> = [T; 6];

impl<T: Lane> JointTransform<T> {
    #[inline(always)]
    fn in_place(&self) -> bool {
        self.shape.joint_type == JointType::RevoluteInPlace
    }

    /// The motion that the link would have with its joint locked, from the parent's.
    #[inline(always)]
    pub(crate) fn transform_motion(&self, [w, wd, a]: SpatialMotion<T>) -> SpatialMotion<T> {
        let p = self.origin;
        let a = if self.in_place() { a } else { cross_add(wd, p, cross_add(w, cross(w, p), a)) };
        [self.rotate(w), self.rotate(wd), self.rotate(a)]
    }

    /// Rotate a vector of the link's frame to the parent's.
    #[inline(always)]
    pub(crate) fn rotate_to_parent(&self, v: Vector<T>) -> Vector<T> {
        let (c, s, [x, y, z]) = (self.cosine, self.sine, v);
        let v = if self.is_prismatic() { v } else { [s.fnma(y, x.mul(c)), s.fma(x, y.mul(c)), z] };
        let r = |k: usize| self.simd().splat(self.inverse[k]);
        let column = |k: usize| v[2].fma(r(k + 6), v[1].fma(r(k + 3), v[0].mul(r(k))));
        match self.shape.rotation {
            Rotation::Identity => v,
            Rotation::AboutX => [v[0], v[2].neg(), v[1]],
            Rotation::AboutMinusX => [v[0], v[2], v[1].neg()],
            Rotation::General => [column(0), column(1), column(2)],
        }
    }

    /// A wrench on the link, moment and force, at the parent's origin in the parent's frame.
    #[inline(always)]
    pub(crate) fn wrench_to_parent(&self, (n, f): (Vector<T>, Vector<T>)) -> (Vector<T>, Vector<T>) {
        let (n, f) = (self.rotate_to_parent(n), self.rotate_to_parent(f));
        (if self.in_place() { n } else { cross_add(self.origin, f, n) }, f)
    }

    /// The ten inertial parameters of a body on the link, about the parent's origin in the parent's frame.
    #[inline(always)]
    pub(crate) fn inertia_to_parent(&self, body: [T; LINK_PARAMETERS]) -> [T; LINK_PARAMETERS] {
        let [xx, xy, xz, yy, yz, zz, x, y, z, m] = body;
        let first = self.rotate_to_parent([x, y, z]);
        let tensor = self.unrotate_constant(if self.is_prismatic() {
            [xx, xy, xz, yy, yz, zz]
        } else {
            self.unrotate_about_z(&body)
        });
        let (tensor, first) = if self.in_place() { (tensor, first) } else { self.shift_inertia(tensor, first, m) };
        let ([xx, xy, xz, yy, yz, zz], [x, y, z]) = (tensor, first);
        [xx, xy, xz, yy, yz, zz, x, y, z, m]
    }

    /// Tensor before the joint's rotation about z.
    #[inline(always)]
    fn unrotate_about_z(&self, [xx, xy, xz, yy, yz, zz, ..]: &[T; LINK_PARAMETERS]) -> Tensor<T> {
        let (c, s) = (self.cosine, self.sine);
        // The trace of the first block is invariant; c t - xy is the new xy, since 2 c^2 - 1 is the cosine of twice the
        // angle.
        let t = s.fma(xx.sub(*yy), c.add(c).mul(*xy));
        let (xz, yz) = (s.fnma(*yz, c.mul(*xz)), s.fma(*xz, c.mul(*yz)));
        [s.fnma(t, *xx), c.fma(t, xy.neg()), xz, s.fma(t, *yy), yz, *zz]
    }

    /// Tensor before the constant rotation.
    #[inline(always)]
    fn unrotate_constant(&self, tensor: Tensor<T>) -> Tensor<T> {
        let [xx, xy, xz, yy, yz, zz] = tensor;
        match self.shape.rotation {
            Rotation::Identity => tensor,
            Rotation::AboutX => [xx, xz.neg(), xy, zz, yz.neg(), yy],
            Rotation::AboutMinusX => [xx, xz, xy.neg(), zz, yz.neg(), yy],
            Rotation::General => {
                // Rows of the tensor times the transpose of the rotation, whose rows are columns of the inverse.
                let r = |k: usize| self.simd().splat(self.inverse[k]);
                let along = |v: Vector<T>, k: usize| v[2].fma(r(k + 6), v[1].fma(r(k + 3), v[0].mul(r(k))));
                let turned = |row: Vector<T>| [along(row, 0), along(row, 1), along(row, 2)];
                let (x, y, z) = (turned([xx, xy, xz]), turned([xy, yy, yz]), turned([xz, yz, zz]));
                let entry = |a: usize, b: usize| along([x[b], y[b], z[b]], a);
                [entry(0, 0), entry(0, 1), entry(0, 2), entry(1, 1), entry(1, 2), entry(2, 2)]
            }
        }
    }

    /// Parallel-axis theorem: tensor and first moments about the parent's origin, from those about the link's.
    #[inline(always)]
    fn shift_inertia(&self, tensor: Tensor<T>, first: Vector<T>, m: T) -> (Tensor<T>, Vector<T>) {
        let (p, [xx, xy, xz, yy, yz, zz], half) = (self.origin, tensor, m.mul(self.simd().splat(0.5)));
        // The shift adds 2 (g . p) - g p' - p g', with g halfway between the first moments before and after it.
        let g: Vector<T> = inlined::from_fn(|e| half.fma(p[e], first[e]));
        let twice = inlined::map(p, |p| p.add(p));
        let diagonal = |x: T, i: usize, j: usize| g[i].fma(twice[i], g[j].fma(twice[j], x));
        let mixed = |x: T, i: usize, j: usize| g[i].fnma(p[j], g[j].fnma(p[i], x));
        let tensor = [
            diagonal(xx, 1, 2),
            mixed(xy, 0, 1),
            mixed(xz, 0, 2),
            diagonal(yy, 0, 2),
            mixed(yz, 1, 2),
            diagonal(zz, 0, 1),
        ];
        (tensor, inlined::from_fn(|e| m.fma(p[e], first[e])))
    }
}
