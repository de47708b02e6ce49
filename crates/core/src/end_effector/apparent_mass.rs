//! Apparent mass (Khatib's effective mass) of the end effector at many poses: principal values of `(J A^-1 J')^-1`, and
//! their uncertainty.
//!
//! With `A = L L'` the singular values s of `J L^-T` give the apparent masses `1 / s^2` and, as left singular vectors
//! v, their directions; with fewer degrees of freedom than rows, those in the range of J. Rates `w = m A^-1 J' v` move
//! the end effector at unit speed along v, and a mass varies with the parameters as twice the kinetic energy does: `dm
//! = w' dA w` to first order (Khatib 1987, section III; perturbation of a simple eigenvalue). No squared matrix is
//! decomposed.

use crate::batch::link_velocity::contract_momentum;
use crate::end_effector::jacobian::{
    BodyParameters, EndEffector, EndEffectorModel, PoseGroup, Poses, check_indices, for_each_group, link_velocity,
};
use crate::error::{Error, expect_length};
use crate::linalg::jacobi_svd::JacobiSvd;
use crate::mechanism::{LINK_PARAMETERS, Mechanism};
use crate::memory::slot::{POSES, PoseSlot, pose_lanes};
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
    /// Matrix F of the parameters' covariance F F': (ten for each link, one for each rotor) x `factor_columns`,
    /// row-major. Empty for no covariance.
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

    /// Numbers per pose: condition number, masses in descending order, their directions, and the upper triangle of
    /// their covariance, row by row.
    ///
    /// # Example
    ///
    /// ```
    /// use haptid_core::ApparentMassQuery;
    /// let query =
    ///     ApparentMassQuery { rows: &[0, 1], free: &[0], max_condition: 100., covariance_factor: &[], factor_columns: 0 };
    /// // Condition number, one mass, its direction in the plane, its variance.
    /// assert_eq!(query.width(), 5);
    /// ```
    pub fn width(&self) -> usize {
        let r = self.masses();
        1 + r + r * self.rows.len() + r * (r + 1) / 2
    }
}

/// Apparent masses, kg or kg m^2: [`ApparentMassQuery::width`] numbers for each pose. They are NaN where the condition
/// number exceeds its limit, or where the mass matrix is not positive definite.
///
/// # Example
///
/// ```
/// # use haptid_core::*;
/// # let joint = Joint { parent: None, rotation: [1., 0., 0., 0., 1., 0., 0., 0., 1.], translation: [0.; 3], prismatic: false };
/// # let pendulum = Mechanism::new(&[joint], &Closure::open(1), [0., -9.81, 0.], &[], Backend::best())?;
/// # let chi = [0., 0., 0., 0., 0., 0.5, 1., 0., 0., 2.];
/// # let poses = Poses { samples: 1, position: &[0.3], rates: &[1.] };
/// # let end_effector = EndEffector { link: 0, point: [0.5, 0., 0.] };
/// # let bodies = BodyParameters { chi: &chi, rotors: &[], inertia: &[] };
/// // A pendulum of 2 kg whose end effector is the mass.
/// let query = ApparentMassQuery { rows: &[0, 1], free: &[0], max_condition: 100., covariance_factor: &[], factor_columns: 0 };
/// let mut out = vec![0.; query.width()];
/// apparent_mass(&pendulum, &poses, &end_effector, &bodies, &query, &mut out)?;
/// assert!((out[1] - 2.).abs() < 1e-12);
/// # Ok::<(), haptid_core::Error>(())
/// ```
pub fn apparent_mass(
    mechanism: &Mechanism,
    poses: &Poses,
    end_effector: &EndEffector,
    bodies: &BodyParameters,
    query: &ApparentMassQuery,
    out: &mut [f64],
) -> Result<(), Error> {
    let model = EndEffectorModel::new(mechanism, poses, end_effector, bodies)?;
    check_indices("row", query.rows, 6)?;
    check_indices("coordinate", query.free, mechanism.coordinates)?;
    let columns = bodies.chi.len() + bodies.inertia.len();
    expect_length("spread", query.covariance_factor.len(), columns * query.factor_columns)?;
    expect_length("out", out.len(), poses.samples * query.width())?;
    if out.is_empty() {
        return Ok(());
    }
    for_each_group(
        &model,
        out,
        query.width(),
        || ApparentMassState::new(&model, query),
        |group, state, out| state.fill(&model, group, out),
    );
    Ok(())
}

