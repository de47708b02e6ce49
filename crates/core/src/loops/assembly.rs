//! Assembly modes: the way in which loops close that is connected to a start pose without passing a singular one.
//!
//! Passive joints follow the active ones with rates -A^+ B, where A and B are the Jacobians of the gaps with respect to
//! both, and these rates vary with -A^+ (dJ/dt) G (implicit differentiation). A motion is followed sample by sample by
//! continuation, each from those before it, or from the start where the direct path is not clear: passive joints keep
//! turning where a path returns to its beginning another way. Threads follow segments of a motion, each continued from
//! the start; where the end of a segment does not lead to the next, that one is followed again, so that the result is
//! that of a single thread.

use crate::error::{Error, expect_length};
use crate::loops::continuation::{ClosedConfiguration, Continuation, max_or_nan};
use crate::loops::cut::LoopClosure;
use crate::loops::segment::Segment;
use crate::simd::dispatch::Backend;
use rayon::prelude::*;

/// Largest distance of an active joint between samples that are tried as beginnings of a motion, rad (or mechanism
/// sizes).
const INITIAL_SPACING: f64 = 0.05;
/// Samples per segment, and poses per task of a thread where each is reached from the start.
const SEGMENT: usize = 512;
const SHARE: usize = 32;
/// Two poses are the same where no joint differs by more, rad (or mechanism sizes).
const SAME_POSE: f64 = 1e-6;

/// Tolerances of loop closure.
#[derive(Debug, Clone, Copy)]
pub struct ClosureTolerances {
    /// Largest gap of a closed pose, relative to the mechanism's length scale.
    pub gap: f64,
    /// Smallest singular value of the gaps' Jacobian with respect to the passive joints, its columns of unit length,
    /// that is not singular.
    pub singular_value: f64,
}

/// Joints that follow the active ones linearly, without cut joints: q = rates x active + offset.
#[derive(Debug, Clone, Copy)]
pub struct LinearClosure<'a> {
    /// Rates, joints x active, row-major; rows of the joints that cut joints determine are zero.
    pub rates: &'a [f64],
    /// Offset of each joint, rad or m.
    pub offset: &'a [f64],
}

/// A loop closure in one of its assembly modes.
#[derive(Debug, Clone)]
pub struct AssemblyMode {
    pub(crate) loops: LoopClosure,
    pub(crate) tolerances: ClosureTolerances,
    pub(crate) active: Vec<usize>,
    pub(crate) unknown: Vec<usize>,
    pub(crate) linear_rates: Vec<f64>,
    pub(crate) offset: Vec<f64>,
    /// Joints that follow `linear_rates`.
    pub(crate) driven: Vec<usize>,
    /// Which rates of the unknown joints vary, unknown x active; the others are zero.
    pub(crate) varying: Vec<bool>,
    pub(crate) start: ClosedConfiguration,
    pub(crate) backend: Backend,
}

/// Trajectory of the active joints, samples x active.
#[derive(Debug, Clone, Copy)]
pub struct ActiveTrajectory<'a> {
    /// Positions, rad or m.
    pub position: &'a [f64],
    /// Velocities; empty if derivatives of the rates are not required.
    pub velocity: &'a [f64],
}

/// Trajectory of all joints, to be filled. Rates and their derivatives may be empty where they are not required.
#[derive(Debug)]
pub struct JointTrajectory<'a> {
    /// Positions, samples x joints.
    pub position: &'a mut [f64],
    /// Rates with respect to the active joints, samples x joints x active.
    pub rates: &'a mut [f64],
    /// Time derivatives of the rates, samples x joints x active.
    pub rate_derivatives: &'a mut [f64],
}

/// The first sample that continuation does not reach.
#[derive(Debug, Clone, PartialEq)]
pub struct ContinuationStop {
    /// Index of the sample.
    pub sample: usize,
    /// Last closed pose on the way to it, all joints.
    pub last_pose: Vec<f64>,
}

