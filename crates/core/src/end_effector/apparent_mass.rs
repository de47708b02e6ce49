//! Apparent mass (Khatib's effective mass) of the end effector at many poses: principal values of `(J A^-1 J')^-1`, and
//! their uncertainty.
//!
//! With `A = L L'` the singular values s of `J L^-T` give the apparent masses `1 / s^2` and, as left singular vectors
//! v, their directions; with fewer degrees of freedom than rows, those in the range of J (Khatib 1987, section III). No
//! squared matrix is decomposed.

use crate::batch::Batch;
use crate::batch::sweep::{RecursionState, for_each_batch_with};
use crate::dynamics::crba::{crba, joint_transforms, triangular_index};
use crate::end_effector::jacobian::{EndEffector, Jacobian, check, check_indices};
use crate::end_effector::spread::Spread;
use crate::error::{Error, expect_length};
use crate::linalg::jacobi_svd::JacobiSvd;
use crate::mechanism::Mechanism;
use crate::mechanism::motion::Motion;
use crate::mechanism::parameters::ParameterSets;
use crate::memory::shared::SharedOutput;
use crate::memory::slot::Slot;
use crate::simd::dispatch::dispatched;
use crate::simd::lane::Lane;
use crate::simd::token::Simd;

/// Which apparent masses to compute.
#[derive(Debug, Clone, Copy)]
pub struct ApparentMassQuery<'a> {
    /// Components of the end-effector velocity, indices below 6: linear, then angular.
    pub rows: &'a [usize],
    /// Coordinates that are free to move; the others are constrained.
    pub free: &'a [usize],
    /// Condition number of the Jacobian above which a pose has no masses.
    pub max_condition: f64,
    /// Matrix F of the parameters' covariance F F': [`Mechanism::columns`] x `factor_columns`, row-major; only rows of
    /// links and rotors count. Empty for no covariance.
    pub covariance_factor: &'a [f64],
    /// Columns of the covariance factor.
    pub factor_columns: usize,
}

impl ApparentMassQuery<'_> {
    /// Number of apparent masses at a pose.
    ///
    /// # Example
    ///
    /// ```
    /// use haptid_core::ApparentMassQuery;
    /// let query =
    ///     ApparentMassQuery { rows: &[0, 1], free: &[0], max_condition: 100., covariance_factor: &[], factor_columns: 0 };
    /// assert_eq!(query.masses(), 1);
    /// ```
    pub fn masses(&self) -> usize {
        self.rows.len().min(self.free.len())
    }

    /// Numbers of the covariance of a pose's masses: its upper triangle, or none without a covariance of the parameters.
    ///
    /// # Example
    ///
    /// ```
    /// use haptid_core::ApparentMassQuery;
    /// let query =
    ///     ApparentMassQuery { rows: &[0, 1], free: &[0], max_condition: 100., covariance_factor: &[], factor_columns: 0 };
    /// assert_eq!(query.pairs(), 0);
    /// ```
    pub fn pairs(&self) -> usize {
        if self.factor_columns == 0 { 0 } else { self.masses() * (self.masses() + 1) / 2 }
    }
}

/// Apparent masses at the poses of a motion. All but the condition number are NaN where that exceeds its limit, or where
/// the mass matrix is not positive definite.
#[derive(Debug, Clone, PartialEq)]
pub struct ApparentMasses {
    /// Condition number of the Jacobian, poses.
    pub condition: Vec<f64>,
    /// Masses in descending order, kg or kg m^2, poses x masses.
    pub masses: Vec<f64>,
    /// Their directions, unit vectors whose largest component is positive, poses x masses x rows.
    pub directions: Vec<f64>,
    /// Upper triangle of their covariance, row by row, poses x [`ApparentMassQuery::pairs`].
    pub covariance: Vec<f64>,
}

