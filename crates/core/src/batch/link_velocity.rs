//! Velocity of one link in lanes, and the contraction of its momentum with an axis and with the axis's rate.
//!
//! With the axes s_i^a of the coordinates transformed to the links, the generalised momentum is `p_a = sum_i s_i^a .
//! h_i`, and `tau_a = d/dt p_a - sum_i (d/dt s_i^a) . h_i + gravity`: no acceleration remains. In the link's own frame
//! the rate of an axis follows the recursion of the axis itself, `sd_i = X_i sd_parent + v_i x (G[i, a] z)`
//! (Featherstone 2008, section 2.9); where G varies with the pose, `dG/dt[i, a] z` is added.

use crate::batch::Batch;
use crate::batch::axis::load_axis;
use crate::batch::link::LINK_NUMBERS;
use crate::batch::sink::EntrySink;
use crate::linalg::vector::{Vector, cross, cross_add, cycle, dot};
use crate::mechanism::LINK_PARAMETERS;
use crate::mechanism::transform::JointTransform;
use crate::memory::slot::{Slot, load, store};
use crate::simd::inlined;
use crate::simd::lane::Lane;
use crate::simd::token::Simd;

/// Layout of a link's velocity, in its own frame: angular velocity, velocity of the origin,
pub(crate) const VELOCITY_NUMBERS: usize = 9;
const _: () = assert!(VELOCITY_NUMBERS <= LINK_NUMBERS, "the slots of a link hold its velocity");
const W: usize = 0;
const V: usize = 3;
/// acceleration of the base minus gravity, that is minus gravity, in the link's frame.
const A: usize = 6;

/// Velocities of one link at a batch of samples, by pointer to its slots.
#[derive(Clone, Copy)]
pub(crate) struct LinkVelocities(pub(crate) *mut Slot);

/// # Safety
///
/// Of all methods: the pointer is to [`VELOCITY_NUMBERS`] slots of a workspace, which nobody else uses meanwhile, and
/// `k + T::WIDTH <= BATCH`, or the batch, axes and output runs are as in [`crate::batch`].
impl LinkVelocities {
    #[inline(always)]
    unsafe fn part<T: Lane, const N: usize>(&self, simd: Simd<T>, part: usize, k: usize) -> [T; N] {
        // SAFETY: parts lie inside the slots that the caller promises.
        unsafe { load(simd, self.0.add(part), k) }
    }

    /// Angular velocity, velocity of the origin, and minus gravity.
    #[inline(always)]
    pub(crate) unsafe fn get<T: Lane>(&self, simd: Simd<T>, k: usize) -> [Vector<T>; 3] {
        // SAFETY: the caller's promise.
        unsafe { [self.part(simd, W, k), self.part(simd, V, k), self.part(simd, A, k)] }
    }

    #[inline(always)]
    unsafe fn set<T: Lane>(&self, (w, v, a): (Vector<T>, Vector<T>, Vector<T>), k: usize) {
        // SAFETY: the three parts lie inside the slots that the caller promises.
        unsafe {
            store(self.0.add(W), k, w);
            store(self.0.add(V), k, v);
            store(self.0.add(A), k, a);
        }
    }

    /// The velocity of a link from its parent's; the joint moves with `rate`.
    #[inline(always)]
    pub(crate) unsafe fn propagate<T: Lane>(
        &self,
        simd: Simd<T>,
        parent: LinkVelocities,
        joint: &JointTransform<T>,
        rate: T,
        k: usize,
    ) {
        // SAFETY: the caller's promise about both links.
        unsafe {
            let (w, v) =
                joint.add_joint_rate(joint.transform_axis((parent.part(simd, W, k), parent.part(simd, V, k))), rate);
            self.set((w, v, joint.rotate(parent.part(simd, A, k))), k)
        }
    }

    /// The velocity of a link whose parent is the base.
    #[inline(always)]
    pub(crate) unsafe fn begin_at_base<T: Lane>(
        &self,
        simd: Simd<T>,
        gravity: [f64; 3],
        joint: &JointTransform<T>,
        rate: T,
        k: usize,
    ) {
        let (w, v) = joint.joint_axis(rate);
        // SAFETY: the caller's promise.
        unsafe { self.set((w, v, joint.rotate(inlined::map(gravity, |g| simd.splat(-g)))), k) }
    }

