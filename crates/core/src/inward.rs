//! One joint in lanes, towards the base: how wrenches and inertias of the link's frame look in the parent's.

use crate::joint::JointMotion;
use crate::lane::Lane;
use crate::mechanism::{LINK_PARAMETERS, Turn, Way};
use crate::vector::{Vector, cross, cross_add};

/// Angular velocity and acceleration of a link, and acceleration of its origin less gravity, in its own frame.
pub(crate) type Moving<T> = [Vector<T>; 3];

/// A symmetric tensor: XX XY XZ YY YZ ZZ.
type Tensor<T> = [T; 6];

impl<T: Lane> JointMotion<T> {
    #[inline(always)]
    fn in_place(&self) -> bool {
        self.shape.way == Way::TurnsInPlace
    }

    /// The motion that a link would have if its joint stood still, from the parent's.
    #[inline(always)]
    pub(crate) fn carry_motion(&self, [w, wd, a]: Moving<T>) -> Moving<T> {
        let p = self.origin;
        let a = if self.in_place() { a } else { cross_add(wd, p, cross_add(w, cross(w, p), a)) };
        [self.rotate(w), self.rotate(wd), self.rotate(a)]
    }

    /// A vector of the link's frame in the parent's.
    #[inline(always)]
    pub(crate) fn unrotate(&self, v: Vector<T>) -> Vector<T> {
        let (c, s, [x, y, z]) = (self.cosine, self.sine, v);
        let v = if self.slides() { v } else { [s.fnma(y, x.mul(c)), s.fma(x, y.mul(c)), z] };
        let r = |k: usize| T::splat(self.inverse[k]);
        let column = |k: usize| v[2].fma(r(k + 6), v[1].fma(r(k + 3), v[0].mul(r(k))));
        match self.shape.turn {
            Turn::Identity => v,
            Turn::AboutX => [v[0], v[2].neg(), v[1]],
            Turn::AboutMinusX => [v[0], v[2], v[1].neg()],
            Turn::General => [column(0), column(1), column(2)],
        }
    }

    /// A wrench on the link, moment and force, seen from the parent.
    #[inline(always)]
    pub(crate) fn carry_wrench(&self, (n, f): (Vector<T>, Vector<T>)) -> (Vector<T>, Vector<T>) {
        let (n, f) = (self.unrotate(n), self.unrotate(f));
        (if self.in_place() { n } else { cross_add(self.origin, f, n) }, f)
    }

    /// The ten parameters of a body of the link, seen from the parent.
    #[inline(always)]
    pub(crate) fn carry_body(&self, body: [T; LINK_PARAMETERS]) -> [T; LINK_PARAMETERS] {
        let [xx, xy, xz, yy, yz, zz, x, y, z, m] = body;
        let first = self.unrotate([x, y, z]);
        let tensor = self.unturn(if self.slides() { [xx, xy, xz, yy, yz, zz] } else { self.unspin(&body) });
        let (tensor, first) = if self.in_place() { (tensor, first) } else { self.shifted(tensor, first, m) };
        let ([xx, xy, xz, yy, yz, zz], [x, y, z]) = (tensor, first);
        [xx, xy, xz, yy, yz, zz, x, y, z, m]
    }

    /// The tensor before the joint's own turn about z.
    #[inline(always)]
    fn unspin(&self, [xx, xy, xz, yy, yz, zz, ..]: &[T; LINK_PARAMETERS]) -> Tensor<T> {
        let (c, s) = (self.cosine, self.sine);
        // Sum of xx and yy stays; c t - xy is the new xy, as 2 c^2 - 1 is the cosine of twice the angle.
        let t = s.fma(xx.sub(*yy), c.add(c).mul(*xy));
        let (xz, yz) = (s.fnma(*yz, c.mul(*xz)), s.fma(*xz, c.mul(*yz)));
        [s.fnma(t, *xx), c.fma(t, xy.neg()), xz, s.fma(t, *yy), yz, *zz]
    }

    /// The tensor before the joint's constant rotation.
    #[inline(always)]
    fn unturn(&self, tensor: Tensor<T>) -> Tensor<T> {
        let [xx, xy, xz, yy, yz, zz] = tensor;
        match self.shape.turn {
            Turn::Identity => tensor,
            Turn::AboutX => [xx, xz.neg(), xy, zz, yz.neg(), yy],
            Turn::AboutMinusX => [xx, xz, xy.neg(), zz, yz.neg(), yy],
            Turn::General => {
                // Rows of the tensor times the rotation's transpose, whose rows are columns of the inverse.
                let r = |k: usize| T::splat(self.inverse[k]);
                let along = |v: Vector<T>, k: usize| v[2].fma(r(k + 6), v[1].fma(r(k + 3), v[0].mul(r(k))));
                let turned = |row: Vector<T>| [along(row, 0), along(row, 1), along(row, 2)];
                let (x, y, z) = (turned([xx, xy, xz]), turned([xy, yy, yz]), turned([xz, yz, zz]));
                let entry = |a: usize, b: usize| along([x[b], y[b], z[b]], a);
                [entry(0, 0), entry(0, 1), entry(0, 2), entry(1, 1), entry(1, 2), entry(2, 2)]
            }
        }
    }

    /// Tensor and first moments about the parent's origin, from those about the link's.
    #[inline(always)]
    fn shifted(&self, tensor: Tensor<T>, first: Vector<T>, m: T) -> (Tensor<T>, Vector<T>) {
        let (p, [xx, xy, xz, yy, yz, zz], half) = (self.origin, tensor, m.mul(T::splat(0.5)));
        // The shift adds 2 (g . p) - g p' - p g', with g halfway between the first moments before and after.
        let g: Vector<T> = core::array::from_fn(|e| half.fma(p[e], first[e]));
        let twice = p.map(|p| p.add(p));
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
        (tensor, core::array::from_fn(|e| m.fma(p[e], first[e])))
    }
}
