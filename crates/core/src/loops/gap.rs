//! Gaps of cut joints, and their Jacobian with respect to all joints.

use crate::error::{Error, expect_length};
use crate::loops::cut::{CutKind, LoopClosure, SHARE};
use crate::loops::pose::{Placement, Pose, Vector, dot, sub};
use crate::simd::real::Number;
use rayon::prelude::*;

/// Poses of the links, gaps, and their Jacobian (gaps x joints), at one sample.
pub(crate) struct LoopState<N: Number> {
    token: N::Token,
    pub(crate) links: Vec<Pose<N>>,
    pub(crate) gaps: Vec<N>,
    pub(crate) jacobian: Vec<N>,
}

impl<N: Number> LoopState<N> {
    /// Pose of a frame from its placement on a link.
    #[inline(always)]
    fn pose(&self, link: Option<usize>, at: &Placement) -> Pose<N> {
        match link {
            None => Pose::base(self.token).place(at),
            Some(link) => self.links[link].place(at),
        }
    }
}

impl LoopClosure {
    /// A state for one sample, with zero gaps and Jacobian.
    pub(crate) fn state<N: Number>(&self, token: N::Token) -> LoopState<N> {
        let (m, n) = (self.gaps(), self.joints.len());
        LoopState {
            token,
            links: vec![Pose::base(token); n],
            gaps: vec![N::constant(token, 0.0); m],
            jacobian: vec![N::constant(token, 0.0); m * n],
        }
    }

    /// Evaluate the gaps and their Jacobian. Entries of joints that carry no frame keep their initial zeros.
    #[inline(always)]
    pub(crate) fn measure<N: Number>(&self, q: &[N], state: &mut LoopState<N>) {
        self.place(q, state);
        let mut first = 0;
        for (k, cut) in self.cuts.iter().enumerate() {
            match cut.kind {
                CutKind::Revolute => self.measure_cut::<N, RevoluteCut>(k, first, state),
                CutKind::Prismatic => self.measure_cut::<N, PrismaticCut>(k, first, state),
                CutKind::Spherical => self.measure_cut::<N, SphericalCut>(k, first, state),
            }
            first += cut.gaps();
        }
    }

    /// Evaluate the gaps without their Jacobian.
    #[inline(always)]
    pub(crate) fn measure_gaps<N: Number>(&self, q: &[N], state: &mut LoopState<N>) {
        self.place(q, state);
        let mut first = 0;
        for (k, cut) in self.cuts.iter().enumerate() {
            let [frame_a, frame_b] = self.frames(k, state);
            let difference = FrameDifference::between(&frame_a, &frame_b);
            let (size, axes, none) = (self.length_scale, &difference.axes_b, [N::constant(state.token, 0.0); 3]);
            let gaps = &mut state.gaps[first..];
            match cut.kind {
                CutKind::Revolute => RevoluteCut::entries(size, axes, none, &difference, gaps, 1),
                CutKind::Prismatic => PrismaticCut::entries(size, axes, none, &difference, gaps, 1),
                CutKind::Spherical => SphericalCut::entries(size, axes, none, &difference, gaps, 1),
            }
            first += cut.gaps();
        }
    }

    /// Forward kinematics of the links.
    #[inline(always)]
    fn place<N: Number>(&self, q: &[N], state: &mut LoopState<N>) {
        for (j, joint) in self.joints.iter().enumerate() {
            state.links[j] = state.pose(joint.parent, &self.joint_placements[j]).move_joint(joint.prismatic, q[j]);
        }
    }

    /// Both frames of cut joint k.
    #[inline(always)]
    fn frames<N: Number>(&self, k: usize, state: &LoopState<N>) -> [Pose<N>; 2] {
        let (cut, [frame_a, frame_b]) = (&self.cuts[k], &self.frame_placements[k]);
        [state.pose(cut.frame_a.link, frame_a), state.pose(cut.frame_b.link, frame_b)]
    }