/// Apparent masses. Of the motion only positions and loops are read; `chi` are parameters as for
/// [`crate::mass_matrix`].
///
/// # Example
///
/// ```
/// # use haptid_core::*;
/// # let joint = Joint { parent: None, rotation: [1., 0., 0., 0., 1., 0., 0., 0., 1.], translation: [0.; 3], prismatic: false };
/// # let pendulum = Mechanism::new(&[joint], &Closure::open(1), [0., -9.81, 0.], &[], Backend::best())?;
/// # let chi = [0., 0., 0., 0., 0., 0.5, 1., 0., 0., 2.];
/// # let poses = Motion { samples: 1, position: &[0.3], velocity: &[], acceleration: None, external: &[], loops: &[] };
/// # let end_effector = EndEffector { link: 0, point: [0.5, 0., 0.] };
/// // A pendulum of 2 kg whose end effector is the mass.
/// let query = ApparentMassQuery { rows: &[0, 1], free: &[0], max_condition: 100., covariance_factor: &[], factor_columns: 0 };
/// let found = apparent_mass(&pendulum, &poses, &end_effector, &chi, &query)?;
/// assert!((found.masses[0] - 2.).abs() < 1e-12);
/// # Ok::<(), haptid_core::Error>(())
/// ```
pub fn apparent_mass(
    mechanism: &Mechanism,
    motion: &Motion,
    end_effector: &EndEffector,
    chi: &[f64],
    query: &ApparentMassQuery,
) -> Result<ApparentMasses, Error> {
    check(mechanism, motion, end_effector, query.rows)?;
    check_indices("coordinate", query.free, mechanism.coordinates)?;
    for (name, given) in [("rows", query.rows), ("free", query.free)] {
        if given.is_empty() {
            return Err(Error::Length { name, got: 0, wanted: 1 });
        }
    }
    expect_length("spread", query.covariance_factor.len(), mechanism.columns() * query.factor_columns)?;
    let (n, m, r, pairs) = (motion.samples, query.rows.len(), query.masses(), query.pairs());
    let mut made = ApparentMasses {
        condition: vec![0.0; n],
        masses: vec![0.0; n * r],
        directions: vec![0.0; n * r * m],
        covariance: vec![0.0; n * pairs],
    };
    let sets = ParameterSets::new(mechanism, n, chi)?;
    let condition = SharedOutput::new(&mut made.condition);
    let [masses, directions, covariance] =
        [&mut made.masses, &mut made.directions, &mut made.covariance].map(|x| SharedOutput::new(x));
    let start = || ApparentMassState {
        query,
        jacobian: Jacobian::new(mechanism, end_effector, query.rows),
        svd: JacobiSvd::new(m, query.free.len()),
        spread: Spread::new(mechanism, query),
    };
    for_each_batch_with(mechanism, motion, &sets, start, |batch, from, bodies, state, own| {
        // SAFETY: [`for_each_batch_with`] gives a batch and a state of the mechanism; batches are disjoint ranges of
        // samples, whose numbers only this call writes.
        unsafe {
            joint_transforms(mechanism.backend, batch, state);
            crba(mechanism.backend, batch, bodies, state);
            decompose(mechanism.backend, batch, state, own);
            let poses = (from, batch.samples);
            write(core::slice::from_ref(&own.svd.condition), poses, condition);
            write(&own.svd.masses, poses, masses);
            write(&own.svd.directions, poses, directions);
            write(&own.spread.covariance, poses, covariance);
        }
    });
    Ok(made)
}

/// Write slots as one row of numbers for each pose.
///
/// # Safety
///
/// `out` has a number for each slot and pose, and nobody else uses those of poses `from..from + count`.
unsafe fn write(slots: &[Slot], (from, count): (usize, usize), out: SharedOutput) {
    for (e, slot) in slots.iter().enumerate() {
        for (k, &x) in slot.0[..count].iter().enumerate() {
            // SAFETY: the caller's promise.
            unsafe { out.at((from + k) * slots.len() + e).write(x) };
        }
    }
}

/// Buffers of one thread.
struct ApparentMassState<'a> {
    query: &'a ApparentMassQuery<'a>,
    jacobian: Jacobian<'a>,
    svd: JacobiSvd,
    spread: Spread<'a>,
}

dispatched! {
    unsafe fn decompose = decompose_in_lanes(batch: Batch, state: &mut RecursionState, own: &mut ApparentMassState)
}

#[inline(always)]
unsafe fn decompose_in_lanes<T: Lane>(
    simd: Simd<T>,
    batch: Batch,
    state: &mut RecursionState,
    own: &mut ApparentMassState,
) {
    let (query, na) = (own.query, batch.mechanism.coordinates);
    // SAFETY: batch and state are as in the head of `jacobian`; `lanes` leaves room for a lane in slots.
    unsafe {
        own.jacobian.evaluate(simd, batch, state);
        own.svd.solve(
            simd,
            batch.samples,
            |row, a| &own.jacobian.entries[row * na + query.free[a]],
            |a, b| &state.mass[triangular_index(query.free[a], query.free[b])],
            query.max_condition,
        );
        own.spread.evaluate(simd, batch, state, &own.svd);
    }
}
