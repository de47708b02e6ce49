//! Newton iterates: poses corrected from a prediction until their loops close, with the rates of all joints there.

use crate::linalg::small_qr::{QrFactor, dot, same_orientation};
use crate::loops::assembly::AssemblyMode;
use crate::loops::continuation::ClosedConfiguration;
use crate::loops::gap::LoopState;
use crate::simd::real::{Dual, Number, Real};

/// Largest correction of a passive joint from its prediction, rad (or mechanism sizes).
const MAX_CORRECTION: f64 = 0.1;
/// Newton steps per pose. After one shorter than `SHORT_STEP`, rad (or m), another with the same factor must be shorter
/// than `LAST_STEP`: the remaining error is about their product.
const MAX_ITERATIONS: usize = 8;
const SHORT_STEP: f64 = 1e-5;
const LAST_STEP: f64 = 1e-9;

/// Poses in lanes, each predicted and corrected in one step from the same configuration.
pub(crate) struct NewtonIterate<N: Number> {
    token: N::Token,
    /// Targets of the active joints, and their displacement from the configuration.
    pub target: Vec<N>,
    displacement: Vec<N>,
    /// Positions of all joints, and their prediction.
    pub q: Vec<N>,
    predicted: Vec<N>,
    /// Rates of all joints with respect to the active ones, joints x active, and their time derivatives.
    pub rates: Vec<N>,
    pub rate_derivatives: Vec<N>,
    state: LoopState<N>,
    dual: Vec<Dual<N>>,
    dual_state: LoopState<Dual<N>>,
    /// Jacobian of the gaps with respect to the unknown joints, by columns, and its factor.
    pub passive_jacobian: Vec<N>,
    factor: QrFactor<N>,
    /// Right-hand side, and scratch for a small matrix.
    residual: Vec<N>,
    scratch: Vec<N>,
}

impl<N: Real> NewtonIterate<N> {
    pub(crate) fn new(token: N::Token, mode: &AssemblyMode) -> NewtonIterate<N> {
        let (m, n, u, a) = (mode.loops.gaps(), mode.joints(), mode.unknown.len(), mode.active());
        let zeros = |len| vec![N::constant(token, 0.0); len];
        NewtonIterate {
            token,
            target: zeros(a),
            displacement: zeros(a),
            q: zeros(n),
            predicted: zeros(n),
            rates: mode.linear_rates.iter().map(|&rate| N::constant(token, rate)).collect(),
            rate_derivatives: zeros(n * a),
            state: mode.loops.state(token),
            dual: vec![Dual::constant(token, 0.0); n],
            dual_state: mode.loops.state(token),
            passive_jacobian: zeros(m * u),
            factor: QrFactor::new(token, m, u),
            residual: zeros(m),
            scratch: zeros(u * u),
        }
    }

    /// One step from a configuration to the targets of the active joints; whether all lanes are accepted: the loops
    /// close, close to the prediction, on the same side of singular poses.
    #[inline(always)]
    pub(crate) fn step(&mut self, mode: &AssemblyMode, configuration: &ClosedConfiguration) -> bool {
        self.predict(mode, configuration);
        self.q.copy_from_slice(&self.predicted);
        let mut good = self.correct(mode);
        for &left in &self.residual[mode.unknown.len()..] {
            good = left.if_below(mode.tolerances.gap * mode.loops.length_scale(), good);
        }
        for (j, (&x, &y)) in self.predicted.iter().zip(&self.q).enumerate() {
            good = (x - y).if_below(MAX_CORRECTION * mode.loops.joint_scale(j), good);
        }
        good.all_greater(0.0)
            && same_orientation(
                self.token,
                &configuration.passive_jacobian,
                &self.passive_jacobian,
                self.residual.len(),
                &mut self.scratch,
            )
            && self.factor.is_well_conditioned(mode.tolerances.singular_value, &mut self.scratch)
    }

    /// Predictor: rates of the configuration, with their rate_derivatives since the one before.
    #[inline(always)]
    fn predict(&mut self, mode: &AssemblyMode, configuration: &ClosedConfiguration) {
        let (a, token) = (self.target.len(), self.token);
        let half = N::constant(token, 0.5);
        for (e, &j) in mode.active.iter().enumerate() {
            self.displacement[e] = self.target[e] - N::constant(token, configuration.q[j]);
        }
        for (j, predicted) in self.predicted.iter_mut().enumerate() {
            *predicted = N::constant(token, mode.offset[j]) + along(token, &self.target, &mode.linear_rates[j * a..]);
        }
        let last = dot((), &configuration.last_displacement, &configuration.last_displacement);
        let share = along(token, &self.displacement, &configuration.last_displacement).scale(if last > 0.0 {
            0.5 / last
        } else {
            0.0
        });
        let share = N::select(share, half, half, N::select(half.scale(-1.0), share, half.scale(-1.0), share));
        for (i, &j) in mode.unknown.iter().enumerate() {
            let now = along(token, &self.displacement, &configuration.rates[i * a..]);
            let before = along(token, &self.displacement, &configuration.previous_rates[i * a..]);
            self.predicted[j] = (N::constant(token, configuration.q[j]) + now).add_product(share, now - before);
        }
    }

