//! Assembly by damped Gauss-Newton steps, from an approximate pose.

use crate::error::{Error, expect_length};
use crate::loops::cut::{LoopClosure, SHARE};
use crate::loops::gap::LoopState;
use rayon::prelude::*;

/// Largest step of a joint, rad, or m per m of length scale.
const MAX_STEP: f64 = 0.7;
/// Damping relative to the trace: far below what would slow the convergence of the last steps.
const DAMPING: f64 = 1e-13;
/// Most steps that may be asked for: each takes a fixed time, and what is not closed after these never will be.
const MOST_STEPS: usize = 10_000;

impl LoopClosure {
    /// Move the unknown joints at every sample (samples x joints) until the gaps are as small as they can be: damped
    /// Gauss-Newton steps, at most `steps`, until none of a step's entries exceeds `step_tolerance`. The caller checks the
    /// gaps that remain.
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
    /// // Two bars of 0.5 and 0.4 m, 0.6 m apart, meet as the law of cosines says.
    /// let mut q = [0.5, 2.0];
    /// loops.close(&mut q, &[0, 1], 60, 1e-12)?;
    /// assert!((q[0].cos() - (0.25 + 0.36 - 0.16) / 0.6).abs() < 1e-10);
    /// # Ok::<(), haptid_core::Error>(())
    /// ```
    pub fn close(&self, q: &mut [f64], unknown: &[usize], steps: usize, step_tolerance: f64) -> Result<(), Error> {
        let n = self.joints.len();
        expect_length("q", q.len(), q.len().checked_div(n).unwrap_or(0) * n)?;
        if let Some(&got) = unknown.iter().find(|&&j| j >= n) {
            return Err(Error::Index { name: "unknown joint", got, limit: n });
        }
        if steps > MOST_STEPS {
            return Err(Error::Index { name: "number of steps", got: steps, limit: MOST_STEPS + 1 });
        }
        q.par_chunks_mut(SHARE * n.max(1)).for_each(|q| {
            let (mut state, mut system) = (self.state::<f64>(()), NormalEquations::new(unknown.len()));
            for q in q.chunks_exact_mut(n) {
                for _ in 0..steps {
                    self.measure(q, &mut state);
                    system.assemble(&state, n, unknown);
                    let step = system.solve();
                    let longest = step.iter().fold(0.0_f64, |longest, x| longest.max(x.abs()));
                    let share = (MAX_STEP / longest.max(MAX_STEP)).min(1.0);
                    unknown.iter().zip(step).for_each(|(&j, x)| q[j] -= share * x);
                    if longest <= step_tolerance {
                        break;
                    }
                }
            }
        });
        Ok(())
    }
}
/// The damped normal equations of one step. They are small, and solved in every step, so that their error does not
/// remain.
struct NormalEquations {
    size: usize,
    matrix: Vec<f64>,
    right: Vec<f64>,
}

impl NormalEquations {
    fn new(size: usize) -> NormalEquations {
        NormalEquations { size, matrix: vec![0.0; size * size], right: vec![0.0; size] }
    }

    fn assemble(&mut self, state: &LoopState<f64>, joints: usize, unknown: &[usize]) {
        self.matrix.fill(0.0);
        self.right.fill(0.0);
        for (row, gap) in state.jacobian.chunks_exact(joints).zip(&state.gaps) {
            for (i, &a) in unknown.iter().enumerate() {
                self.right[i] += row[a] * gap;
                for (k, &b) in unknown[..=i].iter().enumerate() {
                    self.matrix[i * self.size + k] += row[a] * row[b];
                }
            }
        }
        let trace: f64 = (0..self.size).map(|i| self.matrix[i * (self.size + 1)]).sum();
        (0..self.size).for_each(|i| self.matrix[i * (self.size + 1)] += DAMPING * trace.max(1e-100));
    }

    /// Solve by L D L' in place; a pivot lost to rounding is replaced by the damping.
    fn solve(&mut self) -> &[f64] {
        let (n, l, x) = (self.size, &mut self.matrix, &mut self.right);
        let least = DAMPING * (0..n).map(|i| l[i * (n + 1)]).sum::<f64>();
        for i in 0..n {
            for k in 0..i {
                let known: f64 = (0..k).map(|e| l[i * n + e] * l[k * n + e] * l[e * (n + 1)]).sum();
                l[i * n + k] = (l[i * n + k] - known) / l[k * (n + 1)];
            }
            let known: f64 = (0..i).map(|e| l[i * n + e] * l[i * n + e] * l[e * (n + 1)]).sum();
            l[i * (n + 1)] = (l[i * (n + 1)] - known).max(least);
            x[i] -= (0..i).map(|e| l[i * n + e] * x[e]).sum::<f64>();
        }
        for i in (0..n).rev() {
            x[i] = x[i] / l[i * (n + 1)] - (i + 1..n).map(|e| l[e * n + i] * x[e]).sum::<f64>();
        }
        x
    }
}
