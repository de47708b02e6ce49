//! The end effector.

pub(crate) mod apparent_mass;
pub(crate) mod jacobian;
