//! One of the ways in which loops close: that which leads from a start pose, without a singular pose, along a motion.
//!
//! Passive joints follow the active ones with rates -A^+ B, where A and B are the Jacobians of the gaps by both, and
//! these rates change with -A^+ (dJ/dt) G (implicit differentiation). A motion is followed sample by sample, each from
//! those before it, or from the start where that way is not clear: passive joints go on turning where a walk comes back
//! to where it was by another way. Threads share a motion in parts, each begun from the start; where the end of a part
//! does not lead to the next, that one is followed once more, so that the outcome is that of a single thread.

use crate::error::{Error, expect_length};
use crate::loops::continuation::{March, Stand, greatest};
use crate::loops::cut::Loops;
use crate::loops::segment::Part;
use crate::simd::dispatch::Backend;
use rayon::prelude::*;

/// Longest step of an active joint between samples tried as beginnings of a motion, rad (or mechanism sizes).
const APART: f64 = 0.05;
/// Samples of a part, and poses that a thread takes at a time where each is reached from the start.
const PART: usize = 512;
const SHARE: usize = 32;
/// Two poses of one part's beginning are one where no joint differs by more, rad (or mechanism sizes).
const SAME: f64 = 1e-6;

/// When a pose counts as closed.
#[derive(Debug, Clone, Copy)]
pub struct Limits {
    /// Largest gap, as a share of the mechanism's size.
    pub closed: f64,
    /// Least singular value of the gaps' Jacobian by the passive joints, its columns of unit length.
    pub singular: f64,
}

/// How joints follow where cuts do not settle them: positions are constant x active + offset.
#[derive(Debug, Clone, Copy)]
pub struct Linear<'a> {
    /// Joints x active; rows of the joints that cuts settle are zero.
    pub constant: &'a [f64],
    /// Of each joint.
    pub offset: &'a [f64],
}

/// A tree with cuts, and the way in which they close.
#[derive(Debug, Clone)]
pub struct Branch {
    pub(crate) loops: Loops,
    pub(crate) limits: Limits,
    pub(crate) active: Vec<usize>,
    pub(crate) unknown: Vec<usize>,
    pub(crate) constant: Vec<f64>,
    pub(crate) offset: Vec<f64>,
    /// Joints that move as `constant` says.
    pub(crate) leads: Vec<usize>,
    /// Which rates of the unknown joints vary, unknown x active; the others are zero.
    pub(crate) varying: Vec<bool>,
    pub(crate) start: Stand,
    pub(crate) backend: Backend,
}

/// A motion's samples, samples x active: positions, and velocities or none.
#[derive(Debug, Clone, Copy)]
pub struct Path<'a> {
    pub position: &'a [f64],
    pub velocity: &'a [f64],
}

/// What follows: positions, samples x joints, rates by active joints and their change with time, samples x joints x
/// active. Rates and change may be empty where they are not wanted.
#[derive(Debug)]
pub struct Followed<'a> {
    pub position: &'a mut [f64],
    pub rates: &'a mut [f64],
    pub change: &'a mut [f64],
}

/// The first sample that is not reached, and the last closed pose on the way there.
#[derive(Debug, Clone, PartialEq)]
pub struct Stop {
    pub sample: usize,
    pub pose: Vec<f64>,
}

impl Branch {
    /// Check the parts and put them together. The cuts are closed at the start pose, of all joints.
    pub fn new(
        loops: &Loops,
        active: &[usize],
        unknown: &[usize],
        linear: &Linear,
        start: &[f64],
        varying: &[bool],
        limits: Limits,
    ) -> Result<Branch, Error> {
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
        expect_length("constant", linear.constant.len(), n * a)?;
        expect_length("offset", linear.offset.len(), n)?;
        expect_length("start", start.len(), n)?;
        expect_length("varying", varying.len(), n * a)?;
        let mut branch = Branch {
            loops: loops.clone(),
            limits,
            active: active.to_vec(),
            unknown: unknown.to_vec(),
            constant: linear.constant.to_vec(),
            offset: linear.offset.to_vec(),
            leads: (0..n).filter(|j| linear.constant[j * a..][..a].iter().any(|&rate| rate != 0.0)).collect(),
            varying: unknown.iter().flat_map(|&j| &varying[j * a..][..a]).copied().collect(),
            start: Stand::new(loops.gaps(), n, a, unknown.len()),
            backend: Backend::best(),
        };
        branch.start = March::new(&branch).settled(start);
        Ok(branch)
    }

