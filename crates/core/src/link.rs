//! One link in lanes: its motion from its parent's, and its wrench contracted with an axis.

use crate::lane::{Lane, sin_cos};
use crate::mechanism::{LINK_PARAMETERS, Link, Mechanism, Turn};
use crate::vector::{Vector, cross, cross_add, dot, zero};

/// Motion of a link, in its own frame.
#[derive(Clone, Copy)]
pub(crate) struct LinkMotion<T> {
    /// Angular velocity and acceleration.
    pub(crate) w: Vector<T>,
    pub(crate) wd: Vector<T>,
    /// Acceleration of the origin less gravity.
    pub(crate) a: Vector<T>,
    /// `skew(wd) + skew(w)^2`, row-major.
    pub(crate) b: [T; 9],
}

/// Numbers of a [`LinkMotion`].
pub(crate) const LINK_NUMBERS: usize = 18;

impl<T: Lane> LinkMotion<T> {
    #[inline(always)]
    pub(crate) fn flat(&self) -> [T; LINK_NUMBERS] {
        let mut flat = [T::splat(0.0); LINK_NUMBERS];
        flat[..3].copy_from_slice(&self.w);
        flat[3..6].copy_from_slice(&self.wd);
        flat[6..9].copy_from_slice(&self.a);
        flat[9..].copy_from_slice(&self.b);
        flat
    }

    #[inline(always)]
    pub(crate) fn of(m: [T; LINK_NUMBERS]) -> LinkMotion<T> {
        let b = core::array::from_fn(|e| m[9 + e]);
        LinkMotion { w: [m[0], m[1], m[2]], wd: [m[3], m[4], m[5]], a: [m[6], m[7], m[8]], b }
    }
}

/// A joint at one position: how vectors of the parent's frame look in the link's, and where the link's origin is.
pub(crate) struct JointMotion<T> {
    cosine: T,
    sine: T,
    /// Origin of the link in the parent's frame.
    origin: Vector<T>,
}

impl<T: Lane> JointMotion<T> {
    #[inline(always)]
    pub(crate) fn new(link: &Link, q: T) -> Self {
        let p = link.translation.map(T::splat);
        if link.prismatic {
            // The joint's z in the parent's frame is the last row of the inverse rotation.
            let z = [link.inverse[6], link.inverse[7], link.inverse[8]].map(T::splat);
            let origin = core::array::from_fn(|e| z[e].fma(q, p[e]));
            JointMotion { cosine: T::splat(1.0), sine: T::splat(0.0), origin }
        } else {
            let (sine, cosine) = sin_cos(q);
            JointMotion { cosine, sine, origin: p }
        }
    }

    /// A vector of the parent's frame in the link's.
    #[inline(always)]
    pub(crate) fn rotate(&self, link: &Link, v: Vector<T>) -> Vector<T> {
        let r = &link.inverse;
        let row = |k: usize| v[2].fma(T::splat(r[k + 2]), v[1].fma(T::splat(r[k + 1]), v[0].mul(T::splat(r[k]))));
        let [x, y, z] = match link.turn {
            Turn::Identity => v,
            Turn::AboutX => [v[0], v[2], v[1].neg()],
            Turn::AboutMinusX => [v[0], v[2].neg(), v[1]],
            Turn::General => [row(0), row(3), row(6)],
        };
        if link.prismatic {
            return [x, y, z];
        }
        [x.fma(self.cosine, y.mul(self.sine)), x.fnma(self.sine, y.mul(self.cosine)), z]
    }

    /// The parent's axis of a coordinate (angular x, linear u) carried to this link, with the joint's own rate added.
    #[inline(always)]
    pub(crate) fn carry(&self, link: &Link, x: Vector<T>, u: Vector<T>, rate: T) -> (Vector<T>, Vector<T>) {
        let at_origin = if link.displaced { cross_add(x, self.origin, u) } else { u };
        let (mut x, mut u) = (self.rotate(link, x), self.rotate(link, at_origin));
        let own = if link.prismatic { &mut u[2] } else { &mut x[2] };
        *own = own.add(rate);
        (x, u)
    }

    /// The axis of a coordinate that moves this joint and no joint before it.
    #[inline(always)]
    pub(crate) fn own(&self, link: &Link, rate: T) -> (Vector<T>, Vector<T>) {
        let z = T::splat(0.0);
        let along = [z, z, rate];
        if link.prismatic { (zero(), along) } else { (along, zero()) }
    }
}

