//! Dynamics.

pub(crate) mod crba;
pub(crate) mod forward;
pub(crate) mod momentum;
pub(crate) mod rnea;