    /// Number of active joints.
    pub fn active(&self) -> usize {
        self.active.len()
    }

    /// Number of joints.
    pub fn joints(&self) -> usize {
        self.offset.len()
    }

    /// All joints along a motion, and how they follow, until a sample is not reached.
    pub fn follow(&self, path: &Path, out: Followed) -> Result<Option<Stop>, Error> {
        let (n, a) = (self.joints(), self.active());
        let samples = self.samples("position", path.position)?;
        let wanted = if out.change.is_empty() { 0 } else { samples };
        expect_length("velocity", path.velocity.len(), wanted * a)?;
        expect_length("positions of all joints", out.position.len(), samples * n)?;
        expect_length("change", out.change.len(), wanted * n * a)?;
        expect_length("rates", out.rates.len(), if out.rates.is_empty() { 0 } else { samples * n * a })?;
        if samples == 0 {
            return Ok(None);
        }
        let begun = match self.beginning(path.position) {
            Ok(march) => march,
            Err(stop) => return Ok(Some(stop)),
        };
        Ok(self.together(&mut self.parts(path, out), begun))
    }

    /// Whether each pose, samples x active, is reached on the straight way from the start, and where that way ends.
    pub fn reach(&self, targets: &[f64], out: &mut [f64], reached: &mut [bool]) -> Result<(), Error> {
        let (n, a) = (self.joints(), self.active());
        let samples = self.samples("targets", targets)?;
        expect_length("out", out.len(), samples * n)?;
        expect_length("reached", reached.len(), samples)?;
        let shares = targets.par_chunks(SHARE * a).zip(out.par_chunks_mut(SHARE * n));
        shares.zip(reached.par_chunks_mut(SHARE)).for_each(|((targets, out), reached)| {
            let mut march = March::new(self);
            for ((target, out), reached) in targets.chunks_exact(a).zip(out.chunks_exact_mut(n)).zip(reached) {
                march.stand_at(&self.start);
                *reached = march.go(target);
                out.copy_from_slice(&march.stand.q);
            }
        });
        Ok(())
    }

    fn samples(&self, name: &'static str, x: &[f64]) -> Result<usize, Error> {
        let samples = x.len() / self.active();
        expect_length(name, x.len(), samples * self.active())?;
        Ok(samples)
    }

    /// Greatest difference of the active joints' positions, rad (or mechanism sizes).
    fn apart(&self, one: &[f64], other: &[f64]) -> f64 {
        let each = self.active.iter().zip(one.iter().zip(other));
        greatest(each.map(|(&j, (x, y))| ((x - y) / self.loops.unit(j)).abs()))
    }

