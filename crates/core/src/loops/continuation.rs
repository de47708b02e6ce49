//! Continuation: from one closed configuration to another along a straight line of the active joints.

use crate::loops::assembly::{AssemblyMode, ContinuationStop};
use crate::loops::newton::NewtonIterate;
use crate::simd::real::Real;

/// Largest step of an active joint between closed configurations, rad (or mechanism sizes), and the smallest one that
/// is tried.
const MAX_STEP: f64 = 0.1;
const MIN_STEP: f64 = 1e-5;
/// Largest distance of a target, rad (or mechanism sizes): larger steps almost certainly mean wrong units; they are
/// refused instead of iterating.
const MAX_DISTANCE: f64 = 1e4;

/// A closed configuration, with what the predictor of the next one needs.
#[derive(Debug, Clone)]
pub(crate) struct ClosedConfiguration {
    /// Positions of all joints.
    pub q: Vec<f64>,
    /// Jacobian of the gaps with respect to the unknown joints, by columns.
    pub passive_jacobian: Vec<f64>,
    /// Rates of the unknown joints with respect to the active ones, unknown x active; the same at the configuration
    /// before, and the displacement from there, zero at the beginning.
    pub rates: Vec<f64>,
    pub previous_rates: Vec<f64>,
    pub last_displacement: Vec<f64>,
}

/// Maximum of non-negative numbers; NaN if any is NaN.
pub(crate) fn max_or_nan(numbers: impl Iterator<Item = f64>) -> f64 {
    numbers.fold(0.0, |most, x| if x > most || x.is_nan() { x } else { most })
}

impl ClosedConfiguration {
    pub(crate) fn new(gaps: usize, joints: usize, active: usize, unknown: usize) -> ClosedConfiguration {
        let zeros = |len| vec![0.0; len];
        ClosedConfiguration {
            q: zeros(joints),
            passive_jacobian: zeros(gaps * unknown),
            rates: zeros(unknown * active),
            previous_rates: zeros(unknown * active),
            last_displacement: zeros(active),
        }
    }

    /// Adopt one lane of an accepted iterate.
    #[inline(always)]
    pub(crate) fn adopt<N: Real>(&mut self, mode: &AssemblyMode, iterate: &NewtonIterate<N>, lane: usize) {
        let a = mode.active();
        for (moved, &j) in self.last_displacement.iter_mut().zip(&mode.active) {
            *moved = iterate.q[j].scatter()[lane] - self.q[j];
        }
        std::mem::swap(&mut self.rates, &mut self.previous_rates);
        copy(&iterate.q, lane, &mut self.q);
        copy(&iterate.passive_jacobian, lane, &mut self.passive_jacobian);
        for (own, &j) in self.rates.chunks_exact_mut(a).zip(&mode.unknown) {
            copy(&iterate.rates[j * a..], lane, own);
        }
    }
}

/// Copy one lane of as many numbers as `out` has.
#[inline(always)]
fn copy<N: Real>(numbers: &[N], lane: usize, out: &mut [f64]) {
    for (out, number) in out.iter_mut().zip(numbers) {
        *out = number.scatter()[lane];
    }
}

/// A path of closed configurations, and the buffers that it needs.
pub(crate) struct Continuation<'a> {
    pub mode: &'a AssemblyMode,
    pub configuration: ClosedConfiguration,
    iterate: NewtonIterate<f64>,
    /// Active joints at the beginning of the current line.
    from: Vec<f64>,
}

impl<'a> Continuation<'a> {
    /// A continuation at the start pose.
    pub(crate) fn new(mode: &'a AssemblyMode) -> Continuation<'a> {
        Continuation {
            mode,
            configuration: mode.start.clone(),
            iterate: NewtonIterate::new((), mode),
            from: vec![0.0; mode.active()],
        }
    }

    /// The closed configuration at a pose of all joints.
    pub(crate) fn configuration_at(mut self, q: &[f64]) -> ClosedConfiguration {
        self.iterate.q.copy_from_slice(q);
        self.iterate.evaluate(self.mode);
        self.iterate.solve_rates(self.mode);
        self.configuration.adopt(self.mode, &self.iterate, 0);
        self.configuration.last_displacement.fill(0.0);
        self.configuration
    }

    /// Move to another closed configuration.
    pub(crate) fn restart_from(&mut self, other: &ClosedConfiguration) {
        let configuration = &mut self.configuration;
        configuration.q.copy_from_slice(&other.q);
        configuration.passive_jacobian.copy_from_slice(&other.passive_jacobian);
        configuration.rates.copy_from_slice(&other.rates);
        configuration.previous_rates.copy_from_slice(&other.previous_rates);
        configuration.last_displacement.copy_from_slice(&other.last_displacement);
    }

    /// Whether the current configuration is the given pose.
    pub(crate) fn is_at(&self, q: &[f64], same: f64) -> bool {
        let loops = &self.mode.loops;
        self.configuration.q.iter().zip(q).enumerate().all(|(j, (x, y))| ((x - y) / loops.joint_scale(j)).abs() < same)
    }

    /// The result for a sample that is not reached.
    pub(crate) fn stop(&self, sample: usize) -> ContinuationStop {
        ContinuationStop { sample, last_pose: self.configuration.q.clone() }
    }

    /// Advance to a target from here, or else from the start: passive joints do not jump where the path from here is
    /// clear. Returns whether the target was reached; if not, the configuration is the last closed one on the way from
    /// here.
    pub(crate) fn advance_or_restart(&mut self, target: &[f64]) -> bool {
        if self.advance_to(target) {
            return true;
        }
        let last_closed = self.configuration.clone();
        self.restart_from(&self.mode.start);
        let reached = self.advance_to(target);
        if !reached {
            self.configuration = last_closed;
        }
        reached
    }

    /// Whether a target is within one step.
    pub(crate) fn is_near(&self, target: &[f64]) -> bool {
        self.distance(target) <= MAX_STEP
    }

    /// Largest distance of an active joint from a target, rad (or mechanism sizes).
    fn distance(&self, target: &[f64]) -> f64 {
        let each = self.mode.active.iter().zip(target);
        max_or_nan(each.map(|(&j, x)| ((x - self.configuration.q[j]) / self.mode.loops.joint_scale(j)).abs()))
    }

    /// Advance along a straight line to a target of the active joints; returns whether it was reached. If not, the
    /// configuration is the last closed one.
    ///
    /// A step is accepted where the loops close, close to the prediction, on the same side of singular poses. Otherwise
    /// it is halved.
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
            for ((at, from), target) in self.iterate.target.iter_mut().zip(&self.from).zip(target) {
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

    /// Try one step to the iterate's target, and adopt it if it is accepted.
    fn step(&mut self) -> bool {
        let good = self.iterate.step(self.mode, &self.configuration);
        if good {
            self.iterate.solve_rates(self.mode);
            self.configuration.adopt(self.mode, &self.iterate, 0);
        }
        good
    }
}
