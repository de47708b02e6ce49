//! Poses that are iterate: closed by Newton's steps from where rates lead to, and how all joints follow there.

use crate::linalg::small_qr::{QrFactor, dot, same_orientation};
use crate::loops::assembly::AssemblyMode;
use crate::loops::continuation::ClosedConfiguration;
use crate::loops::gap::LoopState;
use crate::simd::real::Dual;
use crate::simd::real::{Number, Real};

/// A step's passive joints may be this far from where their rates led to, rad (or mechanism sizes).
const MAX_CORRECTION: f64 = 0.1;
/// Newton's steps for each pose; after one this short, rad (or m), another is taken with the same factor, and is the last
/// where it is this short itself: what is left is their product.
const MAX_ITERATIONS: usize = 8;
const SHORT_STEP: f64 = 1e-5;
const LAST_STEP: f64 = 1e-9;

/// Poses side by side, each reached in one step from the same configuration.
pub(crate) struct NewtonIterate<N> {
    /// Where the active joints are to be, and how far that is from the configuration.
    pub at: Vec<N>,
    displacement: Vec<N>,
    /// All joints, and where rates led them to.
    pub q: Vec<N>,
    predicted: Vec<N>,
    /// Rates of all joints by the active ones, joints x active, and their change with time.
    pub rates: Vec<N>,
    pub change: Vec<N>,
    shape: LoopState<N>,
    dual: Vec<Dual<N>>,
    moving: LoopState<Dual<N>>,
    /// The gaps' Jacobian by the unknown joints, column by column, and its factor.
    pub passive: Vec<N>,
    factor: QrFactor<N>,
    /// A right side, and a small matrix.
    right: Vec<N>,
    scratch: Vec<N>,
}

impl<N: Real> NewtonIterate<N> {
    pub(crate) fn new(mode: &AssemblyMode) -> NewtonIterate<N> {
        let (m, n, u, a) = (mode.loops.gaps(), mode.joints(), mode.unknown.len(), mode.active());
        let zeros = |len| vec![N::constant(0.0); len];
        NewtonIterate {
            at: zeros(a),
            displacement: zeros(a),
            q: zeros(n),
            predicted: zeros(n),
            rates: mode.constant.iter().map(|&rate| N::constant(rate)).collect(),
            change: zeros(n * a),
            shape: mode.loops.shape(),
            dual: vec![Dual::constant(0.0); n],
            moving: mode.loops.shape(),
            passive: zeros(m * u),
            factor: QrFactor::new(m, u),
            right: zeros(m),
            scratch: zeros(u * u),
        }
    }

    /// Step from a configuration to where the active joints are to be; whether that can be taken: whether the cuts close, near
    /// where rates lead to, and on the same side of singular poses.
    #[inline(always)]
    pub(crate) fn step(&mut self, mode: &AssemblyMode, configuration: &ClosedConfiguration) -> bool {
        self.predict(mode, configuration);
        self.q.copy_from_slice(&self.predicted);
        let mut good = self.correct(mode);
        for &left in &self.right[mode.unknown.len()..] {
            good = left.if_below(mode.tolerances.gap * mode.loops.length_scale(), good);
        }
        for (j, (&x, &y)) in self.predicted.iter().zip(&self.q).enumerate() {
            good = (x - y).if_below(MAX_CORRECTION * mode.loops.joint_scale(j), good);
        }
        good.all_greater(0.0)
            && same_orientation(&configuration.passive, &self.passive, self.right.len(), &mut self.scratch)
            && self.factor.is_well_conditioned(mode.tolerances.singular_value, &mut self.scratch)
    }

    /// Where rates lead to; they change as they did since the pose before.
    #[inline(always)]
    fn predict(&mut self, mode: &AssemblyMode, configuration: &ClosedConfiguration) {
        let (a, half) = (self.at.len(), N::constant(0.5));
        for (e, &j) in mode.active.iter().enumerate() {
            self.displacement[e] = self.at[e] - N::constant(configuration.q[j]);
        }
        for (j, predicted) in self.predicted.iter_mut().enumerate() {
            *predicted = N::constant(mode.offset[j]) + along(&self.at, &mode.constant[j * a..]);
        }
        let last = dot(&configuration.moved, &configuration.moved);
        let share = along(&self.displacement, &configuration.moved).scale(if last > 0.0 { 0.5 / last } else { 0.0 });
        let share = N::select(share, half, half, N::select(half.scale(-1.0), share, half.scale(-1.0), share));
        for (i, &j) in mode.unknown.iter().enumerate() {
            let now = along(&self.displacement, &configuration.rates[i * a..]);
            let before = along(&self.displacement, &configuration.before[i * a..]);
            self.predicted[j] = (N::constant(configuration.q[j]) + now).add_product(share, now - before);
        }
    }

