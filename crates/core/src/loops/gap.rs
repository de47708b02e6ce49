//! Gaps of cut joints and their Jacobian.

use crate::error::{Error, expect_length};
use crate::loops::cut::{LoopClosure, SHARE};
use crate::loops::pose::{Placement, Pose, Vector, dot, sub};
use crate::simd::real::Number;
use rayon::prelude::*;

/// One sample's links, gaps, and their Jacobian, gaps x joints.
pub(crate) struct LoopState<N> {
    pub(crate) links: Vec<Pose<N>>,
    pub(crate) gaps: Vec<N>,
    pub(crate) jacobian: Vec<N>,
}

impl<N: Number> LoopState<N> {
    /// A frame, and where it joint_placements on its link.
    #[inline(always)]
    fn pose(&self, link: Option<usize>, at: &Placement) -> Pose<N> {
        match link {
            None => Pose::base().place(at),
            Some(link) => self.links[link].place(at),
        }
    }
}

impl LoopClosure {
    pub(crate) fn shape<N: Number>(&self) -> LoopState<N> {
        let (m, n) = (self.gaps(), self.joints.len());
        LoopState {
            links: vec![Pose::base(); n],
            gaps: vec![N::constant(0.0); m],
            jacobian: vec![N::constant(0.0); m * n],
        }
    }

    /// Gaps and their Jacobian at positions of the joints; entries of joints that carry no frame stay as they were made.

    #[inline(always)]
    pub(crate) fn measure<N: Number>(&self, q: &[N], shape: &mut LoopState<N>) {
        self.place(q, shape);
        let mut first = 0;
        for (k, cut) in self.cuts.iter().enumerate() {
            if cut.prismatic {
                self.measure_cut::<N, PrismaticCut>(k, first, shape);
            } else {
                self.measure_cut::<N, RevoluteCut>(k, first, shape);
            }
            first += cut.gaps();
        }
    }

    /// Gaps alone.
    #[inline(always)]
    pub(crate) fn measure_gaps<N: Number>(&self, q: &[N], shape: &mut LoopState<N>) {
        self.place(q, shape);
        let mut first = 0;
        for (k, cut) in self.cuts.iter().enumerate() {
            let [own, twin] = self.frames(k, shape);
            let moved = FrameDifference::between(&own, &twin);
            let gaps = &mut shape.gaps[first..];
            if cut.prismatic {
                PrismaticCut::entries(self.length_scale, &moved.twin, [N::constant(0.0); 3], &moved, gaps, 1);
            } else {
                RevoluteCut::entries(self.length_scale, &moved.twin, [N::constant(0.0); 3], &moved, gaps, 1);
            }
            first += cut.gaps();
        }
    }

    /// Put the links where the joints bring them.
    #[inline(always)]
    fn place<N: Number>(&self, q: &[N], shape: &mut LoopState<N>) {
        for (j, joint) in self.joints.iter().enumerate() {
            shape.links[j] = shape.pose(joint.parent, &self.joint_placements[j]).move_joint(joint.prismatic, q[j]);
        }
    }

    /// Both frames of cut k.
    #[inline(always)]
    fn frames<N: Number>(&self, k: usize, shape: &LoopState<N>) -> [Pose<N>; 2] {
        let (cut, [own, twin]) = (&self.cuts[k], &self.frame_placements[k]);
        [shape.pose(cut.frame_a.link, own), shape.pose(cut.frame_b.link, twin)]
    }

    /// Of cut k, whose gaps begin at `first`.
    #[inline(always)]
    fn measure_cut<N: Number, K: CutKind>(&self, k: usize, first: usize, shape: &mut LoopState<N>) {
        let (n, [own, twin]) = (self.joints.len(), self.frames(k, shape));
        let whole = FrameDifference::between(&own, &twin);
        K::entries(self.length_scale, &twin.axes, [N::constant(0.0); 3], &whole, &mut shape.gaps[first..], 1);
        for carrier in &self.carriers[k] {
            let (link, prismatic) = (&shape.links[carrier.joint], self.joints[carrier.joint].prismatic);
            let by_own = if carrier.frame { own.rates_by(link, prismatic) } else { Pose::zero() };
            let by_twin = if carrier.twin { twin.rates_by(link, prismatic) } else { Pose::zero() };
            let change = FrameDifference::between(&by_own, &by_twin);
            K::entries(
                self.length_scale,
                &twin.axes,
                whole.apart,
                &change,
                &mut shape.jacobian[first * n + carrier.joint..],
                n,
            );
        }
    }

    /// Gaps, samples x gaps, and their Jacobian, samples x gaps x joints, at positions q, samples x joints.
    pub fn evaluate_gaps(&self, q: &[f64], gaps: &mut [f64], jacobian: &mut [f64]) -> Result<(), Error> {
        let (m, n) = (self.gaps(), self.joints.len());
        let samples = q.len().checked_div(n).unwrap_or(0);
        expect_length("q", q.len(), samples * n)?;
        expect_length("gaps", gaps.len(), samples * m)?;
        expect_length("jacobian", jacobian.len(), samples * m * n)?;
        let shares = q.par_chunks(SHARE * n.max(1)).zip(gaps.par_chunks_mut(SHARE * m.max(1)));
        shares.zip(jacobian.par_chunks_mut(SHARE * (m * n).max(1))).for_each(|((q, gaps), jacobian)| {
            let mut shape = self.shape::<f64>();
            let each = q.chunks_exact(n).zip(gaps.chunks_exact_mut(m.max(1)));
            for ((q, gaps), jacobian) in each.zip(jacobian.chunks_exact_mut((m * n).max(1))) {
                self.measure(q, &mut shape);
                gaps.copy_from_slice(&shape.gaps);
                jacobian.copy_from_slice(&shape.jacobian);
            }
        });
        Ok(())
    }
}

