//! One link's momentum in lanes: its velocity from its parent's, contracted with an axis and with the axis's own rate.
//!
//! With the axes s_i^a of the coordinates carried to the links, generalised momentum is `p_a = sum_i s_i^a . h_i`, and
//! `tau_a = d/dt p_a - sum_i (d/dt s_i^a) . h_i + gravity`: no acceleration is left. In the link's own frame the rate
//! of an axis follows the recursion of the axis itself, `sd_i = X_i sd_parent + v_i x (G[i, a] z)` (Featherstone 2008,
//! section 2.9); where G changes with position, `dG/dt[i, a] z` is added there.

use crate::batch::{Slot, load, store};
use crate::lane::Lane;
use crate::link::JointMotion;
use crate::mechanism::{LINK_PARAMETERS, Link, Mechanism};
use crate::vector::{Vector, cross, dot, zero};

/// Velocity of a link, in its own frame.
#[derive(Clone, Copy)]
pub(crate) struct LinkVelocity<T> {
    /// Angular velocity, and velocity of the origin.
    pub(crate) w: Vector<T>,
    pub(crate) v: Vector<T>,
    /// Acceleration of the base less gravity: minus gravity, seen from the link.
    pub(crate) a: Vector<T>,
}

/// Numbers of a [`LinkVelocity`].
pub(crate) const VELOCITY_NUMBERS: usize = 9;

/// # Safety
/// Of both methods: the pointer is to [`VELOCITY_NUMBERS`] slots, and a lane from `k` on is inside them.
impl<T: Lane> LinkVelocity<T> {
    #[inline(always)]
    pub(crate) unsafe fn store(&self, slots: *mut Slot, k: usize) {
        let LinkVelocity { w, v, a } = self;
        unsafe { store(slots, k, [w[0], w[1], w[2], v[0], v[1], v[2], a[0], a[1], a[2]]) }
    }

    #[inline(always)]
    pub(crate) unsafe fn at(slots: *const Slot, k: usize) -> LinkVelocity<T> {
        let m: [T; VELOCITY_NUMBERS] = unsafe { load(slots, k) };
        LinkVelocity { w: [m[0], m[1], m[2]], v: [m[3], m[4], m[5]], a: [m[6], m[7], m[8]] }
    }
}

/// Velocity of a link whose joint moves with `rate`.
#[inline(always)]
pub(crate) fn link_velocity<T: Lane>(
    mechanism: &Mechanism,
    link: &Link,
    joint: &JointMotion<T>,
    parent: Option<LinkVelocity<T>>,
    rate: T,
) -> LinkVelocity<T> {
    match parent {
        None => {
            let (w, v) = JointMotion::own(link, rate);
            LinkVelocity { w, v, a: joint.rotate(link, mechanism.gravity.map(|g| T::splat(-g))) }
        }
        Some(parent) => {
            let (w, v) = joint.carry(link, parent.w, parent.v, rate);
            LinkVelocity { w, v, a: joint.rotate(link, parent.a) }
        }
    }
}

/// Rate of change of an axis, from that of the same coordinate's axis on the parent (`above`), the joint's own rate with
/// the coordinate, and the change of that.
#[inline(always)]
pub(crate) fn axis_rate<T: Lane>(
    m: &LinkVelocity<T>,
    link: &Link,
    joint: &JointMotion<T>,
    above: Option<(Vector<T>, Vector<T>)>,
    rate: Option<T>,
    change: Option<T>,
) -> (Vector<T>, Vector<T>) {
    let (mut x, mut u) = match above {
        Some((x, u)) => joint.carry(link, x, u, T::splat(0.0)),
        None => (zero(), zero()),
    };
    if let Some(rate) = rate {
        // The cross products of the link's velocity with its joint's axis: of an angular axis both parts turn.
        if link.slides() {
            u = about_z(m.w, rate, u);
        } else {
            (x, u) = (about_z(m.w, rate, x), about_z(m.v, rate, u));
        }
    }
    if let Some(change) = change {
        let own = if link.slides() { &mut u[2] } else { &mut x[2] };
        *own = own.add(change);
    }
    (x, u)
}

/// `c + rate * (a x z)`
#[inline(always)]
fn about_z<T: Lane>(a: Vector<T>, rate: T, c: Vector<T>) -> Vector<T> {
    [a[1].fma(rate, c[0]), a[0].fnma(rate, c[1]), c[2]]
}

/// The momentum of a link's ten unit parameters, contracted with an axis (angular x, linear u).
#[inline(always)]
pub(crate) fn contract_momentum<T: Lane>(m: &LinkVelocity<T>, x: Vector<T>, u: Vector<T>) -> [T; LINK_PARAMETERS] {
    let (w, v) = (m.w, m.v);
    let (turned, moved) = (cross(v, x), cross(u, w));
    let mixed = |i: usize, j: usize| x[i].fma(w[j], x[j].mul(w[i]));
    let moment = |k: usize| turned[k].add(moved[k]);
    [
        x[0].mul(w[0]),
        mixed(0, 1),
        mixed(0, 2),
        x[1].mul(w[1]),
        mixed(1, 2),
        x[2].mul(w[2]),
        moment(0),
        moment(1),
        moment(2),
        dot(u, v),
    ]
}

/// What is left of a link's torque beside the change of its momentum: gravity on the axis, less the momentum
/// contracted with the axis's rate (angular xd, linear ud).
#[inline(always)]
pub(crate) fn contract_rest<T: Lane>(
    m: &LinkVelocity<T>,
    (x, u): (Vector<T>, Vector<T>),
    (xd, ud): (Vector<T>, Vector<T>),
) -> [T; LINK_PARAMETERS] {
    let mut rest = contract_momentum(m, xd, ud).map(T::neg);
    let weight = cross(m.a, x);
    for k in 0..3 {
        rest[6 + k] = rest[6 + k].add(weight[k]);
    }
    rest[9] = rest[9].add(dot(u, m.a));
    rest
}