    /// A march at the first sample: from the start, or back from the first sample that is reached from there.
    fn beginning(&self, position: &[f64]) -> Result<March<'_>, Stop> {
        let a = self.active();
        let target = |k: usize| &position[k * a..][..a];
        let (mut march, mut tried, mut stop) = (March::new(self), 0, None);
        for k in 0..position.len() / a {
            if k > 0 && self.apart(target(k), target(tried)) < APART {
                continue;
            }
            tried = k;
            march.stand_at(&self.start);
            if march.go(target(k)) {
                let back = (0..k).rev().all(|k| march.go(target(k)));
                return if back { Ok(march) } else { Err(stop.unwrap_or_else(|| march.stop(k))) };
            }
            stop.get_or_insert_with(|| march.stop(0));
        }
        Err(stop.unwrap_or_else(|| march.stop(0)))
    }

    fn parts<'a>(&self, path: &Path<'a>, out: Followed<'a>) -> Vec<Part<'a>> {
        let (n, a) = (self.joints(), self.active());
        let positions = path.position.chunks(PART * a).zip(out.position.chunks_mut(PART * n)).enumerate();
        let mut velocities = path.velocity.chunks(PART * a);
        let (mut rates, mut changes) = (out.rates.chunks_mut(PART * n * a), out.change.chunks_mut(PART * n * a));
        let part = |(k, (position, q))| Part {
            first: k * PART,
            position,
            velocity: velocities.next().unwrap_or_default(),
            q,
            rates: rates.next().unwrap_or_default(),
            change: changes.next().unwrap_or_default(),
        };
        positions.map(part).collect()
    }

    /// Follow all parts, those after the first as if the start led to them, and put right those where it does not.
    fn together(&self, parts: &mut [Part], mut begun: March) -> Option<Stop> {
        let (first, rest) = parts.split_first_mut()?;
        if rest.is_empty() {
            return first.follow(&mut begun).err();
        }
        let (led, ends) = rayon::join(
            || first.follow(&mut begun),
            || rest.par_iter_mut().map(|part| part.guessed(self)).collect::<Vec<_>>(),
        );
        let mut stop = led.err();
        for (part, guessed) in rest.iter_mut().zip(ends) {
            if stop.is_some() {
                break;
            }
            if !begun.go_on(&part.position[..self.active()]) {
                stop = Some(begun.stop(part.first));
                break;
            }
            let led = begun.is_at(&part.q[..self.joints()], SAME);
            stop = match guessed.filter(|_| led) {
                Some(Ok(end)) => {
                    begun.stand_at(&end);
                    None
                }
                Some(Err(found)) => Some(found),
                None => part.follow(&mut begun).err(),
            };
        }
        stop
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::loops::cut::{Cut, Frame};
    use crate::mechanism::Joint;

    const EYE: [f64; 9] = [1., 0., 0., 0., 1., 0., 0., 0., 1.];

    /// Two cranks on a base line, the active one shorter than the gap, and a rod on it that ends on the other.
    fn four_bar(reach: f64) -> Branch {
        let bar = |parent, x| Joint { parent, rotation: EYE, translation: [x, 0., 0.], prismatic: false };
        let tip = |link, x| Frame { link: Some(link), rotation: EYE, translation: [x, 0., 0.] };
        let cut = Cut { prismatic: false, frame: tip(1, reach), twin: tip(2, 0.3) };
        let loops = Loops::new(&[bar(None, 0.), bar(Some(0), 0.1), bar(None, 0.4)], &[cut], 0.4).expect("four bars");
        let mut start = [1.0, -0.3, 1.5];
        loops.close(&mut start, &[1, 2], 60, 1e-12).expect("shapes");
        let limits = Limits { closed: 1e-12, singular: 1e-3 };
        let linear = Linear { constant: &[1., 0., 0.], offset: &[0.; 3] };
        Branch::new(&loops, &[0], &[1, 2], &linear, &start, &[true; 3], limits).expect("a branch")
    }

    type Found = (Vec<f64>, Vec<f64>, Vec<f64>, Option<Stop>);

    fn followed(branch: &Branch, position: &[f64], velocity: &[f64]) -> Found {
        let mut made = (vec![0.0; 3 * position.len()], vec![0.0; 3 * position.len()], vec![0.0; 3 * position.len()]);
        let out = Followed { position: &mut made.0, rates: &mut made.1, change: &mut made.2 };
        let stop = branch.follow(&Path { position, velocity }, out).expect("shapes");
        (made.0, made.1, made.2, stop)
    }

    /// A crank that turns round and round.
    fn turns(samples: usize) -> Vec<f64> {
        (0..samples).map(|k| 1.0 + 0.004 * k as f64).collect()
    }

    #[test]
    fn rates_and_their_change_are_those_of_differences() {
        let (branch, h) = (four_bar(0.4), 1e-5);
        for x in [0.2, 1.0, 2.9] {
            let (q, rates, change, stop) = followed(&branch, &[x - h, x, x + h], &[2.0; 3]);
            assert!(stop.is_none());
            for j in 0..3 {
                assert!(((q[6 + j] - q[j]) / (2.0 * h) - rates[3 + j]).abs() < 1e-8);
                assert!(((rates[6 + j] - rates[j]) / h - change[3 + j]).abs() < 1e-8);
            }
        }
    }

    #[test]
    fn every_backend_finds_the_same() {
        let (mut branch, position) = (four_bar(0.4), turns(1009));
        let velocity: Vec<f64> = (0..1009).map(|k| (0.01 * f64::from(k)).sin()).collect();
        branch.backend = Backend::named("portable").expect("is everywhere");
        let (q, rates, change, _) = followed(&branch, &position, &velocity);
        for backend in Backend::available() {
            branch.backend = backend;
            let (other_q, other_rates, other_change, stop) = followed(&branch, &position, &velocity);
            assert!(stop.is_none());
            for (one, other) in [(&q, other_q), (&rates, other_rates), (&change, other_change)] {
                assert!(one.iter().zip(&other).all(|(x, y)| (x - y).abs() < 1e-12), "{backend:?}");
            }
        }
    }

    #[test]
    fn a_coarse_motion_is_that_of_its_samples_among_others() {
        let (branch, fine) = (four_bar(0.4), turns(2001));
        let coarse: Vec<f64> = fine.iter().step_by(40).copied().collect();
        let (q, some) = (followed(&branch, &fine, &[1.0; 2001]), followed(&branch, &coarse, &[1.0; 51]));
        for (k, one) in some.1.chunks_exact(3).enumerate() {
            assert!((0..3).all(|j| (q.0[120 * k + j] - some.0[3 * k + j]).abs() < 1e-12));
            assert!((0..3).all(|j| (q.1[120 * k + j] - one[j]).abs() < 1e-12));
            assert!((0..3).all(|j| (q.2[120 * k + j] - some.2[3 * k + j]).abs() < 1e-11));
        }
    }

    #[test]
    fn many_samples_on_many_threads_are_those_of_one_part_after_the_other() {
        let (branch, position) = (four_bar(0.4), turns(5003));
        let (q, _, _, stop) = followed(&branch, &position, &vec![1.0; 5003]);
        assert!(stop.is_none());
        let mut march = branch.beginning(&position).expect("it closes");
        for (k, x) in position.iter().enumerate() {
            assert!(march.go(&[*x]) && march.is_at(&q[3 * k..][..3], 1e-12), "sample {k}");
        }
    }

    #[test]
    fn what_no_pose_closes_stops_at_its_first_sample_whatever_the_part() {
        // The rod reaches the other crank's tip only on one side.
        let (branch, position) = (four_bar(0.15), turns(3000));
        let stop = followed(&branch, &position, &vec![1.0; 3000]).3.expect("out of reach");
        let far = position[stop.sample];
        assert!(far > stop.pose[0] && far - stop.pose[0] < 0.0041, "{stop:?}");
        let longer: Vec<f64> = (0..600).map(|_| 1.0).chain(position).collect();
        assert_eq!(followed(&branch, &longer, &vec![1.0; 3600]).3.map(|stop| stop.sample), Some(stop.sample + 600));
        let mut reached = [false; 2];
        branch.reach(&[1.1, far], &mut [0.0; 6], &mut reached).expect("shapes");
        assert_eq!(reached, [true, false]);
    }

    #[test]
    fn a_motion_that_begins_out_of_reach_of_the_start_is_no_trouble_where_it_is_led_to() {
        let branch = four_bar(0.15);
        let back: Vec<f64> = turns(100).into_iter().rev().collect();
        assert!(followed(&branch, &back, &[0.0; 100]).3.is_none());
        let stop = followed(&branch, &[f64::NAN, 1.0], &[0.0; 2]).3.expect("no pose");
        assert_eq!(stop.sample, 0);
    }
}