/// What moved, or how fast: the distance between the origins, and the axes of both frames.
struct FrameDifference<N> {
    apart: Vector<N>,
    own: [Vector<N>; 3],
    twin: [Vector<N>; 3],
}

impl<N: Number> FrameDifference<N> {
    #[inline(always)]
    fn between(own: &Pose<N>, twin: &Pose<N>) -> Self {
        FrameDifference { apart: sub(own.origin, twin.origin), own: own.axes, twin: twin.axes }
    }
}

/// How the gaps of a cut follow from what moved, as far as they are linear in it.
trait CutKind {
    /// Write gap after gap, each so many places after the last, the twin's own turn against a distance added.
    fn entries<N: Number>(
        size: f64,
        twin: &[Vector<N>; 3],
        apart: Vector<N>,
        moved: &FrameDifference<N>,
        out: &mut [N],
        after: usize,
    );
}

/// A joint that turns.
struct RevoluteCut;

/// A joint that slides.
struct PrismaticCut;

impl CutKind for RevoluteCut {
    #[inline(always)]
    fn entries<N: Number>(
        size: f64,
        _: &[Vector<N>; 3],
        _: Vector<N>,
        moved: &FrameDifference<N>,
        out: &mut [N],
        after: usize,
    ) {
        for e in 0..3 {
            out[e * after] = moved.apart[e];
            out[(3 + e) * after] = (moved.own[2][e] - moved.twin[2][e]).scale(size);
        }
    }
}

impl CutKind for PrismaticCut {
    #[inline(always)]
    fn entries<N: Number>(
        size: f64,
        twin: &[Vector<N>; 3],
        apart: Vector<N>,
        moved: &FrameDifference<N>,
        out: &mut [N],
        after: usize,
    ) {
        for k in 0..2 {
            out[k * after] = dot(twin[k], moved.apart) + dot(moved.twin[k], apart);
            for e in 0..3 {
                out[(2 + 2 * e + k) * after] = (moved.own[2 * k][e] - moved.twin[2 * k][e]).scale(size);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::loops::cut::{CutJoint, Frame};
    use crate::mechanism::Joint;
    use crate::simd::real::Dual;

    /// Four bars in a plane, the last joint cut, and a slider beside it.
    fn bars() -> LoopClosure {
        let eye = [1., 0., 0., 0., 1., 0., 0., 0., 1.];
        let aside = [0., 0., 1., 1., 0., 0., 0., 1., 0.];
        let bar = |parent, x| Joint { parent, rotation: eye, translation: [x, 0.1, 0.0], prismatic: false };
        let slider = Joint { parent: Some(2), rotation: aside, translation: [0.2, 0.0, 0.1], prismatic: true };
        let frame = |link, x| Frame { link, rotation: aside, translation: [x, 0.0, 0.3] };
        let cuts = [
            CutJoint { prismatic: false, frame_a: frame(Some(1), 0.5), frame_b: frame(Some(2), 0.4) },
            CutJoint { prismatic: true, frame_a: frame(Some(3), 0.1), frame_b: frame(Some(0), 0.2) },
        ];
        LoopClosure::new(&[bar(None, 0.0), bar(Some(0), 0.3), bar(None, 0.6), slider], &cuts, 0.6).expect("four bars")
    }

    fn measured(loops: &LoopClosure, q: &[f64]) -> (Vec<f64>, Vec<f64>) {
        let mut made = (vec![0.0; loops.gaps()], vec![0.0; loops.gaps() * q.len()]);
        loops.evaluate_gaps(q, &mut made.0, &mut made.1).expect("shapes");
        made
    }

    #[test]
    fn jacobians_and_their_change_are_those_of_differences() {
        let (loops, q, qd, h) = (bars(), [0.3, -0.7, 1.1, 0.2], [0.5, 1.2, -0.8, 0.4], 1e-6);
        let shifted = |h: f64, by: &dyn Fn(usize) -> f64| {
            let q: Vec<f64> = q.iter().enumerate().map(|(j, q)| q + h * by(j)).collect();
            measured(&loops, &q)
        };
        let jacobian = measured(&loops, &q).1;
        for j in 0..4 {
            let by = |k: usize| if k == j { 1.0 } else { 0.0 };
            let (ahead, behind) = (shifted(h, &by).0, shifted(-h, &by).0);
            for e in 0..loops.gaps() {
                let slope = (ahead[e] - behind[e]) / (2.0 * h);
                assert!((slope - jacobian[4 * e + j]).abs() < 1e-8, "gap {e} by joint {j}");
            }
        }
        let mut moving = loops.shape();
        let duals = [0, 1, 2, 3].map(|j| Dual { value: q[j], rate: qd[j] });
        loops.measure(&duals, &mut moving);
        let (ahead, behind) = (shifted(h, &|j| qd[j]).1, shifted(-h, &|j| qd[j]).1);
        for (e, entry) in moving.jacobian.iter().enumerate() {
            assert!(((ahead[e] - behind[e]) / (2.0 * h) - entry.rate).abs() < 1e-8, "entry {e}");
        }
    }
}
