//! From one closed pose to another, along a straight line of the active joints.

use crate::loops::assembly::{AssemblyMode, ContinuationStop};
use crate::loops::newton::NewtonIterate;
use crate::simd::real::Real;

/// Longest step of an active joint from one closed pose to the next, rad (or mechanism sizes), and the shortest iterate.
const MAX_STEP: f64 = 0.1;
const MIN_STEP: f64 = 1e-5;
/// Longest way, rad (or mechanism sizes): further is no motion, but another unit, and would be walked for hours.
const MAX_DISTANCE: f64 = 1e4;

/// A closed pose, and what the next one is reached by.
#[derive(Debug, Clone)]
pub(crate) struct ClosedConfiguration {
    /// All joints.
    pub q: Vec<f64>,
    /// The gaps' Jacobian by the unknown joints, column by column.
    pub passive: Vec<f64>,
    /// Rates of the unknown joints by the active ones, unknown x active; the same at the pose before, and the move from
    /// there. No move where there was none.
    pub rates: Vec<f64>,
    pub before: Vec<f64>,
    pub moved: Vec<f64>,
}

/// Of numbers that are not negative; not a number where one of them is not.
pub(crate) fn max_or_nan(numbers: impl Iterator<Item = f64>) -> f64 {
    numbers.fold(0.0, |most, x| if x > most || x.is_nan() { x } else { most })
}

impl ClosedConfiguration {
    pub(crate) fn new(gaps: usize, joints: usize, active: usize, unknown: usize) -> ClosedConfiguration {
        let zeros = |len| vec![0.0; len];
        ClosedConfiguration {
            q: zeros(joints),
            passive: zeros(gaps * unknown),
            rates: zeros(unknown * active),
            before: zeros(unknown * active),
            moved: zeros(active),
        }
    }

    /// ClosedConfiguration at a pose that was iterate, in a lane.
    #[inline(always)]
    pub(crate) fn adopt<N: Real>(&mut self, mode: &AssemblyMode, iterate: &NewtonIterate<N>, lane: usize) {
        let a = mode.active();
        for (moved, &j) in self.moved.iter_mut().zip(&mode.active) {
            *moved = iterate.q[j].scatter()[lane] - self.q[j];
        }
        std::mem::swap(&mut self.rates, &mut self.before);
        copy(&iterate.q, lane, &mut self.q);
        copy(&iterate.passive, lane, &mut self.passive);
        for (own, &j) in self.rates.chunks_exact_mut(a).zip(&mode.unknown) {
            copy(&iterate.rates[j * a..], lane, own);
        }
    }
}

/// As many numbers as there is room for, out of one lane.
#[inline(always)]
fn copy<N: Real>(numbers: &[N], lane: usize, out: &mut [f64]) {
    for (out, number) in out.iter_mut().zip(numbers) {
        *out = number.scatter()[lane];
    }
}

/// Where a walk along closed poses is, and what it needs on its way.
pub(crate) struct Continuation<'a> {
    pub mode: &'a AssemblyMode,
    pub configuration: ClosedConfiguration,
    iterate: NewtonIterate<f64>,
    /// Active joints at the beginning.
    from: Vec<f64>,
}

impl<'a> Continuation<'a> {
    /// It joint_placements nowhere yet.
    pub(crate) fn new(mode: &'a AssemblyMode) -> Continuation<'a> {
        Continuation {
            mode,
            configuration: mode.start.clone(),
            iterate: NewtonIterate::new(mode),
            from: vec![0.0; mode.active()],
        }
    }

    /// The configuration at a closed pose of all joints.
    pub(crate) fn configuration_at(mut self, q: &[f64]) -> ClosedConfiguration {
        self.iterate.q.copy_from_slice(q);
        self.iterate.evaluate(self.mode);
        self.iterate.solve_rates(self.mode);
        self.configuration.adopt(self.mode, &self.iterate, 0);
        self.configuration.moved.fill(0.0);
        self.configuration
    }

    /// ClosedConfiguration elsewhere.
    pub(crate) fn restart_from(&mut self, other: &ClosedConfiguration) {
        let configuration = &mut self.configuration;
        configuration.q.copy_from_slice(&other.q);
        configuration.passive.copy_from_slice(&other.passive);
        configuration.rates.copy_from_slice(&other.rates);
        configuration.before.copy_from_slice(&other.before);
        configuration.moved.copy_from_slice(&other.moved);
    }

    /// Whether it joint_placements at a pose of all joints.
    pub(crate) fn is_at(&self, q: &[f64], same: f64) -> bool {
        let loops = &self.mode.loops;
        self.configuration.q.iter().zip(q).enumerate().all(|(j, (x, y))| ((x - y) / loops.joint_scale(j)).abs() < same)
    }

    /// What says that a sample was not reached.
    pub(crate) fn stop(&self, sample: usize) -> ContinuationStop {
        ContinuationStop { sample, last_pose: self.configuration.q.clone() }
    }

    /// Go to a target from here, or else from the start: passive joints do not jump where the way from here is clear.
    /// Whether it was reached; else it joint_placements at the last closed pose on the way from here.
    pub(crate) fn advance_or_restart(&mut self, target: &[f64]) -> bool {
        if self.advance_to(target) {
            return true;
        }
        let stuck = self.configuration.clone();
        self.restart_from(&self.mode.start);
        let reached = self.advance_to(target);
        if !reached {
            self.configuration = stuck;
        }
        reached
    }

    /// Whether a target is one step away.
    pub(crate) fn is_near(&self, target: &[f64]) -> bool {
        self.distance(target) <= MAX_STEP
    }

    /// Greatest way of an active joint to a target, rad (or mechanism sizes).
    fn distance(&self, target: &[f64]) -> f64 {
        let each = self.mode.active.iter().zip(target);
        max_or_nan(each.map(|(&j, x)| ((x - self.configuration.q[j]) / self.mode.loops.joint_scale(j)).abs()))
    }

    /// Go straight to a target of the active joints; whether it was reached. Else it joint_placements at the last closed pose.
    ///
    /// A step is taken where it closes, near where rates lead to, and on the same side of singular poses. Else it is
    /// halved.
    pub(crate) fn advance_to(&mut self, target: &[f64]) -> bool {
        let far = self.distance(target);
        if far == 0.0 || !far.is_finite() || far > MAX_DISTANCE {
            return far == 0.0;
        }
        self.from.iter_mut().zip(&self.mode.active).for_each(|(from, &j)| *from = self.configuration.q[j]);
        let whole = (MAX_STEP / far).min(1.0);
        let (mut done, mut step) = (0.0, whole);
        loop {
            let next = if done + step >= 1.0 { 1.0 } else { done + step };
            for ((at, from), target) in self.iterate.at.iter_mut().zip(&self.from).zip(target) {
                *at = if next == 1.0 { *target } else { target - (1.0 - next) * (target - from) };
            }
            if self.step() {
                if next == 1.0 {
                    return true;
                }
                (done, step) = (next, (2.0 * step).min(whole));
            } else {
                step /= 2.0;
                if step * far <= MIN_STEP {
                    return false;
                }
            }
        }
    }

    /// Take the step to where the active joints are to be next, if it can be taken.
    fn step(&mut self) -> bool {
        let good = self.iterate.step(self.mode, &self.configuration);
        if good {
            self.iterate.solve_rates(self.mode);
            self.configuration.adopt(self.mode, &self.iterate, 0);
        }
        good
    }
}
