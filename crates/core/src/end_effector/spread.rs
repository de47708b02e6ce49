//! Covariance of the apparent masses, from that of the parameters.
//!
//! Rates `w = m A^-1 J' v` move the end effector at unit speed along the direction v of a mass m, which varies with the
//! parameters as twice the kinetic energy does: `dm = w' dA w` to first order (perturbation of a simple eigenvalue).
//!
//! Safety: as in [`crate::end_effector::jacobian`].

use crate::batch::Batch;
use crate::batch::axis::{load_axis, store_axis};
use crate::batch::link_velocity::contract_momentum;
use crate::batch::sweep::RecursionState;
use crate::end_effector::apparent_mass::ApparentMassQuery;
use crate::linalg::jacobi_svd::JacobiSvd;
use crate::mechanism::closure::JointMap;
use crate::mechanism::terms::Law;
use crate::mechanism::transform::JointTransform;
use crate::mechanism::{LINK_PARAMETERS, Mechanism};
use crate::memory::slot::Slot;
use crate::simd::lane::Lane;
use crate::simd::token::Simd;

/// Derivatives that are summed together: as many as stay in registers, with the energies of three masses.
const TOGETHER: usize = 4;

/// Covariance of the masses at a batch of poses.
pub(crate) struct Spread<'a> {
    query: &'a ApparentMassQuery<'a>,
    /// Parameters of each link that are uncertain: places among the link's, and in `uncertain`; then those of rotors, by
    /// their terms.
    links: Vec<Vec<(usize, usize)>>,
    rotors: Vec<(usize, usize)>,
    /// Rows of the covariance factor that are not zero, each with zeros up to a multiple of [`TOGETHER`].
    factor: Vec<f64>,
    stride: usize,
    /// Rates of the free coordinates, and of all.
    free: Vec<Slot>,
    rates: Vec<Slot>,
    /// Twice the kinetic energy of each uncertain parameter, masses x uncertain.
    energies: Vec<Slot>,
    /// Derivative of each mass along each column of the covariance factor, masses x stride.
    change: Vec<Slot>,
    /// Upper triangle, row by row.
    pub(crate) covariance: Vec<Slot>,
}

