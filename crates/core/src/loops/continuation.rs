//! From one closed pose to another, along a straight line of the active joints.

use crate::loops::assembly::{Branch, Stop};
use crate::loops::newton::Tried;
use crate::simd::real::Real;

/// Longest step of an active joint from one closed pose to the next, rad (or mechanism sizes), and the shortest tried.
const STRIDE: f64 = 0.1;
const LEAST: f64 = 1e-5;
/// Longest way, rad (or mechanism sizes): further is no motion, but another unit, and would be walked for hours.
const FARTHEST: f64 = 1e4;

/// A closed pose, and what the next one is reached by.
#[derive(Debug, Clone)]
pub(crate) struct Stand {
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
pub(crate) fn greatest(numbers: impl Iterator<Item = f64>) -> f64 {
    numbers.fold(0.0, |most, x| if x > most || x.is_nan() { x } else { most })
}

impl Stand {
    pub(crate) fn new(gaps: usize, joints: usize, active: usize, unknown: usize) -> Stand {
        let zeros = |len| vec![0.0; len];
        Stand {
            q: zeros(joints),
            passive: zeros(gaps * unknown),
            rates: zeros(unknown * active),
            before: zeros(unknown * active),
            moved: zeros(active),
        }
    }

    /// Stand at a pose that was tried, in a lane.
    #[inline(always)]
    pub(crate) fn move_to<N: Real>(&mut self, branch: &Branch, tried: &Tried<N>, lane: usize) {
        let a = branch.active();
        for (moved, &j) in self.moved.iter_mut().zip(&branch.active) {
            *moved = tried.q[j].scatter()[lane] - self.q[j];
        }
        std::mem::swap(&mut self.rates, &mut self.before);
        copy(&tried.q, lane, &mut self.q);
        copy(&tried.passive, lane, &mut self.passive);
        for (own, &j) in self.rates.chunks_exact_mut(a).zip(&branch.unknown) {
            copy(&tried.rates[j * a..], lane, own);
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
pub(crate) struct March<'a> {
    pub branch: &'a Branch,
    pub stand: Stand,
    tried: Tried<f64>,
    /// Active joints at the beginning.
    from: Vec<f64>,
}

impl<'a> March<'a> {
    /// It stands nowhere yet.
    pub(crate) fn new(branch: &'a Branch) -> March<'a> {
        March { branch, stand: branch.start.clone(), tried: Tried::new(branch), from: vec![0.0; branch.active()] }
    }

    /// The stand at a closed pose of all joints.
    pub(crate) fn settled(mut self, q: &[f64]) -> Stand {
        self.tried.q.copy_from_slice(q);
        self.tried.measure(self.branch);
        self.tried.follow(self.branch);
        self.stand.move_to(self.branch, &self.tried, 0);
        self.stand.moved.fill(0.0);
        self.stand
    }

    /// Stand elsewhere.
    pub(crate) fn stand_at(&mut self, other: &Stand) {
        let stand = &mut self.stand;
        stand.q.copy_from_slice(&other.q);
        stand.passive.copy_from_slice(&other.passive);
        stand.rates.copy_from_slice(&other.rates);
        stand.before.copy_from_slice(&other.before);
        stand.moved.copy_from_slice(&other.moved);
    }

    /// Whether it stands at a pose of all joints.
    pub(crate) fn is_at(&self, q: &[f64], same: f64) -> bool {
        let loops = &self.branch.loops;
        self.stand.q.iter().zip(q).enumerate().all(|(j, (x, y))| ((x - y) / loops.unit(j)).abs() < same)
    }

    /// What says that a sample was not reached.
    pub(crate) fn stop(&self, sample: usize) -> Stop {
        Stop { sample, pose: self.stand.q.clone() }
    }

    /// Go to a target from here, or else from the start: passive joints do not jump where the way from here is clear.
    /// Whether it was reached; else it stands at the last closed pose on the way from here.
    pub(crate) fn go_on(&mut self, target: &[f64]) -> bool {
        if self.go(target) {
            return true;
        }
        let stuck = self.stand.clone();
        self.stand_at(&self.branch.start);
        let reached = self.go(target);
        if !reached {
            self.stand = stuck;
        }
        reached
    }

    /// Whether a target is one step away.
    pub(crate) fn is_near(&self, target: &[f64]) -> bool {
        self.far(target) <= STRIDE
    }

    /// Greatest way of an active joint to a target, rad (or mechanism sizes).
    fn far(&self, target: &[f64]) -> f64 {
        let each = self.branch.active.iter().zip(target);
        greatest(each.map(|(&j, x)| ((x - self.stand.q[j]) / self.branch.loops.unit(j)).abs()))
    }

    /// Go straight to a target of the active joints; whether it was reached. Else it stands at the last closed pose.
    ///
    /// A step is taken where it closes, near where rates lead to, and on the same side of singular poses. Else it is
    /// halved.
    pub(crate) fn go(&mut self, target: &[f64]) -> bool {
        let far = self.far(target);
        if far == 0.0 || !far.is_finite() || far > FARTHEST {
            return far == 0.0;
        }
        self.from.iter_mut().zip(&self.branch.active).for_each(|(from, &j)| *from = self.stand.q[j]);
        let whole = (STRIDE / far).min(1.0);
        let (mut done, mut step) = (0.0, whole);
        loop {
            let next = if done + step >= 1.0 { 1.0 } else { done + step };
            for ((at, from), target) in self.tried.at.iter_mut().zip(&self.from).zip(target) {
                *at = if next == 1.0 { *target } else { target - (1.0 - next) * (target - from) };
            }
            if self.step() {
                if next == 1.0 {
                    return true;
                }
                (done, step) = (next, (2.0 * step).min(whole));
            } else {
                step /= 2.0;
                if step * far <= LEAST {
                    return false;
                }
            }
        }
    }

    /// Take the step to where the active joints are to be next, if it can be taken.
    fn step(&mut self) -> bool {
        let good = self.tried.step(self.branch, &self.stand);
        if good {
            self.tried.follow(self.branch);
            self.stand.move_to(self.branch, &self.tried, 0);
        }
        good
    }
}
