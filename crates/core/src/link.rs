//! One link in lanes: its motion from its parent's, and its wrench contracted with an axis.

use crate::batch::{Slot, load, store};
use crate::lane::{Lane, sin_cos};
use crate::mechanism::{LINK_PARAMETERS, Link, Mechanism, Shape, Turn, Way};
use crate::places::{MASS, MOMENT, Sink, TENSOR};
use crate::vector::{Vector, cross, cross_add, dot, zero};

/// Motion of a link, in its own frame.
#[derive(Clone, Copy)]
pub(crate) struct LinkMotion<T> {
    /// Angular velocity and acceleration.
    w: Vector<T>,
    wd: Vector<T>,
    /// Acceleration of the origin less gravity.
    a: Vector<T>,
    /// `skew(wd) + skew(w)^2`, row-major.
    b: [T; 9],
}

/// Numbers of a [`LinkMotion`], and where its parts begin.
pub(crate) const LINK_NUMBERS: usize = 18;
const W: usize = 0;
const WD: usize = 3;
const A: usize = 6;
const B: usize = 9;

/// Motions of one link at a batch of samples. Parts are read when they are needed: few fit into the registers.
#[derive(Clone, Copy)]
pub(crate) struct LinkMotions(pub(crate) *mut Slot);

/// # Safety
/// Of every method: the pointer is to [`LINK_NUMBERS`] slots, and a lane from `k` on is inside them.
impl LinkMotions {
    #[inline(always)]
    unsafe fn part<T: Lane, const N: usize>(&self, part: usize, k: usize) -> [T; N] {
        unsafe { load(self.0.add(part), k) }
    }

    #[inline(always)]
    pub(crate) unsafe fn at<T: Lane>(&self, k: usize) -> LinkMotion<T> {
        unsafe { LinkMotion { w: self.part(W, k), wd: self.part(WD, k), a: self.part(A, k), b: self.part(B, k) } }
    }

    #[inline(always)]
    pub(crate) unsafe fn set<T: Lane>(&self, k: usize, m: LinkMotion<T>) {
        unsafe {
            store(self.0.add(W), k, m.w);
            store(self.0.add(WD), k, m.wd);
            store(self.0.add(A), k, m.a);
            store(self.0.add(B), k, m.b);
        }
    }
}

/// A joint at one position: how vectors of the parent's frame look in the link's, and where the link's origin is.
pub(crate) struct JointMotion<T> {
    cosine: T,
    sine: T,
    /// Origin of the link in the parent's frame.
    origin: Vector<T>,
}

/// What a joint's position changes, at a batch of samples: cosine and sine, or the origin of a link that slides.
pub(crate) type JointSlots = [Slot; 3];

impl<T: Lane> JointMotion<T> {
    #[inline(always)]
    pub(crate) fn new(link: &Link, q: T) -> Self {
        let p = link.translation.map(T::splat);
        if link.slides() {
            // The joint's z in the parent's frame is the last row of the inverse rotation.
            let z = [link.inverse[6], link.inverse[7], link.inverse[8]].map(T::splat);
            let origin = core::array::from_fn(|e| z[e].fma(q, p[e]));
            JointMotion { cosine: T::splat(1.0), sine: T::splat(0.0), origin }
        } else {
            let (sine, cosine) = sin_cos(q);
            JointMotion { cosine, sine, origin: p }
        }
    }

    /// # Safety
    /// A lane from `k` on is inside the slots.
    #[inline(always)]
    pub(crate) unsafe fn at(shape: Shape, link: &Link, slots: &JointSlots, k: usize) -> Self {
        let kept: [T; 3] = unsafe { load(slots.as_ptr(), k) };
        if shape.way == Way::Slides {
            JointMotion { cosine: T::splat(1.0), sine: T::splat(0.0), origin: kept }
        } else {
            JointMotion { cosine: kept[0], sine: kept[1], origin: link.translation.map(T::splat) }
        }
    }

    /// Keep it for the axes.
    ///
    /// # Safety
    /// As for [`JointMotion::at`].
    #[inline(always)]
    pub(crate) unsafe fn keep(&self, link: &Link, slots: &mut JointSlots, k: usize) {
        let kept = if link.slides() { self.origin } else { [self.cosine, self.sine, self.cosine] };
        unsafe { store(slots.as_mut_ptr(), k, kept) }
    }

    /// A vector of the parent's frame in the link's.
    #[inline(always)]
    pub(crate) fn rotate(&self, link: &Link, v: Vector<T>) -> Vector<T> {
        self.rotate_by(link.shape, link, v)
    }

    /// [`JointMotion::rotate`], for a link whose shape is known to the compiler.
    #[inline(always)]
    pub(crate) fn rotate_by(&self, shape: Shape, link: &Link, v: Vector<T>) -> Vector<T> {
        let r = &link.inverse;
        let row = |k: usize| v[2].fma(T::splat(r[k + 2]), v[1].fma(T::splat(r[k + 1]), v[0].mul(T::splat(r[k]))));
        let [x, y, z] = match shape.turn {
            Turn::Identity => v,
            Turn::AboutX => [v[0], v[2], v[1].neg()],
            Turn::AboutMinusX => [v[0], v[2].neg(), v[1]],
            Turn::General => [row(0), row(3), row(6)],
        };
        if shape.way == Way::Slides {
            return [x, y, z];
        }
        [x.fma(self.cosine, y.mul(self.sine)), x.fnma(self.sine, y.mul(self.cosine)), z]
    }