impl AssemblyMode {
    /// The assembly mode of a closed start pose (all joints), with the active joints, the unknown ones that the gaps
    /// determine, the linear motion of all others, and which rates vary (joints x active; the others are taken as zero).
    /// Runs on [`Backend::selected`]. Errors where shapes do not fit or an index is out of range.
    ///
    /// # Example
    ///
    /// ```
    /// # use haptid_core::*;
    /// # const EYE: [f64; 9] = [1., 0., 0., 0., 1., 0., 0., 0., 1.];
    /// # let bar = |parent, x| Joint { parent, rotation: EYE, translation: [x, 0., 0.], prismatic: false };
    /// # let tip = |link, x| Frame { link: Some(link), rotation: EYE, translation: [x, 0., 0.] };
    /// # let cut = CutJoint { kind: CutKind::Revolute, frame_a: tip(1, 0.4), frame_b: tip(2, 0.3) };
    /// # let loops = LoopClosure::new(&[bar(None, 0.), bar(Some(0), 0.1), bar(None, 0.4)], &[cut], 0.4)?;
    /// # let mut start = [1., -0.3, 1.5];
    /// # loops.close(&mut start, &[1, 2], 60, 1e-12)?;
    /// // A four-bar linkage: joint 0 is active, joints 1 and 2 are passive.
    /// let linear = LinearClosure { rates: &[1., 0., 0.], offset: &[0.; 3] };
    /// let tolerances = ClosureTolerances { gap: 1e-12, singular_value: 1e-3 };
    /// let mode = AssemblyMode::new(&loops, &[0], &[1, 2], &linear, &start, &[true; 3], tolerances)?;
    /// # Ok::<(), haptid_core::Error>(())
    /// ```
    pub fn new(
        loops: &LoopClosure,
        active: &[usize],
        unknown: &[usize],
        linear: &LinearClosure,
        start: &[f64],
        varying: &[bool],
        tolerances: ClosureTolerances,
    ) -> Result<AssemblyMode, Error> {
        let (n, a) = (loops.joints(), active.len());
        if let Some(&got) = active.iter().chain(unknown).find(|&&j| j >= n) {
            return Err(Error::Index { name: "active or unknown joint", got, limit: n });
        }
        for (name, got) in [("number of active joints", a), ("number of unknown joints", unknown.len())] {
            if got == 0 {
                return Err(Error::Value { name, got: 0.0, wanted: "at least one" });
            }
        }
        if unknown.len() > loops.gaps() {
            return Err(Error::Index { name: "number of unknown joints", got: unknown.len(), limit: loops.gaps() + 1 });
        }
        expect_length("constant", linear.rates.len(), n * a)?;
        expect_length("offset", linear.offset.len(), n)?;
        expect_length("start", start.len(), n)?;
        expect_length("varying", varying.len(), n * a)?;
        let mut mode = AssemblyMode {
            loops: loops.clone(),
            tolerances,
            active: active.to_vec(),
            unknown: unknown.to_vec(),
            linear_rates: linear.rates.to_vec(),
            offset: linear.offset.to_vec(),
            driven: (0..n).filter(|j| linear.rates[j * a..][..a].iter().any(|&rate| rate != 0.0)).collect(),
            varying: unknown.iter().flat_map(|&j| &varying[j * a..][..a]).copied().collect(),
            start: ClosedConfiguration::new(loops.gaps(), n, a, unknown.len()),
            backend: Backend::selected()?,
        };
        mode.start = Continuation::new(&mode).configuration_at(start);
        Ok(mode)
    }

