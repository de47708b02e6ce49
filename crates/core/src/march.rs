//! From one closed pose to another, along a straight line of the active joints.

use crate::branch::{Branch, Stop};
use crate::cuts::{Loops, Shape};
use crate::dual::Dual;
use crate::factor::{Factor, dot, same_side};

/// Longest step of an active joint from one closed pose to the next, rad (or mechanism sizes), and the shortest tried.
const STRIDE: f64 = 0.1;
const LEAST: f64 = 1e-5;
/// A step's passive joints may be this far from where their rates led to, rad (or mechanism sizes).
const NEAR: f64 = 0.1;
/// Newton's steps for each step of the way; after one this short, rad (or m), what is left is its square.
const STEPS: usize = 8;
const LAST: f64 = 1e-8;

/// A closed pose, and what the next one is reached by.
#[derive(Debug, Clone)]
pub(crate) struct Stand {
    /// All joints.
    pub q: Vec<f64>,
    /// The gaps' Jacobian by the unknown joints, column by column, and its factor.
    passive: Vec<f64>,
    factor: Factor,
    /// Rates of the unknown joints by the active ones, unknown x active; the same at the pose before, and the move from
    /// there. No move where there was none.
    rates: Vec<f64>,
    before: Vec<f64>,
    moved: Vec<f64>,
}

/// Of numbers that are not negative; not a number where one of them is not.
pub(crate) fn greatest(numbers: impl Iterator<Item = f64>) -> f64 {
    numbers.fold(0.0, |most, x| if x > most || x.is_nan() { x } else { most })
}

impl Stand {
    pub(crate) fn new(loops: &Loops, active: usize, unknown: usize) -> Stand {
        let (m, zeros) = (loops.gaps(), |len| vec![0.0; len]);
        Stand {
            q: zeros(loops.joints()),
            passive: zeros(m * unknown),
            factor: Factor::new(m, unknown),
            rates: zeros(unknown * active),
            before: zeros(unknown * active),
            moved: zeros(active),
        }
    }
}

/// Where a walk along closed poses is, and what it needs on its way.
pub(crate) struct March<'a> {
    branch: &'a Branch,
    pub stand: Stand,
    shape: Shape<f64>,
    moving: Shape<Dual>,
    passive: Vec<f64>,
    factor: Factor,
    /// Joints where rates lead to, and where Newton's steps lead to from there.
    ahead: Vec<f64>,
    q: Vec<f64>,
    /// Active joints at the beginning and at the next step, and the move there.
    from: Vec<f64>,
    at: Vec<f64>,
    way: Vec<f64>,
    /// A right side, and joints' rates or a small matrix.
    right: Vec<f64>,
    scratch: Vec<f64>,
}

