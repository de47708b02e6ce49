//! Motions.

use crate::error::{Error, expect_length};
use crate::mechanism::Mechanism;

/// Samples that one thread takes at a time, a multiple of any lane; starting threads costs more than a few of these.
pub(crate) const PART: usize = 1024;

/// Positions, velocities and accelerations of the coordinates, and the caller's own columns, channel major:
/// sample `k` of coordinate `a` is at `a * samples + k`.
///
/// Without accelerations there are two sets of rows: generalised momenta, then what is left of the torque beside their
/// rate of change. Both are free of accelerations, and `Y(q, qd, qdd) = d/dt momenta + rest`.
#[derive(Debug, Clone, Copy)]
pub struct Motion<'a> {
    pub samples: usize,
    pub position: &'a [f64],
    pub velocity: &'a [f64],
    pub acceleration: Option<&'a [f64]>,
    pub external: &'a [f64],
    /// For each joint with given rates, in order: its position, those rates, then their changes; see [`crate::Closure`].
    pub loops: &'a [f64],
}

impl Motion<'_> {
    /// ParameterSets of rows, each as many as coordinates.
    pub fn sets(&self) -> usize {
        if self.acceleration.is_some() { 1 } else { 2 }
    }

    /// The same of a motion that must have accelerations.
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

    /// Check what says where the links are.
    pub(crate) fn check_poses(&self, mechanism: &Mechanism) -> Result<(), Error> {
        expect_length("position", self.position.len(), self.samples * mechanism.coordinates)?;
        expect_length("loops", self.loops.len(), self.samples * mechanism.loops)
    }
}
