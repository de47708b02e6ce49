//! Loops: gaps of cut joints, assembly by Gauss-Newton, and continuation of assembly modes along motions.

pub(crate) mod assembly;
pub(crate) mod continuation;
pub(crate) mod cut;
pub(crate) mod gap;
pub(crate) mod gauss_newton;
pub(crate) mod newton;
pub(crate) mod pose;
pub(crate) mod segment;
