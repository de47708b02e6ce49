//! Inverse dynamics of given parameters over whole motions.

use crate::error::{Error, expect_length};
use crate::mechanism::Mechanism;
use crate::momentum_sweep::momenta;
use crate::newton_euler::torques;
use crate::parameters::Sets;
use crate::regressor::{Motion, Shared};
use crate::sweep::{each_batch, put_rows};

/// Torques of parameters `chi` of all columns: `out[r * samples + k]`, rows as in [`crate::regressor`], momenta and what
/// is left of the torques where there are no accelerations.
///
/// There may be several sets of parameters, one after another: the samples are shared out among them evenly, in order. Of
/// terms whose parameters are all zero nothing is read.
pub fn torque(mechanism: &Mechanism, motion: &Motion, chi: &[f64], out: &mut [f64]) -> Result<(), Error> {
    let (n, na, backend) = (motion.samples, mechanism.coordinates, mechanism.backend);
    motion.check(mechanism)?;
    expect_length("out", out.len(), motion.sets() * na * n)?;
    let (sets, shared) = (Sets::new(mechanism, n, chi)?, Shared::new(out));
    each_batch(mechanism, motion, &sets, |batch, from, bodies, passing| {
        let samples = (from, batch.samples);
        // SAFETY: the workspace has grown to the mechanism; nobody else writes these samples.
        unsafe {
            if motion.acceleration.is_some() {
                torques(backend, batch, bodies, passing);
                put_rows(&passing.torque[..na], samples, n, shared);
            } else {
                momenta(backend, batch, bodies, passing);
                put_rows(&passing.other[..na], samples, n, shared);
                put_rows(&passing.torque[..na], (na * n + from, batch.samples), n, shared);
            }
        }
    });
    Ok(())
}
