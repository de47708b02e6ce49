//! Poses that are tried: closed by Newton's steps from where rates lead to, and how all joints follow there.

use crate::linalg::small_qr::{Factor, dot, same_side};
use crate::loops::assembly::Branch;
use crate::loops::continuation::Stand;
use crate::loops::gap::Shape;
use crate::simd::real::Dual;
use crate::simd::real::{Number, Real};

/// A step's passive joints may be this far from where their rates led to, rad (or mechanism sizes).
const NEAR: f64 = 0.1;
/// Newton's steps for each pose; after one this short, rad (or m), another is taken with the same factor, and is the last
/// where it is this short itself: what is left is their product.
const STEPS: usize = 8;
const SHORT: f64 = 1e-5;
const LAST: f64 = 1e-9;

/// Poses side by side, each reached in one step from the same stand.
pub(crate) struct Tried<N> {
    /// Where the active joints are to be, and how far that is from the stand.
    pub at: Vec<N>,
    way: Vec<N>,
    /// All joints, and where rates led them to.
    pub q: Vec<N>,
    ahead: Vec<N>,
    /// Rates of all joints by the active ones, joints x active, and their change with time.
    pub rates: Vec<N>,
    pub change: Vec<N>,
    shape: Shape<N>,
    dual: Vec<Dual<N>>,
    moving: Shape<Dual<N>>,
    /// The gaps' Jacobian by the unknown joints, column by column, and its factor.
    pub passive: Vec<N>,
    factor: Factor<N>,
    /// A right side, and a small matrix.
    right: Vec<N>,
    scratch: Vec<N>,
}

impl<N: Real> Tried<N> {
    pub(crate) fn new(branch: &Branch) -> Tried<N> {
        let (m, n, u, a) = (branch.loops.gaps(), branch.joints(), branch.unknown.len(), branch.active());
        let zeros = |len| vec![N::of(0.0); len];
        Tried {
            at: zeros(a),
            way: zeros(a),
            q: zeros(n),
            ahead: zeros(n),
            rates: branch.constant.iter().map(|&rate| N::of(rate)).collect(),
            change: zeros(n * a),
            shape: branch.loops.shape(),
            dual: vec![Dual::of(0.0); n],
            moving: branch.loops.shape(),
            passive: zeros(m * u),
            factor: Factor::new(m, u),
            right: zeros(m),
            scratch: zeros(u * u),
        }
    }

    /// Step from a stand to where the active joints are to be; whether that can be taken: whether the cuts close, near
    /// where rates lead to, and on the same side of singular poses.
    #[inline(always)]
    pub(crate) fn step(&mut self, branch: &Branch, stand: &Stand) -> bool {
        self.look_ahead(branch, stand);
        self.q.copy_from_slice(&self.ahead);
        let mut good = self.close(branch);
        for &left in &self.right[branch.unknown.len()..] {
            good = left.if_below(branch.limits.closed * branch.loops.size(), good);
        }
        for (j, (&x, &y)) in self.ahead.iter().zip(&self.q).enumerate() {
            good = (x - y).if_below(NEAR * branch.loops.unit(j), good);
        }
        good.exceeds(0.0)
            && same_side(&stand.passive, &self.passive, self.right.len(), &mut self.scratch)
            && self.factor.is_open(branch.limits.singular, &mut self.scratch)
    }

    /// Where rates lead to; they change as they did since the pose before.
    #[inline(always)]
    fn look_ahead(&mut self, branch: &Branch, stand: &Stand) {
        let (a, half) = (self.at.len(), N::of(0.5));
        for (e, &j) in branch.active.iter().enumerate() {
            self.way[e] = self.at[e] - N::of(stand.q[j]);
        }
        for (j, ahead) in self.ahead.iter_mut().enumerate() {
            *ahead = N::of(branch.offset[j]) + along(&self.at, &branch.constant[j * a..]);
        }
        let last = dot(&stand.moved, &stand.moved);
        let share = along(&self.way, &stand.moved).times(if last > 0.0 { 0.5 / last } else { 0.0 });
        let share = N::select(share, half, half, N::select(half.times(-1.0), share, half.times(-1.0), share));
        for (i, &j) in branch.unknown.iter().enumerate() {
            let now = along(&self.way, &stand.rates[i * a..]);
            let before = along(&self.way, &stand.before[i * a..]);
            self.ahead[j] = (N::of(stand.q[j]) + now).plus(share, now - before);
        }
    }

