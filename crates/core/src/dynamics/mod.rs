//! Dynamics by recursion, without the regressor: inverse dynamics (RNEA), mass matrix (CRBA), forward dynamics,
//! momentum.

pub(crate) mod crba;
pub(crate) mod forward;
pub(crate) mod momentum;
pub(crate) mod rnea;