    /// Newton's steps from where the joints are; good where they came to an end. Beside the unknown joints' last step the
    /// right side is what that leaves of the gaps.
    #[inline(always)]
    fn correct(&mut self, mode: &AssemblyMode) -> N {
        for _ in 0..MAX_ITERATIONS {
            self.evaluate(mode);
            if !self.newton_step(mode, SHORT_STEP).all_greater(0.0) {
                continue;
            }
            mode.loops.measure_gaps(&self.q, &mut self.shape);
            let good = self.newton_step(mode, LAST_STEP);
            if good.all_greater(0.0) {
                return good;
            }
        }
        N::constant(0.0)
    }

    /// One step with the factor that is there; good where it was short.
    #[inline(always)]
    fn newton_step(&mut self, mode: &AssemblyMode, short: f64) -> N {
        self.right.copy_from_slice(&self.shape.gaps);
        self.factor.solve(&mut self.right);
        let mut good = N::constant(1.0);
        for (&j, &x) in mode.unknown.iter().zip(&self.right) {
            self.q[j] = self.q[j] - x;
            good = x.if_below(short, good);
        }
        good
    }

    /// Gaps and Jacobian where the joints are, and the factor of its passive part.
    #[inline(always)]
    pub(crate) fn evaluate(&mut self, mode: &AssemblyMode) {
        let n = self.q.len();
        mode.loops.measure(&self.q, &mut self.shape);
        for (column, &j) in self.passive.chunks_exact_mut(self.right.len()).zip(&mode.unknown) {
            for (entry, row) in column.iter_mut().zip(self.shape.jacobian.chunks_exact(n)) {
                *entry = row[j];
            }
        }
        self.factor.decompose(&self.passive);
    }

    /// Rates at the pose measured.
    #[inline(always)]
    pub(crate) fn solve_rates(&mut self, mode: &AssemblyMode) {
        let a = self.at.len();
        for e in 0..a {
            for (right, row) in self.right.iter_mut().zip(self.shape.jacobian.chunks_exact(self.q.len())) {
                *right = N::constant(0.0);
                for &j in &mode.driven {
                    *right = right.add_scaled(row[j], -mode.constant[j * a + e]);
                }
            }
            self.factor.solve(&mut self.right);
            put(mode, e, &self.right, &mut self.rates);
        }
    }

    /// Change of the rates there, where the active joints move with a velocity.
    #[inline(always)]
    pub(crate) fn solve_rate_derivatives(&mut self, mode: &AssemblyMode, velocity: &[N]) {
        let a = velocity.len();
        for (j, dual) in self.dual.iter_mut().enumerate() {
            *dual = Dual { value: self.q[j], rate: dot(&self.rates[j * a..][..a], velocity) };
        }
        mode.loops.measure(&self.dual, &mut self.moving);
        for e in 0..a {
            for (right, row) in self.right.iter_mut().zip(self.moving.jacobian.chunks_exact(self.q.len())) {
                *right = N::constant(0.0);
                for (j, entry) in row.iter().enumerate() {
                    *right = right.sub_product(entry.rate, self.rates[j * a + e]);
                }
            }
            self.factor.solve(&mut self.right);
            put(mode, e, &self.right, &mut self.change);
        }
    }
}

/// Sum of products with constants, as many as there are numbers.
#[inline(always)]
fn along<N: Real>(x: &[N], constants: &[f64]) -> N {
    let mut sum = N::constant(0.0);
    for (&x, &constant) in x.iter().zip(constants) {
        sum = sum.add_scaled(x, constant);
    }
    sum
}

/// What follows the active joint e, of the unknown joints where it varies, among all joints x active.
#[inline(always)]
fn put<N: Real>(mode: &AssemblyMode, e: usize, unknown: &[N], all: &mut [N]) {
    let a = mode.active();
    for (i, (&j, &x)) in mode.unknown.iter().zip(unknown).enumerate() {
        all[j * a + e] = if mode.varying[i * a + e] { x } else { N::constant(0.0) };
    }
}
