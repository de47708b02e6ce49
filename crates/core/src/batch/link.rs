//! Motion of one link in lanes: the forward recursion, and the contraction of its inertial forces with an axis.
//!
//! The wrench of unit inertial parameters is linear in a few products of the link's motion, and an entry of the
//! regressor is linear in these and in the axis. The products are computed once per link; an entry then takes three to
//! five multiplications with the axis.

use crate::batch::Batch;
use crate::batch::sink::{ConstSink, EntrySink};
use crate::linalg::vector::{Vector, cycle, dot, zero};
use crate::mechanism::closure::Rate;
use crate::mechanism::transform::JointTransform;
use crate::memory::slot::{Slot, load, store};
use crate::simd::inlined;
use crate::simd::lane::Lane;
use crate::simd::token::Simd;

/// Layout of a link's motion, in its own frame: angular velocity and acceleration,
pub(crate) const LINK_NUMBERS: usize = 24;
pub(crate) const W: usize = 0;
pub(crate) const WD: usize = 3;
/// acceleration of the origin minus gravity,
pub(crate) const A: usize = 6;
/// `skew(wd) + skew(w)^2`, row-major,
pub(crate) const B: usize = 9;
/// products `w1 w2, w2 w0, w0 w1`, and differences `w1^2 - w2^2, w2^2 - w0^2, w0^2 - w1^2`.
const P: usize = 18;
const D: usize = 21;

/// Motions of one link at a batch of samples, by pointer to its slots. Parts are loaded when needed, as few fit into
/// registers.
#[derive(Clone, Copy)]
pub(crate) struct LinkMotions(pub(crate) *mut Slot);

/// # Safety
///
/// Of all methods: the pointer is to [`LINK_NUMBERS`] slots of a workspace, which nobody else uses meanwhile, and `k +
/// T::WIDTH <= BATCH`, or the batch is as in [`crate::batch`].
impl LinkMotions {
    #[inline(always)]
    pub(crate) unsafe fn part<T: Lane, const N: usize>(&self, simd: Simd<T>, part: usize, k: usize) -> [T; N] {
        // SAFETY: parts lie inside the slots that the caller promises.
        unsafe { load(simd, self.0.add(part), k) }
    }

    /// Forward recursion of Newton and Euler in the link's frame (Khalil and Dombre 2002, section 9.5), from the
    /// parent's motion; the joint moves with velocity `v` and `acceleration`.
    #[inline(always)]
    pub(crate) unsafe fn propagate<T: Lane>(
        &self,
        simd: Simd<T>,
        parent: LinkMotions,
        joint: &JointTransform<T>,
        (v, acceleration): (T, T),
        k: usize,
    ) {
        // SAFETY: the caller's promise about both links.
        unsafe {
            let (w, wd) = (joint.rotate(parent.part(simd, W, k)), joint.rotate(parent.part(simd, WD, k)));
            let a = joint.transform_field(parent.part(simd, A, k), || parent.part(simd, B, k));
            self.set(joint, (w, wd, a), (v, acceleration), k);
        }
    }

    /// The motion of a link whose parent is the base; gravity enters as an acceleration of the base.
    #[inline(always)]
    pub(crate) unsafe fn begin_at_base<T: Lane>(
        &self,
        simd: Simd<T>,
        gravity: [f64; 3],
        joint: &JointTransform<T>,
        (v, acceleration): (T, T),
        k: usize,
    ) {
        let a = joint.rotate(inlined::map(gravity, |g| simd.splat(-g)));
        // SAFETY: the caller's promise.
        unsafe { self.set(joint, (zero(simd), zero(simd), a), (v, acceleration), k) }
    }

    /// Add the joint's own motion, and store the motion with its products.
    #[inline(always)]
    unsafe fn set<T: Lane>(
        &self,
        joint: &JointTransform<T>,
        (mut w, mut wd, mut a): (Vector<T>, Vector<T>, Vector<T>),
        (v, acceleration): (T, T),
        k: usize,
    ) {
        if joint.is_prismatic() {
            let twice = v.add(v);
            a = [w[1].fma(twice, a[0]), w[0].fnma(twice, a[1]), a[2].add(acceleration)];
        } else {
            wd = [w[1].fma(v, wd[0]), w[0].fnma(v, wd[1]), wd[2].add(acceleration)];
            w[2] = w[2].add(v);
        }
        let s = inlined::map(w, |w| w.mul(w));
        let p = [w[1].mul(w[2]), w[2].mul(w[0]), w[0].mul(w[1])];
        let b = [
            s[1].add(s[2]).neg(),
            p[2].sub(wd[2]),
            p[1].add(wd[1]),
            p[2].add(wd[2]),
            s[0].add(s[2]).neg(),
            p[0].sub(wd[0]),
            p[1].sub(wd[1]),
            p[0].add(wd[0]),
            s[0].add(s[1]).neg(),
        ];
        // SAFETY: all parts lie inside the slots that the caller promises.
        unsafe {
            store(self.0.add(W), k, w);
            store(self.0.add(WD), k, wd);
            store(self.0.add(A), k, a);
            store(self.0.add(B), k, b);
            store(self.0.add(P), k, p);
            store(self.0.add(D), k, [s[1].sub(s[2]), s[2].sub(s[0]), s[0].sub(s[1])]);
        }
    }