    /// Gaps of cut joint k, from `first` on, and their Jacobian.
    #[inline(always)]
    fn measure_cut<N: Number, K: GapEquations>(&self, k: usize, first: usize, state: &mut LoopState<N>) {
        let (n, [frame_a, frame_b]) = (self.joints.len(), self.frames(k, state));
        let whole = FrameDifference::between(&frame_a, &frame_b);
        let none = Pose::zero(state.token);
        K::entries(self.length_scale, &frame_b.axes, none.origin, &whole, &mut state.gaps[first..], 1);
        for carrier in &self.carriers[k] {
            let (link, prismatic) = (&state.links[carrier.joint], self.joints[carrier.joint].prismatic);
            let rates_a = if carrier.frame_a { frame_a.rates_by(link, prismatic) } else { none };
            let rates_b = if carrier.frame_b { frame_b.rates_by(link, prismatic) } else { none };
            let change = FrameDifference::between(&rates_a, &rates_b);
            K::entries(
                self.length_scale,
                &frame_b.axes,
                whole.distance,
                &change,
                &mut state.jacobian[first * n + carrier.joint..],
                n,
            );
        }
    }

    /// Evaluate the gaps (samples x gaps, m) and their Jacobian (samples x gaps x joints) at joint positions q (samples x
    /// joints).
    ///
    /// # Example
    ///
    /// ```
    /// # use haptid_core::*;
    /// # const EYE: [f64; 9] = [1., 0., 0., 0., 1., 0., 0., 0., 1.];
    /// # let bar = |x| Joint { parent: None, rotation: EYE, translation: [x, 0., 0.], prismatic: false };
    /// # let tip = |link, x| Frame { link: Some(link), rotation: EYE, translation: [x, 0., 0.] };
    /// # let cut = CutJoint { kind: CutKind::Revolute, frame_a: tip(0, 0.5), frame_b: tip(1, 0.4) };
    /// # let loops = LoopClosure::new(&[bar(0.), bar(0.6)], &[cut], 0.6)?;
    /// // Two bars of 0.5 and 0.4 m, 0.6 m apart, that point at each other.
    /// let (mut gaps, mut jacobian) = ([0.; 6], [0.; 12]);
    /// loops.evaluate_gaps(&[0., std::f64::consts::PI], &mut gaps, &mut jacobian)?;
    /// assert!((gaps[0] - (0.5 - 0.2)).abs() < 1e-12);
    /// # Ok::<(), haptid_core::Error>(())
    /// ```
    pub fn evaluate_gaps(&self, q: &[f64], gaps: &mut [f64], jacobian: &mut [f64]) -> Result<(), Error> {
        let (m, n) = (self.gaps(), self.joints.len());
        let samples = q.len().checked_div(n).unwrap_or(0);
        expect_length("q", q.len(), samples * n)?;
        expect_length("gaps", gaps.len(), samples * m)?;
        expect_length("jacobian", jacobian.len(), samples * m * n)?;
        let shares = q.par_chunks(SHARE * n.max(1)).zip(gaps.par_chunks_mut(SHARE * m.max(1)));
        shares.zip(jacobian.par_chunks_mut(SHARE * (m * n).max(1))).for_each(|((q, gaps), jacobian)| {
            let mut state = self.state::<f64>(());
            let each = q.chunks_exact(n).zip(gaps.chunks_exact_mut(m.max(1)));
            for ((q, gaps), jacobian) in each.zip(jacobian.chunks_exact_mut((m * n).max(1))) {
                self.measure(q, &mut state);
                gaps.copy_from_slice(&state.gaps);
                jacobian.copy_from_slice(&state.jacobian);
            }
        });
        Ok(())
    }
}

/// Difference of two frames, or of their rates: distance of the origins, and the axes of both.
struct FrameDifference<N> {
    distance: Vector<N>,
    axes_a: [Vector<N>; 3],
    axes_b: [Vector<N>; 3],
}

impl<N: Number> FrameDifference<N> {
    #[inline(always)]
    fn between(frame_a: &Pose<N>, frame_b: &Pose<N>) -> Self {
        FrameDifference { distance: sub(frame_a.origin, frame_b.origin), axes_a: frame_a.axes, axes_b: frame_b.axes }
    }
}