    /// The same assembly mode, computed by another back end.
    ///
    /// # Example
    ///
    /// ```
    /// # use haptid_core::*;
    /// # const EYE: [f64; 9] = [1., 0., 0., 0., 1., 0., 0., 0., 1.];
    /// # let bar = |parent, x| Joint { parent, rotation: EYE, translation: [x, 0., 0.], prismatic: false };
    /// # let tip = |link, x| Frame { link: Some(link), rotation: EYE, translation: [x, 0., 0.] };
    /// # let cut = CutJoint { kind: CutKind::Revolute, frame_a: tip(1, 0.4), frame_b: tip(2, 0.3) };
    /// # let loops = LoopClosure::new(&[bar(None, 0.), bar(Some(0), 0.1), bar(None, 0.4)], &[cut], 0.4)?;
    /// # let mut start = [1., -0.3, 1.5];
    /// # loops.close(&mut start, &[1, 2], 60, 1e-12)?;
    /// # let linear = LinearClosure { rates: &[1., 0., 0.], offset: &[0.; 3] };
    /// # let tolerances = ClosureTolerances { gap: 1e-12, singular_value: 1e-3 };
    /// # let mode = AssemblyMode::new(&loops, &[0], &[1, 2], &linear, &start, &[true; 3], tolerances)?;
    /// let portable = mode.with_backend(Backend::named("portable")?);
    /// # Ok::<(), haptid_core::Error>(())
    /// ```
    pub fn with_backend(mut self, backend: Backend) -> AssemblyMode {
        self.backend = backend;
        self
    }

    /// Number of active joints.
    ///
    /// # Example
    ///
    /// ```
    /// # use haptid_core::*;
    /// # const EYE: [f64; 9] = [1., 0., 0., 0., 1., 0., 0., 0., 1.];
    /// # let bar = |parent, x| Joint { parent, rotation: EYE, translation: [x, 0., 0.], prismatic: false };
    /// # let tip = |link, x| Frame { link: Some(link), rotation: EYE, translation: [x, 0., 0.] };
    /// # let cut = CutJoint { kind: CutKind::Revolute, frame_a: tip(1, 0.4), frame_b: tip(2, 0.3) };
    /// # let loops = LoopClosure::new(&[bar(None, 0.), bar(Some(0), 0.1), bar(None, 0.4)], &[cut], 0.4)?;
    /// # let mut start = [1., -0.3, 1.5];
    /// # loops.close(&mut start, &[1, 2], 60, 1e-12)?;
    /// # let linear = LinearClosure { rates: &[1., 0., 0.], offset: &[0.; 3] };
    /// # let tolerances = ClosureTolerances { gap: 1e-12, singular_value: 1e-3 };
    /// # let mode = AssemblyMode::new(&loops, &[0], &[1, 2], &linear, &start, &[true; 3], tolerances)?;
    /// assert_eq!(mode.active(), 1);
    /// # Ok::<(), haptid_core::Error>(())
    /// ```
    pub fn active(&self) -> usize {
        self.active.len()
    }

    /// Number of joints.
    ///
    /// # Example
    ///
    /// ```
    /// # use haptid_core::*;
    /// # const EYE: [f64; 9] = [1., 0., 0., 0., 1., 0., 0., 0., 1.];
    /// # let bar = |parent, x| Joint { parent, rotation: EYE, translation: [x, 0., 0.], prismatic: false };
    /// # let tip = |link, x| Frame { link: Some(link), rotation: EYE, translation: [x, 0., 0.] };
    /// # let cut = CutJoint { kind: CutKind::Revolute, frame_a: tip(1, 0.4), frame_b: tip(2, 0.3) };
    /// # let loops = LoopClosure::new(&[bar(None, 0.), bar(Some(0), 0.1), bar(None, 0.4)], &[cut], 0.4)?;
    /// # let mut start = [1., -0.3, 1.5];
    /// # loops.close(&mut start, &[1, 2], 60, 1e-12)?;
    /// # let linear = LinearClosure { rates: &[1., 0., 0.], offset: &[0.; 3] };
    /// # let tolerances = ClosureTolerances { gap: 1e-12, singular_value: 1e-3 };
    /// # let mode = AssemblyMode::new(&loops, &[0], &[1, 2], &linear, &start, &[true; 3], tolerances)?;
    /// assert_eq!(mode.joints(), 3);
    /// # Ok::<(), haptid_core::Error>(())
    /// ```
    pub fn joints(&self) -> usize {
        self.offset.len()
    }