impl<'a> March<'a> {
    /// It stands nowhere yet.
    pub(crate) fn new(branch: &'a Branch) -> March<'a> {
        let (m, n, u, a) = (branch.loops.gaps(), branch.joints(), branch.unknown.len(), branch.active());
        let zeros = |len| vec![0.0; len];
        March {
            branch,
            stand: Stand::new(&branch.loops, a, u),
            shape: branch.loops.shape(),
            moving: branch.loops.shape(),
            passive: zeros(m * u),
            factor: Factor::new(m, u),
            ahead: zeros(n),
            q: zeros(n),
            from: zeros(a),
            at: zeros(a),
            way: zeros(a),
            right: zeros(m),
            scratch: zeros((u * u).max(n * a)),
        }
    }

    /// The stand at a closed pose of all joints.
    pub(crate) fn settled(mut self, q: &[f64]) -> Stand {
        self.q.copy_from_slice(q);
        self.measure();
        self.accept();
        self.stand.moved.fill(0.0);
        self.stand
    }

    /// Stand elsewhere.
    pub(crate) fn stand_at(&mut self, other: &Stand) {
        let stand = &mut self.stand;
        stand.q.copy_from_slice(&other.q);
        stand.passive.copy_from_slice(&other.passive);
        stand.factor.clone_from(&other.factor);
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

    /// Go to a target from here or from the start, first from the nearer one; whether either way is clear. Where none
    /// is, it stands at the last closed pose on the way from here.
    pub(crate) fn go_on(&mut self, target: &[f64], start: &Stand) -> bool {
        if self.far(&self.stand.q, target) <= self.far(&start.q, target) {
            if self.go(target) {
                return true;
            }
            let stuck = self.stand.clone();
            self.stand_at(start);
            let reached = self.go(target);
            if !reached {
                self.stand = stuck;
            }
            return reached;
        }
        let here = self.stand.clone();
        self.stand_at(start);
        if self.go(target) {
            return true;
        }
        self.stand = here;
        self.go(target)
    }

    /// Greatest way of an active joint from a pose of all joints to a target, rad (or mechanism sizes).
    fn far(&self, q: &[f64], target: &[f64]) -> f64 {
        let each = self.branch.active.iter().zip(target);
        greatest(each.map(|(&j, x)| ((x - q[j]) / self.branch.loops.unit(j)).abs()))
    }

    /// Go straight to a target of the active joints; whether it was reached. Else it stands at the last closed pose.
    ///
    /// A step is taken where it closes, near where rates lead to, and on the same side of singular poses. Else it is
    /// halved.
    pub(crate) fn go(&mut self, target: &[f64]) -> bool {
        let far = self.far(&self.stand.q, target);
        if far == 0.0 || !far.is_finite() {
            return far == 0.0;
        }
        self.from.iter_mut().zip(&self.branch.active).for_each(|(from, &j)| *from = self.stand.q[j]);
        let whole = (STRIDE / far).min(1.0);
        let (mut done, mut step) = (0.0, whole);
        loop {
            let next = if done + step >= 1.0 { 1.0 } else { done + step };
            for ((at, from), target) in self.at.iter_mut().zip(&self.from).zip(target) {
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
        let branch = self.branch;
        self.look_ahead();
        self.q.copy_from_slice(&self.ahead);
        for _ in 0..STEPS {
            self.measure();
            self.right.copy_from_slice(&self.shape.gaps);
            self.factor.solve(&mut self.right);
            branch.unknown.iter().zip(&self.right).for_each(|(&j, x)| self.q[j] -= x);
            if self.right[..branch.unknown.len()].iter().all(|x| x.abs() <= LAST) {
                break;
            }
        }
        self.measure();
        let (closed, rows) = (branch.limits.closed * branch.loops.size(), self.right.len());
        let (near, gaps) = (self.ahead.iter().zip(&self.q).enumerate(), &self.shape.gaps);
        let good = gaps.iter().all(|gap| gap.abs() < closed)
            && near.into_iter().all(|(j, (x, y))| ((x - y) / branch.loops.unit(j)).abs() < NEAR)
            && same_side(&self.stand.passive, &self.passive, rows, &mut self.scratch)
            && self.factor.is_open(branch.limits.singular, &mut self.scratch);
        if good {
            self.stand.moved.copy_from_slice(&self.way);
            self.accept();
        }
        good
    }

    /// Where rates lead to; they change as they did since the pose before.
    fn look_ahead(&mut self) {
        let (branch, stand, a) = (self.branch, &self.stand, self.at.len());
        for (e, &j) in branch.active.iter().enumerate() {
            self.way[e] = self.at[e] - stand.q[j];
        }
        let last = dot(&stand.moved, &stand.moved);
        let share = if last > 0.0 { (dot(&self.way, &stand.moved) / last).clamp(-1.0, 1.0) / 2.0 } else { 0.0 };
        for (j, ahead) in self.ahead.iter_mut().enumerate() {
            *ahead = branch.offset[j] + dot(&branch.constant[j * a..][..a], &self.at);
        }
        for (i, &j) in branch.unknown.iter().enumerate() {
            let now = dot(&stand.rates[i * a..][..a], &self.way);
            let before = dot(&stand.before[i * a..][..a], &self.way);
            self.ahead[j] = stand.q[j] + now + share * (now - before);
        }
    }

    /// Gaps and Jacobian at the pose being tried, and the factor of its passive part.
    fn measure(&mut self) {
        let (q, n) = (&self.q, self.q.len());
        self.branch.loops.measure(|j| q[j], &mut self.shape);
        for (column, &j) in self.passive.chunks_exact_mut(self.right.len()).zip(&self.branch.unknown) {
            for (entry, row) in column.iter_mut().zip(self.shape.jacobian.chunks_exact(n)) {
                *entry = row[j];
            }
        }
        self.factor.decompose(&self.passive);
    }

    /// Stand at the pose just measured.
    fn accept(&mut self) {
        let (stand, branch, a) = (&mut self.stand, self.branch, self.at.len());
        std::mem::swap(&mut stand.passive, &mut self.passive);
        std::mem::swap(&mut stand.factor, &mut self.factor);
        std::mem::swap(&mut stand.rates, &mut stand.before);
        stand.q.copy_from_slice(&self.q);
        for e in 0..a {
            for (right, row) in self.right.iter_mut().zip(self.shape.jacobian.chunks_exact(self.q.len())) {
                *right = branch.leads.iter().map(|&j| row[j] * branch.constant[j * a + e]).sum();
            }
            stand.factor.solve(&mut self.right);
            (0..branch.unknown.len()).for_each(|i| stand.rates[i * a + e] = -self.right[i]);
        }
    }

    /// Rates of all joints by the active ones, joints x active.
    pub(crate) fn rates_into(&self, varying: &[bool], out: &mut [f64]) {
        let a = self.at.len();
        out.copy_from_slice(&self.branch.constant);
        for (i, &j) in self.branch.unknown.iter().enumerate() {
            for e in 0..a {
                out[j * a + e] = if varying[i * a + e] { self.stand.rates[i * a + e] } else { 0.0 };
            }
        }
    }

    /// Their change with time, where the active joints move with a velocity.
    pub(crate) fn change_into(&mut self, varying: &[bool], velocity: &[f64], out: &mut [f64]) {
        let (branch, a, n) = (self.branch, velocity.len(), self.q.len());
        let mut rates = std::mem::take(&mut self.scratch);
        self.rates_into(varying, &mut rates[..n * a]);
        let speed = |j: usize| rates[j * a..][..a].iter().zip(velocity).map(|(rate, v)| rate * v).sum();
        let q = &self.stand.q;
        branch.loops.measure(|j| Dual { value: q[j], rate: speed(j) }, &mut self.moving);
        out.fill(0.0);
        for e in 0..a {
            for (right, row) in self.right.iter_mut().zip(self.moving.jacobian.chunks_exact(n)) {
                let each = row.iter().zip(rates[e..].iter().step_by(a));
                *right = each.map(|(entry, rate)| entry.rate * rate).sum();
            }
            self.stand.factor.solve(&mut self.right);
            for (i, &j) in branch.unknown.iter().enumerate() {
                out[j * a + e] = if varying[i * a + e] { -self.right[i] } else { 0.0 };
            }
        }
        self.scratch = rates;
    }
}