/// Forward recursion of Newton and Euler in the link's frame (Khalil and Dombre 2002, section 9.5).
#[inline(always)]
pub(crate) fn link_motion<T: Lane>(
    mechanism: &Mechanism,
    link: &Link,
    joint: &JointMotion<T>,
    parent: Option<LinkMotion<T>>,
    v: T,
    acceleration: T,
) -> LinkMotion<T> {
    let (mut w, mut wd, mut a);
    match parent {
        None => {
            (w, wd) = (zero(), zero());
            a = joint.rotate(link, mechanism.gravity.map(|g| T::splat(-g)));
        }
        Some(parent) => {
            w = joint.rotate(link, parent.w);
            wd = joint.rotate(link, parent.wd);
            let (b, p) = (&parent.b, joint.origin);
            let row = |k: usize| b[3 * k + 2].fma(p[2], b[3 * k + 1].fma(p[1], b[3 * k].fma(p[0], parent.a[k])));
            a = joint.rotate(link, if link.displaced { [row(0), row(1), row(2)] } else { parent.a });
        }
    }
    if link.prismatic {
        let twice = v.add(v);
        a = [w[1].fma(twice, a[0]), w[0].fnma(twice, a[1]), a[2].add(acceleration)];
    } else {
        wd = [w[1].fma(v, wd[0]), w[0].fnma(v, wd[1]), wd[2].add(acceleration)];
        w[2] = w[2].add(v);
    }
    let (xx, yy, zz) = (w[0].mul(w[0]), w[1].mul(w[1]), w[2].mul(w[2]));
    let (xy, xz, yz) = (w[0].mul(w[1]), w[0].mul(w[2]), w[1].mul(w[2]));
    let b = [
        yy.add(zz).neg(),
        xy.sub(wd[2]),
        xz.add(wd[1]),
        xy.add(wd[2]),
        xx.add(zz).neg(),
        yz.sub(wd[0]),
        xz.sub(wd[1]),
        yz.add(wd[0]),
        xx.add(yy).neg(),
    ];
    LinkMotion { w, wd, a, b }
}

/// The wrench of a link's ten unit parameters, contracted with an axis (angular x, linear u).
#[inline(always)]
pub(crate) fn contract<T: Lane>(m: &LinkMotion<T>, x: Vector<T>, u: Vector<T>) -> [T; LINK_PARAMETERS] {
    let (w, wd, b) = (m.w, m.wd, &m.b);
    let y = cross(x, w);
    let h = cross(m.a, x);
    let moment = |k: usize| b[k].fma(u[0], b[k + 3].fma(u[1], b[k + 6].fma(u[2], h[k])));
    let mixed = |i: usize, j: usize| x[i].fma(wd[j], x[j].fma(wd[i], y[i].fma(w[j], y[j].mul(w[i]))));
    let square = |i: usize| x[i].fma(wd[i], y[i].mul(w[i]));
    [
        square(0),
        mixed(0, 1),
        mixed(0, 2),
        square(1),
        mixed(1, 2),
        square(2),
        moment(0),
        moment(1),
        moment(2),
        dot(u, m.a),
    ]
}

/// [`contract`] for a pure rotation about the link's own z.
#[inline(always)]
pub(crate) fn contract_turn<T: Lane>(m: &LinkMotion<T>, rate: T) -> [T; LINK_PARAMETERS] {
    let (w, wd, a) = (m.w, m.wd, m.a);
    let xy = w[0].mul(w[1]).mul(rate);
    [
        xy.neg(),
        w[0].mul(w[0]).sub(w[1].mul(w[1])).mul(rate),
        w[1].fnma(w[2], wd[0]).mul(rate),
        xy,
        w[0].fma(w[2], wd[1]).mul(rate),
        wd[2].mul(rate),
        a[1].mul(rate),
        a[0].neg().mul(rate),
        T::splat(0.0),
        T::splat(0.0),
    ]
}

/// [`contract`] for a pure translation along the link's own z.
#[inline(always)]
pub(crate) fn contract_slide<T: Lane>(m: &LinkMotion<T>, rate: T) -> [T; LINK_PARAMETERS] {
    let z = T::splat(0.0);
    let b = &m.b;
    [z, z, z, z, z, z, b[6].mul(rate), b[7].mul(rate), b[8].mul(rate), m.a[2].mul(rate)]
}