    /// Rate of change of an axis due to the link's velocity, where the joint moves with the coordinate at `rate`; for a
    /// revolute joint both parts of the axis rotate.
    #[inline(always)]
    pub(crate) unsafe fn turn_axis<T: Lane>(
        &self,
        simd: Simd<T>,
        prismatic: bool,
        (x, u): (Vector<T>, Vector<T>),
        rate: T,
        k: usize,
    ) -> (Vector<T>, Vector<T>) {
        // SAFETY: the caller's promise.
        let (w, v) = unsafe { (self.part(simd, W, k), self.part(simd, V, k)) };
        match prismatic {
            true => (x, about_z(w, rate, u)),
            false => (about_z(w, rate, x), about_z(v, rate, u)),
        }
    }

    /// Contraction of the momentum of unit inertial parameters with an axis, requested entries only.
    #[inline(always)]
    pub(crate) unsafe fn contract<T: Lane, const SET: u32>(
        &self,
        simd: Simd<T>,
        batch: Batch,
        axis: *const Slot,
        sink: &EntrySink,
    ) {
        let sink = sink.of::<SET>();
        for k in batch.lanes(simd) {
            // SAFETY: `lanes` leaves room for a lane in slots, axes and output runs.
            unsafe {
                let (x, u): (Vector<T>, Vector<T>) = load_axis(simd, axis, k);
                let velocity: (Vector<T>, Vector<T>) = (self.part(simd, W, k), self.part(simd, V, k));
                for (p, entry) in contract_momentum(velocity, (x, u)).into_iter().enumerate() {
                    sink.put(p, k, entry);
                }
            }
        }
    }

    /// The remainder of the torque, requested entries only: gravity on the axis, minus the momentum contracted with the
    /// axis's rate.
    #[inline(always)]
    pub(crate) unsafe fn contract_rest<T: Lane, const SET: u32>(
        &self,
        simd: Simd<T>,
        batch: Batch,
        (axis, rate): (*const Slot, *const Slot),
        sink: &EntrySink,
    ) {
        let sink = sink.of::<SET>();
        for k in batch.lanes(simd) {
            // SAFETY: as in `contract`.
            unsafe {
                let (x, u): (Vector<T>, Vector<T>) = load_axis(simd, axis, k);
                let (xd, ud) = load_axis(simd, rate, k);
                let (velocity, a): (_, Vector<T>) =
                    ((self.part(simd, W, k), self.part(simd, V, k)), self.part(simd, A, k));
                let mut left = contract_momentum(velocity, (xd.map(T::neg), ud.map(T::neg)));
                for i in 0..3 {
                    let [_, j, l] = cycle(i);
                    left[6 + i] = a[l].fnma(x[j], a[j].fma(x[l], left[6 + i]));
                }
                left[9] = left[9].add(dot(u, a));
                for (p, entry) in left.into_iter().enumerate() {
                    sink.put(p, k, entry);
                }
            }
        }
    }
}

/// `c + rate * (a x z)`
#[inline(always)]
fn about_z<T: Lane>(a: Vector<T>, rate: T, c: Vector<T>) -> Vector<T> {
    [a[1].fma(rate, c[0]), a[0].fnma(rate, c[1]), c[2]]
}

/// Momentum of unit inertial parameters at a velocity (angular w, linear v), contracted with an axis (angular x, linear
/// u).
#[inline(always)]
pub(crate) fn contract_momentum<T: Lane>(
    (w, v): (Vector<T>, Vector<T>),
    (x, u): (Vector<T>, Vector<T>),
) -> [T; LINK_PARAMETERS] {
    let moments = cross_add(v, x, cross(u, w));
    let mixed = |i: usize, j: usize| x[i].fma(w[j], x[j].mul(w[i]));
    [
        x[0].mul(w[0]),
        mixed(0, 1),
        mixed(0, 2),
        x[1].mul(w[1]),
        mixed(1, 2),
        x[2].mul(w[2]),
        moments[0],
        moments[1],
        moments[2],
        dot(u, v),
    ]
}