    /// The parent's axis of a coordinate (angular x, linear u) carried to this link, with the joint's own rate added.
    #[inline(always)]
    pub(crate) fn carry(&self, link: &Link, x: Vector<T>, u: Vector<T>, rate: T) -> (Vector<T>, Vector<T>) {
        self.carry_by(link.shape, link, (x, u), rate)
    }

    /// [`JointMotion::carry`], for a link whose shape is known to the compiler.
    #[inline(always)]
    pub(crate) fn carry_by(
        &self,
        shape: Shape,
        link: &Link,
        (x, u): (Vector<T>, Vector<T>),
        rate: T,
    ) -> (Vector<T>, Vector<T>) {
        let at_origin = if shape.way == Way::TurnsInPlace { u } else { cross_add(x, self.origin, u) };
        let (mut x, mut u) = (self.rotate_by(shape, link, x), self.rotate_by(shape, link, at_origin));
        let own = if shape.way == Way::Slides { &mut u[2] } else { &mut x[2] };
        *own = own.add(rate);
        (x, u)
    }

    /// The axis of a coordinate that moves this joint and no joint before it.
    #[inline(always)]
    pub(crate) fn own(link: &Link, rate: T) -> (Vector<T>, Vector<T>) {
        let z = T::splat(0.0);
        let along = [z, z, rate];
        if link.slides() { (zero(), along) } else { (along, zero()) }
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
    let (shape, rotate) = (link.shape, |v| joint.rotate(link, v));
    let (mut w, mut wd, mut a);
    match parent {
        None => {
            (w, wd) = (zero(), zero());
            a = rotate(mechanism.gravity.map(|g| T::splat(-g)));
        }
        Some(parent) => {
            w = rotate(parent.w);
            wd = rotate(parent.wd);
            let (b, p) = (&parent.b, joint.origin);
            let row = |k: usize| b[3 * k + 2].fma(p[2], b[3 * k + 1].fma(p[1], b[3 * k].fma(p[0], parent.a[k])));
            a = rotate(if shape.way == Way::TurnsInPlace { parent.a } else { [row(0), row(1), row(2)] });
        }
    }
    if shape.way == Way::Slides {
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
///
/// # Safety
/// `motions` and the places have a lane from `k` on.
#[inline(always)]
pub(crate) unsafe fn contract<T: Lane>(
    motions: LinkMotions,
    (x, u): (Vector<T>, Vector<T>),
    sink: &Sink,
    out: *mut f64,
    k: usize,
) {
    unsafe {
        if sink.wants(TENSOR) {
            sink.put(out, k, 0, tensor(motions.part(W, k), motions.part(WD, k), x));
        }
        if sink.wants(MOMENT | MASS) {
            let a = motions.part(A, k);
            let (h, b) = (cross(a, x), motions.part::<T, 9>(B, k));
            let moment = |e: usize| b[e].fma(u[0], b[e + 3].fma(u[1], b[e + 6].fma(u[2], h[e])));
            sink.put(out, k, 6, [moment(0), moment(1), moment(2), dot(u, a)]);
        }
    }
}

/// The six entries of the inertia tensor.
#[inline(always)]
fn tensor<T: Lane>(w: Vector<T>, wd: Vector<T>, x: Vector<T>) -> [T; 6] {
    let y = cross(x, w);
    let mixed = |i: usize, j: usize| x[i].fma(wd[j], x[j].fma(wd[i], y[i].fma(w[j], y[j].mul(w[i]))));
    let square = |i: usize| x[i].fma(wd[i], y[i].mul(w[i]));
    [square(0), mixed(0, 1), mixed(0, 2), square(1), mixed(1, 2), square(2)]
}

/// [`contract`] for a pure rotation about the link's own z.
///
/// # Safety
/// As for [`contract`].
#[inline(always)]
pub(crate) unsafe fn contract_turn<T: Lane>(motions: LinkMotions, rate: T, sink: &Sink, out: *mut f64, k: usize) {
    let (w, wd, a): (Vector<T>, Vector<T>, Vector<T>) =
        unsafe { (motions.part(W, k), motions.part(WD, k), motions.part(A, k)) };
    let xy = w[0].mul(w[1]).mul(rate);
    let entries: [T; LINK_PARAMETERS] = [
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
    ];
    unsafe { sink.put(out, k, 0, entries) }
}

/// [`contract`] for a pure translation along the link's own z.
///
/// # Safety
/// As for [`contract`].
#[inline(always)]
pub(crate) unsafe fn contract_slide<T: Lane>(motions: LinkMotions, rate: T, sink: &Sink, out: *mut f64, k: usize) {
    let LinkMotion { a, b, .. } = unsafe { motions.at::<T>(k) };
    let z = T::splat(0.0);
    let entries = [z, z, z, z, z, z, b[6].mul(rate), b[7].mul(rate), b[8].mul(rate), a[2].mul(rate)];
    unsafe { sink.put(out, k, 0, entries) }
}