    /// Follow a trajectory of the active joints from the start pose: positions of all joints, their rates and the rates'
    /// derivatives. Returns the first sample that is not reached, if there is one; from there on nothing is written.
    ///
    /// # Example
    ///
    /// ```
    /// # use haptid_core::*;
    /// # const EYE: [f64; 9] = [1., 0., 0., 0., 1., 0., 0., 0., 1.];
    /// # let bar = |parent, x| Joint { parent, rotation: EYE, translation: [x, 0., 0.], prismatic: false };
    /// # let tip = |link, x| Frame { link: Some(link), rotation: EYE, translation: [x, 0., 0.] };
    /// # let cut = CutJoint { kind: CutKind::Revolute, frame_a: tip(1, 0.4), frame_b: tip(2, 0.3) };
    /// # let loops = LoopClosure::new(&[bar(None, 0.), bar(Some(0), 0.1), bar(None, 0.4)], &[cut], 0.4)?;
    /// # let mut start = [1., -0.3, 1.5];
    /// # loops.close(&mut start, &[1, 2], 60, 1e-12)?;
    /// # let linear = LinearClosure { rates: &[1., 0., 0.], offset: &[0.; 3] };
    /// # let tolerances = ClosureTolerances { gap: 1e-12, singular_value: 1e-3 };
    /// # let mode = AssemblyMode::new(&loops, &[0], &[1, 2], &linear, &start, &[true; 3], tolerances)?;
    /// // A four-bar linkage, at two positions of its crank.
    /// let path = ActiveTrajectory { position: &[1., 1.1], velocity: &[] };
    /// let mut q = [0.; 6];
    /// let out = JointTrajectory { position: &mut q, rates: &mut [], rate_derivatives: &mut [] };
    /// assert!(mode.follow(&path, out)?.is_none() && q[3] == 1.1);
    /// # Ok::<(), haptid_core::Error>(())
    /// ```
    pub fn follow(&self, path: &ActiveTrajectory, out: JointTrajectory) -> Result<Option<ContinuationStop>, Error> {
        let (n, a) = (self.joints(), self.active());
        let samples = self.samples("position", path.position)?;
        let wanted = if out.rate_derivatives.is_empty() { 0 } else { samples };
        expect_length("velocity", path.velocity.len(), wanted * a)?;
        expect_length("positions of all joints", out.position.len(), samples * n)?;
        expect_length("change", out.rate_derivatives.len(), wanted * n * a)?;
        expect_length("rates", out.rates.len(), if out.rates.is_empty() { 0 } else { samples * n * a })?;
        if samples == 0 {
            return Ok(None);
        }
        let continuation = match self.initial_continuation(path.position) {
            Ok(continuation) => continuation,
            Err(stop) => return Ok(Some(stop)),
        };
        Ok(self.join_segments(&mut self.segments(path, out), continuation))
    }