    /// Requested entries of an axis along the z of a revolute link.
    #[inline(always)]
    pub(crate) unsafe fn contract_turn<T: Lane, const SET: u32>(
        &self,
        simd: Simd<T>,
        batch: Batch,
        rate: Rate,
        sink: &EntrySink,
    ) {
        let sink = sink.of::<SET>();
        for k in batch.lanes(simd) {
            // SAFETY: `lanes` leaves room for a lane in slots, channels and output runs.
            unsafe {
                let rate: T = batch.rate(simd, rate, k);
                let n = |number: usize| -> T { self.part::<T, 1>(simd, number, k)[0] };
                let back = rate.neg();
                sink.put(0, k, n(P + 2).mul(back));
                sink.put(1, k, n(D + 2).mul(rate));
                sink.put(2, k, n(B + 5).mul(back));
                sink.put(3, k, n(P + 2).mul(rate));
                sink.put(4, k, n(B + 2).mul(rate));
                sink.put(5, k, n(WD + 2).mul(rate));
                sink.put(6, k, n(A + 1).mul(rate));
                sink.put(7, k, n(A).mul(back));
                sink.put(8, k, simd.splat(0.0));
                sink.put(9, k, simd.splat(0.0));
            }
        }
    }

    /// Requested entries of an axis along the z of a prismatic link.
    #[inline(always)]
    pub(crate) unsafe fn contract_slide<T: Lane, const SET: u32>(
        &self,
        simd: Simd<T>,
        batch: Batch,
        rate: Rate,
        sink: &EntrySink,
    ) {
        let sink = sink.of::<SET>();
        for k in batch.lanes(simd) {
            // SAFETY: as in `contract_turn`.
            unsafe {
                let rate: T = batch.rate(simd, rate, k);
                let n = |number: usize| -> T { self.part::<T, 1>(simd, number, k)[0] };
                for p in 0..6 {
                    sink.put(p, k, simd.splat(0.0));
                }
                for e in 0..3 {
                    sink.put(6 + e, k, n(B + 6 + e).mul(rate));
                }
                sink.put(9, k, n(A + 2).mul(rate));
            }
        }
    }

    /// Requested entries of an axis. Each is stored before the next is computed, so that all fits into registers.
    #[inline(always)]
    pub(crate) unsafe fn contract<T: Lane, const SET: u32>(
        &self,
        simd: Simd<T>,
        (x, u): (Vector<T>, Vector<T>),
        sink: &ConstSink<SET>,
        k: usize,
    ) {
        // SAFETY: the caller's promise, for the slots and for the output runs.
        unsafe {
            sink.put(0, k, self.square(simd, 0, x, k));
            sink.put(1, k, self.mixed(simd, 2, x, k));
            sink.put(2, k, self.mixed(simd, 1, x, k));
            sink.put(3, k, self.square(simd, 1, x, k));
            sink.put(4, k, self.mixed(simd, 0, x, k));
            sink.put(5, k, self.square(simd, 2, x, k));
            for i in 0..3 {
                sink.put(6 + i, k, self.moment(simd, i, (x, u), k));
            }
            sink.put(9, k, dot(u, self.part(simd, A, k)));
        }
    }

    /// Entry of the diagonal tensor component i.
    #[inline(always)]
    unsafe fn square<T: Lane>(&self, simd: Simd<T>, i: usize, x: Vector<T>, k: usize) -> T {
        // SAFETY: the caller's promise; `number` stays inside the slots.
        let ([_, j, l], p) = (cycle(i), |e: usize| unsafe { self.number(simd, P + e, k) });
        // SAFETY: as above.
        x[l].fnma(p(l), x[j].fma(p(j), x[i].mul(unsafe { self.number(simd, WD + i, k) })))
    }

    /// Entry of the off-diagonal tensor component of the two indices other than i.
    #[inline(always)]
    unsafe fn mixed<T: Lane>(&self, simd: Simd<T>, i: usize, x: Vector<T>, k: usize) -> T {
        // SAFETY: the caller's promise; `number` stays inside the slots.
        let ([_, j, l], b) = (cycle(i), |e: usize| unsafe { self.number(simd, B + 3 * i + e, k) });
        // SAFETY: as above.
        x[j].fnma(b(j), x[l].fma(b(l), x[i].mul(unsafe { self.number(simd, D + i, k) })))
    }

    /// Entry of component i of the first moments.
    #[inline(always)]
    unsafe fn moment<T: Lane>(&self, simd: Simd<T>, i: usize, (x, u): (Vector<T>, Vector<T>), k: usize) -> T {
        // SAFETY: the caller's promise; `number` stays inside the slots.
        let ([_, j, l], n) = (cycle(i), |e: usize| unsafe { self.number(simd, e, k) });
        let moved = u[2].fma(n(B + 6 + i), u[1].fma(n(B + 3 + i), u[0].mul(n(B + i))));
        x[j].fnma(n(A + l), x[l].fma(n(A + j), moved))
    }

    /// One number of the motion.
    #[inline(always)]
    unsafe fn number<T: Lane>(&self, simd: Simd<T>, number: usize, k: usize) -> T {
        // SAFETY: the caller's promise.
        unsafe { self.part::<T, 1>(simd, number, k)[0] }
    }
}
