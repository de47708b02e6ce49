//! End effector: its Jacobian, the mass matrix and the apparent mass at many poses.

pub(crate) mod apparent_mass;
pub(crate) mod jacobian;
pub(crate) mod spread;