/// Buffers of one thread.
struct ApparentMassState<'a> {
    query: &'a ApparentMassQuery<'a>,
    svd: JacobiSvd,
    /// Singular triplets of one pose, largest mass first.
    order: Vec<usize>,
    /// Coordinate rates that move the end effector at unit speed along each direction, masses x coordinates.
    rates: Vec<PoseSlot>,
    /// Derivative of each mass along each column of the covariance factor, masses x factor columns.
    change: Vec<PoseSlot>,
    /// Uncertain columns of each link, then of the rotors.
    uncertain: Vec<Vec<(usize, usize)>>,
}

impl<'a> ApparentMassState<'a> {
    fn new(model: &EndEffectorModel, query: &'a ApparentMassQuery<'a>) -> ApparentMassState<'a> {
        let r = query.masses();
        let inertial = model.bodies().chi.len();
        let doubt = |c: usize| {
            query.covariance_factor[c * query.factor_columns..][..query.factor_columns].iter().any(|&x| x != 0.0)
        };
        let group = |from: usize, to: usize| (from..to).filter(|&c| doubt(c)).map(|c| (c - from, c)).collect();
        let mut uncertain: Vec<Vec<_>> =
            (0..inertial).step_by(LINK_PARAMETERS).map(|c| group(c, c + LINK_PARAMETERS)).collect();
        uncertain.push(group(inertial, inertial + model.bodies().inertia.len()));
        ApparentMassState {
            query,
            svd: JacobiSvd::new(query.rows.len(), query.free.len()),
            order: (0..r).collect(),
            rates: vec![PoseSlot::ZERO; r * model.mechanism.coordinates],
            change: vec![PoseSlot::ZERO; r * query.factor_columns],
            uncertain,
        }
    }

    fn fill(&mut self, model: &EndEffectorModel, group: &PoseGroup, out: &mut [f64]) {
        let (query, na, n) = (self.query, model.mechanism.coordinates, self.query.free.len());
        let (r, m) = (query.masses(), query.rows.len());
        decompose(model.mechanism.backend, model, group, self);
        for (k, out) in out.chunks_exact_mut(query.width()).enumerate() {
            out.fill(f64::NAN);
            out[0] = self.svd.condition.0[k];
            let known = out[0] <= query.max_condition && self.svd.definite.0[k] == 1.0;
            self.sort(k);
            for (place, &e) in self.order.iter().enumerate() {
                let direction = &self.svd.directions[e * m..][..m];
                // The component of largest magnitude is positive.
                let largest =
                    direction.iter().map(|x| x.0[k]).fold(0.0, |a: f64, b| if b.abs() > a.abs() { b } else { a });
                let sign = if largest < 0.0 { -1.0 } else { 1.0 };
                if known {
                    out[1 + place] = self.svd.masses[e].0[k];
                    for (to, from) in out[1 + r + place * m..][..m].iter_mut().zip(direction) {
                        *to = sign * from.0[k];
                    }
                }
                if query.factor_columns == 0 {
                    continue;
                }
                for (a, &coordinate) in query.free.iter().enumerate() {
                    self.rates[place * na + coordinate].0[k] =
                        if known { sign * self.svd.rates[e * n + a].0[k] } else { 0.0 };
                }
            }
        }
        if query.factor_columns > 0 {
            // SAFETY: the buffers have been made for the query; pose slots have room for whole lanes.
            unsafe { changes(model.mechanism.backend, model, group, self) };
            self.covariance(out);
        }
    }

    /// Order the triplets of a pose, from an earlier one's order: few are in another.
    fn sort(&mut self, k: usize) {
        for end in 1..self.order.len() {
            let mass = |e: usize| self.svd.masses[e].0[k];
            let mut place = end;
            while place > 0 && mass(self.order[place - 1]) < mass(self.order[place]) {
                self.order.swap(place - 1, place);
                place -= 1;
            }
        }
    }

    /// Covariance of the masses, at every pose that has them.
    fn covariance(&self, out: &mut [f64]) {
        let (r, m, s) = (self.query.masses(), self.query.rows.len(), self.query.factor_columns);
        let pairs = (0..r).flat_map(|i| (i..r).map(move |j| (i, j)));
        for (at, (i, j)) in pairs.enumerate() {
            let mut sum = [0.0; POSES];
            for (left, right) in self.change[i * s..][..s].iter().zip(&self.change[j * s..][..s]) {
                for (sum, (left, right)) in sum.iter_mut().zip(left.0.iter().zip(&right.0)) {
                    *sum += left * right;
                }
            }
            for (out, sum) in out.chunks_exact_mut(self.query.width()).zip(sum) {
                if !out[1].is_nan() {
                    out[1 + r + r * m + at] = sum;
                }
            }
        }
    }
}

