//! Motions: the samples that kernels are evaluated at.

use crate::error::{Error, expect_length};
use crate::mechanism::Mechanism;

/// Samples per task of a thread, a multiple of any lane. Starting threads costs more than two of them.
pub(crate) const PART: usize = 1024;

/// Samples of a motion, channel major: sample `k` of coordinate `a` is at `a * samples + k`.
///
/// Without accelerations the regressor has two sets of rows in place of one, the generalised momenta and the remainder
/// of the torque: `Y(q, qd, qdd) = d/dt momenta + remainder`. Neither depends on accelerations.
#[derive(Debug, Clone, Copy)]
pub struct Motion<'a> {
    /// Number of samples.
    pub samples: usize,
    /// Positions of the coordinates, rad or m, coordinates x samples.
    pub position: &'a [f64],
    /// Velocities, rad/s or m/s, coordinates x samples.
    pub velocity: &'a [f64],
    /// Accelerations, rad/s^2 or m/s^2, coordinates x samples.
    pub acceleration: Option<&'a [f64]>,
    /// Columns of the terms with [`crate::Law::External`], externals x samples.
    pub external: &'a [f64],
    /// For each joint with given rates, in order: its position, those rates, then their time derivatives, channels x
    /// samples; see [`crate::Closure`].
    pub loops: &'a [f64],
}

impl Motion<'_> {
    /// Number of sets of rows: one with accelerations, two without. Each has a row for every coordinate.
    ///
    /// # Example
    ///
    /// ```
    /// use haptid_core::Motion;
    /// let motion = Motion { samples: 1, position: &[0.], velocity: &[0.], acceleration: None, external: &[], loops: &[] };
    /// assert_eq!(motion.sets(), 2);
    /// ```
    pub fn sets(&self) -> usize {
        if self.acceleration.is_some() { 1 } else { 2 }
    }

    /// Check the shapes of a motion that must have accelerations.
    pub(crate) fn check_accelerations(&self, mechanism: &Mechanism) -> Result<(), Error> {
        let wanted = self.samples * mechanism.coordinates;
        expect_length("acceleration", self.acceleration.map_or(0, <[f64]>::len), wanted)?;
        self.check(mechanism)
    }

    pub(crate) fn check(&self, mechanism: &Mechanism) -> Result<(), Error> {
        let wanted = self.samples * mechanism.coordinates;
        expect_length("velocity", self.velocity.len(), wanted)?;
        expect_length("acceleration", self.acceleration.map_or(wanted, <[f64]>::len), wanted)?;
        expect_length("external", self.external.len(), self.samples * mechanism.externals)?;
        self.check_poses(mechanism)
    }

    /// Check the shapes of what determines the pose.
    pub(crate) fn check_poses(&self, mechanism: &Mechanism) -> Result<(), Error> {
        expect_length("position", self.position.len(), self.samples * mechanism.coordinates)?;
        expect_length("loops", self.loops.len(), self.samples * mechanism.loops)
    }
}