    /// Go along a straight line from the start pose to each target (samples x active): the last closed pose on the way
    /// (samples x joints), and whether it is the target.
    ///
    /// # Example
    ///
    /// ```
    /// # use haptid_core::*;
    /// # const EYE: [f64; 9] = [1., 0., 0., 0., 1., 0., 0., 0., 1.];
    /// # let bar = |parent, x| Joint { parent, rotation: EYE, translation: [x, 0., 0.], prismatic: false };
    /// # let tip = |link, x| Frame { link: Some(link), rotation: EYE, translation: [x, 0., 0.] };
    /// # let cut = CutJoint { kind: CutKind::Revolute, frame_a: tip(1, 0.4), frame_b: tip(2, 0.3) };
    /// # let loops = LoopClosure::new(&[bar(None, 0.), bar(Some(0), 0.1), bar(None, 0.4)], &[cut], 0.4)?;
    /// # let mut start = [1., -0.3, 1.5];
    /// # loops.close(&mut start, &[1, 2], 60, 1e-12)?;
    /// # let linear = LinearClosure { rates: &[1., 0., 0.], offset: &[0.; 3] };
    /// # let tolerances = ClosureTolerances { gap: 1e-12, singular_value: 1e-3 };
    /// # let mode = AssemblyMode::new(&loops, &[0], &[1, 2], &linear, &start, &[true; 3], tolerances)?;
    /// let (mut q, mut reached) = ([0.; 3], [false]);
    /// mode.reach_from_start(&[1.1], &mut q, &mut reached)?;
    /// assert!(reached[0] && q[0] == 1.1);
    /// # Ok::<(), haptid_core::Error>(())
    /// ```
    pub fn reach_from_start(&self, targets: &[f64], out: &mut [f64], reached: &mut [bool]) -> Result<(), Error> {
        let (n, a) = (self.joints(), self.active());
        let samples = self.samples("targets", targets)?;
        expect_length("out", out.len(), samples * n)?;
        expect_length("reached", reached.len(), samples)?;
        let shares = targets.par_chunks(SHARE * a).zip(out.par_chunks_mut(SHARE * n));
        shares.zip(reached.par_chunks_mut(SHARE)).for_each(|((targets, out), reached)| {
            let mut continuation = Continuation::new(self);
            for ((target, out), reached) in targets.chunks_exact(a).zip(out.chunks_exact_mut(n)).zip(reached) {
                continuation.restart_from(&self.start);
                *reached = continuation.advance_to(target);
                out.copy_from_slice(&continuation.configuration.q);
            }
        });
        Ok(())
    }

    fn samples(&self, name: &'static str, x: &[f64]) -> Result<usize, Error> {
        let samples = x.len() / self.active();
        expect_length(name, x.len(), samples * self.active())?;
        Ok(samples)
    }

    /// Largest difference of the active joints' positions, rad (or mechanism sizes).
    fn distance_between(&self, one: &[f64], other: &[f64]) -> f64 {
        let each = self.active.iter().zip(one.iter().zip(other));
        max_or_nan(each.map(|(&j, (x, y))| ((x - y) / self.loops.joint_scale(j)).abs()))
    }