    /// Corrector: Newton steps from the prediction; 1 in lanes that converged, 0 elsewhere. The right-hand side is left
    /// with the unknown joints' last step, and then the residual gaps.
    #[inline(always)]
    fn correct(&mut self, mode: &AssemblyMode) -> N {
        for _ in 0..MAX_ITERATIONS {
            self.evaluate(mode);
            if !self.newton_step(mode, SHORT_STEP).all_greater(0.0) {
                continue;
            }
            mode.loops.measure_gaps(&self.q, &mut self.state);
            let good = self.newton_step(mode, LAST_STEP);
            if good.all_greater(0.0) {
                return good;
            }
        }
        N::constant(self.token, 0.0)
    }

    /// One Newton step with the present factor; 1 in lanes where it was shorter than `short`.
    #[inline(always)]
    fn newton_step(&mut self, mode: &AssemblyMode, short: f64) -> N {
        self.residual.copy_from_slice(&self.state.gaps);
        self.factor.solve(&mut self.residual);
        let mut good = N::constant(self.token, 1.0);
        for (&j, &x) in mode.unknown.iter().zip(&self.residual) {
            self.q[j] = self.q[j] - x;
            good = x.if_below(short, good);
        }
        good
    }

    /// Gaps and Jacobian at the present positions, and the factor of its passive part.
    #[inline(always)]
    pub(crate) fn evaluate(&mut self, mode: &AssemblyMode) {
        let n = self.q.len();
        mode.loops.measure(&self.q, &mut self.state);
        for (column, &j) in self.passive_jacobian.chunks_exact_mut(self.residual.len()).zip(&mode.unknown) {
            for (entry, row) in column.iter_mut().zip(self.state.jacobian.chunks_exact(n)) {
                *entry = row[j];
            }
        }
        self.factor.decompose(&self.passive_jacobian);
    }

    /// Rates at the pose that was evaluated.
    #[inline(always)]
    pub(crate) fn solve_rates(&mut self, mode: &AssemblyMode) {
        let a = self.target.len();
        for e in 0..a {
            for (right, row) in self.residual.iter_mut().zip(self.state.jacobian.chunks_exact(self.q.len())) {
                *right = N::constant(self.token, 0.0);
                for &j in &mode.driven {
                    *right = right.add_scaled(row[j], -mode.linear_rates[j * a + e]);
                }
            }
            self.factor.solve(&mut self.residual);
            put(self.token, mode, e, &self.residual, &mut self.rates);
        }
    }

    /// Time derivatives of the rates there, at velocities of the active joints.
    #[inline(always)]
    pub(crate) fn solve_rate_derivatives(&mut self, mode: &AssemblyMode, velocity: &[N]) {
        let a = velocity.len();
        for (j, dual) in self.dual.iter_mut().enumerate() {
            *dual = Dual { value: self.q[j], rate: dot(self.token, &self.rates[j * a..][..a], velocity) };
        }
        mode.loops.measure(&self.dual, &mut self.dual_state);
        for e in 0..a {
            for (right, row) in self.residual.iter_mut().zip(self.dual_state.jacobian.chunks_exact(self.q.len())) {
                *right = N::constant(self.token, 0.0);
                for (j, entry) in row.iter().enumerate() {
                    *right = right.sub_product(entry.rate, self.rates[j * a + e]);
                }
            }
            self.factor.solve(&mut self.residual);
            put(self.token, mode, e, &self.residual, &mut self.rate_derivatives);
        }
    }
}

/// Inner product with constants, over the length of `x`.
#[inline(always)]
fn along<N: Real>(token: N::Token, x: &[N], constants: &[f64]) -> N {
    let mut sum = N::constant(token, 0.0);
    for (&x, &constant) in x.iter().zip(constants) {
        sum = sum.add_scaled(x, constant);
    }
    sum
}

/// Write what follows active joint e: for the unknown joints whose rate varies, among all joints x active.
#[inline(always)]
fn put<N: Real>(token: N::Token, mode: &AssemblyMode, e: usize, unknown: &[N], all: &mut [N]) {
    let a = mode.active();
    for (i, (&j, &x)) in mode.unknown.iter().zip(unknown).enumerate() {
        all[j * a + e] = if mode.varying[i * a + e] { x } else { N::constant(token, 0.0) };
    }
}