    /// Newton's steps from where the joints are; good where they came to an end. Beside the unknown joints' last step the
    /// right side is what that leaves of the gaps.
    #[inline(always)]
    fn close(&mut self, branch: &Branch) -> N {
        for _ in 0..STEPS {
            self.measure(branch);
            if !self.move_on(branch, SHORT).exceeds(0.0) {
                continue;
            }
            branch.loops.measure_gaps(&self.q, &mut self.shape);
            let good = self.move_on(branch, LAST);
            if good.exceeds(0.0) {
                return good;
            }
        }
        N::of(0.0)
    }

    /// One step with the factor that is there; good where it was short.
    #[inline(always)]
    fn move_on(&mut self, branch: &Branch, short: f64) -> N {
        self.right.copy_from_slice(&self.shape.gaps);
        self.factor.solve(&mut self.right);
        let mut good = N::of(1.0);
        for (&j, &x) in branch.unknown.iter().zip(&self.right) {
            self.q[j] = self.q[j] - x;
            good = x.if_below(short, good);
        }
        good
    }

    /// Gaps and Jacobian where the joints are, and the factor of its passive part.
    #[inline(always)]
    pub(crate) fn measure(&mut self, branch: &Branch) {
        let n = self.q.len();
        branch.loops.measure(&self.q, &mut self.shape);
        for (column, &j) in self.passive.chunks_exact_mut(self.right.len()).zip(&branch.unknown) {
            for (entry, row) in column.iter_mut().zip(self.shape.jacobian.chunks_exact(n)) {
                *entry = row[j];
            }
        }
        self.factor.decompose(&self.passive);
    }

    /// Rates at the pose measured.
    #[inline(always)]
    pub(crate) fn follow(&mut self, branch: &Branch) {
        let a = self.at.len();
        for e in 0..a {
            for (right, row) in self.right.iter_mut().zip(self.shape.jacobian.chunks_exact(self.q.len())) {
                *right = N::of(0.0);
                for &j in &branch.leads {
                    *right = right.plus_times(row[j], -branch.constant[j * a + e]);
                }
            }
            self.factor.solve(&mut self.right);
            put(branch, e, &self.right, &mut self.rates);
        }
    }

    /// Change of the rates there, where the active joints move with a velocity.
    #[inline(always)]
    pub(crate) fn follow_on(&mut self, branch: &Branch, velocity: &[N]) {
        let a = velocity.len();
        for (j, dual) in self.dual.iter_mut().enumerate() {
            *dual = Dual { value: self.q[j], rate: dot(&self.rates[j * a..][..a], velocity) };
        }
        branch.loops.measure(&self.dual, &mut self.moving);
        for e in 0..a {
            for (right, row) in self.right.iter_mut().zip(self.moving.jacobian.chunks_exact(self.q.len())) {
                *right = N::of(0.0);
                for (j, entry) in row.iter().enumerate() {
                    *right = right.minus(entry.rate, self.rates[j * a + e]);
                }
            }
            self.factor.solve(&mut self.right);
            put(branch, e, &self.right, &mut self.change);
        }
    }
}

/// Sum of products with constants, as many as there are numbers.
#[inline(always)]
fn along<N: Real>(x: &[N], constants: &[f64]) -> N {
    let mut sum = N::of(0.0);
    for (&x, &constant) in x.iter().zip(constants) {
        sum = sum.plus_times(x, constant);
    }
    sum
}

/// What follows the active joint e, of the unknown joints where it varies, among all joints x active.
#[inline(always)]
fn put<N: Real>(branch: &Branch, e: usize, unknown: &[N], all: &mut [N]) {
    let a = branch.active();
    for (i, (&j, &x)) in branch.unknown.iter().zip(unknown).enumerate() {
        all[j * a + e] = if branch.varying[i * a + e] { x } else { N::of(0.0) };
    }
}