    /// A continuation at the first sample: from the start, or back from the first sample that is connected to the
    /// start.
    fn initial_continuation(&self, position: &[f64]) -> Result<Continuation<'_>, ContinuationStop> {
        let a = self.active();
        let target = |k: usize| &position[k * a..][..a];
        let (mut continuation, mut iterate, mut stop) = (Continuation::new(self), 0, None);
        for k in 0..position.len() / a {
            if k > 0 && self.distance_between(target(k), target(iterate)) < INITIAL_SPACING {
                continue;
            }
            iterate = k;
            continuation.restart_from(&self.start);
            if continuation.advance_to(target(k)) {
                let back = (0..k).rev().all(|k| continuation.advance_to(target(k)));
                return if back { Ok(continuation) } else { Err(stop.unwrap_or_else(|| continuation.stop(k))) };
            }
            stop.get_or_insert_with(|| continuation.stop(0));
        }
        Err(stop.unwrap_or_else(|| continuation.stop(0)))
    }

    fn segments<'a>(&self, path: &ActiveTrajectory<'a>, out: JointTrajectory<'a>) -> Vec<Segment<'a>> {
        let (n, a) = (self.joints(), self.active());
        let positions = path.position.chunks(SEGMENT * a).zip(out.position.chunks_mut(SEGMENT * n)).enumerate();
        let mut velocities = path.velocity.chunks(SEGMENT * a);
        let (mut rates, mut rate_derivatives) =
            (out.rates.chunks_mut(SEGMENT * n * a), out.rate_derivatives.chunks_mut(SEGMENT * n * a));
        let segment = |(k, (position, q))| Segment {
            first: k * SEGMENT,
            position,
            velocity: velocities.next().unwrap_or_default(),
            q,
            rates: rates.next().unwrap_or_default(),
            rate_derivatives: rate_derivatives.next().unwrap_or_default(),
        };
        positions.map(segment).collect()
    }

    /// Follow all segments, those after the first as if the start led to them, and repeat those where it does not.
    fn join_segments(&self, segments: &mut [Segment], mut continuation: Continuation) -> Option<ContinuationStop> {
        let (first, rest) = segments.split_first_mut()?;
        if rest.is_empty() {
            return first.follow(&mut continuation).err();
        }
        let (leads, ends) = rayon::join(
            || first.follow(&mut continuation),
            || rest.par_iter_mut().map(|segment| segment.follow_from_start(self)).collect::<Vec<_>>(),
        );
        let mut stop = leads.err();
        for (segment, speculative) in rest.iter_mut().zip(ends) {
            if stop.is_some() {
                break;
            }
            if !continuation.advance_or_restart(&segment.position[..self.active()]) {
                stop = Some(continuation.stop(segment.first));
                break;
            }
            let leads = continuation.is_at(&segment.q[..self.joints()], SAME_POSE);
            stop = match speculative.filter(|_| leads) {
                Some(Ok(end)) => {
                    continuation.restart_from(&end);
                    None
                }
                Some(Err(found)) => Some(found),
                None => segment.follow(&mut continuation).err(),
            };
        }
        stop
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::loops::cut::{CutJoint, CutKind, Frame};
    use crate::mechanism::Joint;

    const EYE: [f64; 9] = [1., 0., 0., 0., 1., 0., 0., 0., 1.];

    /// A four-bar linkage: two cranks on a base line, the active one shorter than the base, and a coupler from it that
    /// ends on the other crank.
    fn four_bar(reach: f64) -> AssemblyMode {
        let bar = |parent, x| Joint { parent, rotation: EYE, translation: [x, 0., 0.], prismatic: false };
        let tip = |link, x| Frame { link: Some(link), rotation: EYE, translation: [x, 0., 0.] };
        let cut = CutJoint { kind: CutKind::Revolute, frame_a: tip(1, reach), frame_b: tip(2, 0.3) };
        let loops =
            LoopClosure::new(&[bar(None, 0.), bar(Some(0), 0.1), bar(None, 0.4)], &[cut], 0.4).expect("four bars");
        let mut start = [1.0, -0.3, 1.5];
        loops.close(&mut start, &[1, 2], 60, 1e-12).expect("shapes");
        let tolerances = ClosureTolerances { gap: 1e-12, singular_value: 1e-3 };
        let linear = LinearClosure { rates: &[1., 0., 0.], offset: &[0.; 3] };
        AssemblyMode::new(&loops, &[0], &[1, 2], &linear, &start, &[true; 3], tolerances).expect("an assembly mode")
    }

    type Found = (Vec<f64>, Vec<f64>, Vec<f64>, Option<ContinuationStop>);

    fn followed(mode: &AssemblyMode, position: &[f64], velocity: &[f64]) -> Found {
        let mut made = (vec![0.0; 3 * position.len()], vec![0.0; 3 * position.len()], vec![0.0; 3 * position.len()]);
        let out = JointTrajectory { position: &mut made.0, rates: &mut made.1, rate_derivatives: &mut made.2 };
        let stop = mode.follow(&ActiveTrajectory { position, velocity }, out).expect("shapes");
        (made.0, made.1, made.2, stop)
    }

    /// A crank that makes full turns.
    fn turns(samples: usize) -> Vec<f64> {
        (0..samples).map(|k| 1.0 + 0.004 * k as f64).collect()
    }

    #[test]
    fn many_samples_on_several_threads_equal_those_of_one_continuation() {
        let (mode, position) = (four_bar(0.4), turns(5003));
        let (q, _, _, stop) = followed(&mode, &position, &vec![1.0; 5003]);
        assert!(stop.is_none());
        let mut continuation = mode.initial_continuation(&position).expect("it closes");
        for (k, x) in position.iter().enumerate() {
            assert!(continuation.advance_to(&[*x]) && continuation.is_at(&q[3 * k..][..3], 1e-12), "sample {k}");
        }
    }
}