/// Gaps of a cut joint as a function of the frames' difference, in which they are linear but for the axes along which a
/// distance is measured.
trait GapEquations {
    /// Write the gaps, `after` numbers apart. In a derivative, the rates of the axes are multiplied by `distance`.
    fn entries<N: Number>(
        size: f64,
        axes: &[Vector<N>; 3],
        distance: Vector<N>,
        difference: &FrameDifference<N>,
        out: &mut [N],
        after: usize,
    );
}

/// Cut revolute joint.
struct RevoluteCut;

/// Cut prismatic joint.
struct PrismaticCut;

/// Cut spherical joint.
struct SphericalCut;

impl GapEquations for SphericalCut {
    #[inline(always)]
    fn entries<N: Number>(
        _: f64,
        _: &[Vector<N>; 3],
        _: Vector<N>,
        difference: &FrameDifference<N>,
        out: &mut [N],
        after: usize,
    ) {
        for e in 0..3 {
            out[e * after] = difference.distance[e];
        }
    }
}

impl GapEquations for RevoluteCut {
    #[inline(always)]
    fn entries<N: Number>(
        size: f64,
        _: &[Vector<N>; 3],
        _: Vector<N>,
        difference: &FrameDifference<N>,
        out: &mut [N],
        after: usize,
    ) {
        for e in 0..3 {
            out[e * after] = difference.distance[e];
            out[(3 + e) * after] = (difference.axes_a[2][e] - difference.axes_b[2][e]).scale(size);
        }
    }
}

impl GapEquations for PrismaticCut {
    #[inline(always)]
    fn entries<N: Number>(
        size: f64,
        axes: &[Vector<N>; 3],
        distance: Vector<N>,
        difference: &FrameDifference<N>,
        out: &mut [N],
        after: usize,
    ) {
        for k in 0..2 {
            out[k * after] = dot(axes[k], difference.distance) + dot(difference.axes_b[k], distance);
            for e in 0..3 {
                out[(2 + 2 * e + k) * after] = (difference.axes_a[2 * k][e] - difference.axes_b[2 * k][e]).scale(size);
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

    /// Four bars in a plane, the last joint cut, and a prismatic and a spherical loop in addition.
    fn bars() -> LoopClosure {
        let eye = [1., 0., 0., 0., 1., 0., 0., 0., 1.];
        let aside = [0., 0., 1., 1., 0., 0., 0., 1., 0.];
        let bar = |parent, x| Joint { parent, rotation: eye, translation: [x, 0.1, 0.0], prismatic: false };
        let slider = Joint { parent: Some(2), rotation: aside, translation: [0.2, 0.0, 0.1], prismatic: true };
        let frame = |link, x| Frame { link, rotation: aside, translation: [x, 0.0, 0.3] };
        let cuts = [
            CutJoint { kind: CutKind::Revolute, frame_a: frame(Some(1), 0.5), frame_b: frame(Some(2), 0.4) },
            CutJoint { kind: CutKind::Prismatic, frame_a: frame(Some(3), 0.1), frame_b: frame(Some(0), 0.2) },
            CutJoint { kind: CutKind::Spherical, frame_a: frame(Some(3), 0.2), frame_b: frame(Some(1), -0.1) },
        ];
        LoopClosure::new(&[bar(None, 0.0), bar(Some(0), 0.3), bar(None, 0.6), slider], &cuts, 0.6).expect("four bars")
    }

    fn measured(loops: &LoopClosure, q: &[f64]) -> (Vec<f64>, Vec<f64>) {
        let mut made = (vec![0.0; loops.gaps()], vec![0.0; loops.gaps() * q.len()]);
        loops.evaluate_gaps(q, &mut made.0, &mut made.1).expect("shapes");
        made
    }

    #[test]
    fn jacobians_and_their_derivatives_are_those_of_differences() {
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
        let mut moving = loops.state(());
        let duals = [0, 1, 2, 3].map(|j| Dual { value: q[j], rate: qd[j] });
        loops.measure(&duals, &mut moving);
        let (ahead, behind) = (shifted(h, &|j| qd[j]).1, shifted(-h, &|j| qd[j]).1);
        for (e, entry) in moving.jacobian.iter().enumerate() {
            assert!(((ahead[e] - behind[e]) / (2.0 * h) - entry.rate).abs() < 1e-8, "entry {e}");
        }
    }
}
