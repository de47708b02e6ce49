//! Dynamics by recursion, without the regressor: inverse dynamics (RNEA), mass matrix (CRBA), forward dynamics,
//! momentum; links in the play of their transmissions.

pub(crate) mod crba;
pub(crate) mod forward;
pub(crate) mod momentum;
pub(crate) mod play;
pub(crate) mod rnea;
