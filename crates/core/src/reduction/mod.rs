//! Reduction.

pub(crate) mod dense;
pub(crate) mod fir;
pub(crate) mod reduce;