dispatched! {
    fn decompose =
        decompose_in_lanes(model: &EndEffectorModel, group: &PoseGroup, state: &mut ApparentMassState)
}

#[inline(always)]
fn decompose_in_lanes<T: Lane>(
    simd: Simd<T>,
    model: &EndEffectorModel,
    group: &PoseGroup,
    state: &mut ApparentMassState,
) {
    let (query, na) = (state.query, model.mechanism.coordinates);
    state.svd.solve(
        simd,
        |row, a| &group.jacobian[query.rows[row] * na + query.free[a]],
        |a, b| &group.mass[query.free[a] * na + query.free[b]],
    );
    if query.factor_columns > 0 {
        // SAFETY: `pose_lanes` leaves room for a lane in pose slots.
        pose_lanes(simd).for_each(|k| unsafe { state.svd.unit_speed_rates(simd, k) });
    }
}

dispatched! {
    unsafe fn changes = changes_in_lanes(model: &EndEffectorModel, group: &PoseGroup, state: &mut ApparentMassState)
}

#[inline(always)]
unsafe fn changes_in_lanes<T: Lane>(
    simd: Simd<T>,
    model: &EndEffectorModel,
    group: &PoseGroup,
    state: &mut ApparentMassState,
) {
    state.change.fill(PoseSlot::ZERO);
    let (na, s) = (model.mechanism.coordinates, state.query.factor_columns);
    for k in pose_lanes(simd) {
        for (rates, change) in state.rates.chunks_exact(na).zip(state.change.chunks_exact_mut(s)) {
            for (i, columns) in state.uncertain.iter().enumerate().filter(|(_, columns)| !columns.is_empty()) {
                // SAFETY: the loop over k leaves room for a lane in pose slots, here and below.
                let energies: UnitEnergy<T> = if i < model.mechanism.links.len() {
                    // SAFETY: as above.
                    let velocity = unsafe { link_velocity(simd, model, group, i, rates, k) };
                    UnitEnergy::Link(contract_momentum(velocity, velocity))
                } else {
                    UnitEnergy::Rotors
                };
                for &(place, column) in columns {
                    let energy = match &energies {
                        UnitEnergy::Link(of) => of[place],
                        // SAFETY: as above.
                        UnitEnergy::Rotors => unsafe {
                            rotor_energy(simd, &model.bodies().rotors[place * na..][..na], rates, k)
                        },
                    };
                    let spread = &state.query.covariance_factor[column * s..][..s];
                    for (slot, &share) in change.iter_mut().zip(spread) {
                        // SAFETY: as above.
                        unsafe { slot.store(k, energy.fma(simd.splat(share), slot.load(simd, k))) };
                    }
                }
            }
        }
    }
}

/// Twice the kinetic energy of unit parameters, at rates that move the end effector at unit speed.
enum UnitEnergy<T> {
    Link([T; LINK_PARAMETERS]),
    Rotors,
}

#[inline(always)]
unsafe fn rotor_energy<T: Lane>(simd: Simd<T>, weights: &[f64], rates: &[PoseSlot], k: usize) -> T {
    let mut speed = simd.splat(0.0);
    for (&weight, rate) in weights.iter().zip(rates) {
        // SAFETY: the caller promises room for a lane from k on.
        speed = unsafe { rate.load(simd, k) }.fma(simd.splat(weight), speed);
    }
    speed.mul(speed)
}