impl<'a> Spread<'a> {
    pub(crate) fn new(mechanism: &Mechanism, query: &'a ApparentMassQuery<'a>) -> Spread<'a> {
        let (r, s, stride) = (query.masses(), query.factor_columns, query.factor_columns.next_multiple_of(TOGETHER));
        let mut factor = Vec::new();
        let mut place = |column: usize| {
            let row = &query.covariance_factor[column * s..][..s];
            row.iter().any(|&x| x != 0.0).then(|| {
                factor.extend(row.iter().copied().chain(core::iter::repeat_n(0.0, stride - s)));
                factor.len() / stride - 1
            })
        };
        let links: Vec<Vec<_>> = (0..mechanism.links.len())
            .map(|i| (0..LINK_PARAMETERS).filter_map(|p| Some((p, place(LINK_PARAMETERS * i + p)?))).collect())
            .collect();
        let first = mechanism.inertial_columns();
        let is_rotor = |&t: &usize| mechanism.terms[t].law == Law::Rotor;
        let rotors: Vec<_> =
            (0..mechanism.terms.len()).filter(is_rotor).filter_map(|t| Some((t, place(first + t)?))).collect();
        let uncertain = factor.len().checked_div(stride).unwrap_or(0);
        let zeros = |len| vec![Slot::ZERO; len];
        Spread {
            query,
            links,
            rotors,
            factor,
            stride,
            free: zeros(query.free.len()),
            rates: zeros(mechanism.coordinates),
            energies: zeros(r * uncertain),
            change: zeros(r * stride),
            covariance: zeros(query.pairs()),
        }
    }

    /// Evaluate the covariance at the lanes of a batch; nothing where the parameters have none.
    ///
    /// # Safety
    ///
    /// As in the head of the file.
    #[inline(always)]
    pub(crate) unsafe fn evaluate<T: Lane>(
        &mut self,
        simd: Simd<T>,
        batch: Batch,
        state: &mut RecursionState,
        svd: &JacobiSvd,
    ) {
        if self.query.factor_columns == 0 {
            return;
        }
        for e in 0..self.query.masses() {
            // SAFETY: batch and state are as in the head of the file; `lanes` leaves room for a lane in slots.
            unsafe {
                for k in batch.lanes(simd) {
                    svd.unit_speed_rates(simd, e, k, &mut self.free);
                    for (&a, free) in self.query.free.iter().zip(&self.free) {
                        let rate: T = free.load(simd, k);
                        self.rates[a].store(k, rate);
                    }
                }
                self.energies_of(simd, batch, e, state);
            }
        }
        // SAFETY: as above.
        batch.lanes(simd).for_each(|k| unsafe { self.sum(simd, svd, k) });
    }

    /// Twice the kinetic energies of the uncertain parameters at the rates of mass `e`.
    #[inline(always)]
    unsafe fn energies_of<T: Lane>(&mut self, simd: Simd<T>, batch: Batch, e: usize, state: &mut RecursionState) {
        let uncertain = self.factor.len() / self.stride;
        let energies = &mut self.energies[e * uncertain..][..uncertain];
        // SAFETY: batch and state are as in the head of the file, here and below.
        unsafe {
            for (i, (link, places)) in batch.mechanism.links.iter().zip(&self.links).enumerate() {
                let at_zero = JointTransform::at_zero(simd, link.shape, link);
                for k in batch.lanes(simd) {
                    let joint: JointTransform<T> = at_zero.load(state.joints[i].as_ptr(), k);
                    let rate = displacement_rate(simd, batch, &link.joint_map, &self.rates, k);
                    let velocity = match link.parent {
                        Some(parent) => joint.add_joint_rate(
                            joint.transform_axis(load_axis(simd, state.wrenches[parent].as_ptr(), k)),
                            rate,
                        ),
                        None => joint.joint_axis(rate),
                    };
                    store_axis(state.wrenches[i].as_mut_ptr(), k, velocity);
                    if !places.is_empty() {
                        let all = contract_momentum(velocity, velocity);
                        for &(p, place) in places {
                            energies[place].store(k, all[p]);
                        }
                    }
                }
            }
            for &(t, place) in &self.rotors {
                for k in batch.lanes(simd) {
                    let speed = displacement_rate(simd, batch, &batch.mechanism.terms[t].joint_map, &self.rates, k);
                    energies[place].store(k, speed.mul(speed));
                }
            }
        }
    }

    /// Derivatives of the masses along the columns of the covariance factor, and their inner products.
    #[inline(always)]
    unsafe fn sum<T: Lane>(&mut self, simd: Simd<T>, svd: &JacobiSvd, k: usize) {
        let (r, stride, uncertain) = (self.query.masses(), self.stride, self.factor.len() / self.stride);
        // SAFETY: the caller promises room for a lane from k on, here and below.
        unsafe {
            for (e, change) in self.change.chunks_exact_mut(stride).enumerate() {
                let energies = &self.energies[e * uncertain..][..uncertain];
                for (c, change) in change.chunks_exact_mut(TOGETHER).enumerate() {
                    let mut sums = [simd.splat(0.0); TOGETHER];
                    for (energy, shares) in energies.iter().zip(self.factor.chunks_exact(stride)) {
                        let energy = energy.load(simd, k);
                        for (sum, &share) in sums.iter_mut().zip(&shares[c * TOGETHER..][..TOGETHER]) {
                            *sum = energy.fma(simd.splat(share), *sum);
                        }
                    }
                    for (to, sum) in change.iter_mut().zip(sums) {
                        to.store(k, sum);
                    }
                }
            }
            let pairs = (0..r).flat_map(|i| (i..r).map(move |j| (i, j)));
            let (known, none) = (svd.masses[0].load(simd, k), simd.splat(0.0));
            for ((i, j), to) in pairs.zip(&mut self.covariance) {
                let (left, right) = (&self.change[i * stride..][..stride], &self.change[j * stride..][..stride]);
                let mut sum = none;
                for (x, y) in left.iter().zip(right) {
                    sum = x.load(simd, k).fma(y.load(simd, k), sum);
                }
                to.store(k, T::select_gt(known, none, sum, simd.splat(f64::NAN)));
            }
        }
    }
}

/// Rate of a displacement, from those of the coordinates.
#[inline(always)]
unsafe fn displacement_rate<T: Lane>(simd: Simd<T>, batch: Batch, joint_map: &JointMap, rates: &[Slot], k: usize) -> T {
    let mut sum = simd.splat(0.0);
    for &(a, rate) in &joint_map.rates {
        // SAFETY: the caller promises one of the batch's lanes.
        sum = unsafe { rates[a].load(simd, k).fma(batch.rate(simd, rate, k), sum) };
    }
    sum
}
