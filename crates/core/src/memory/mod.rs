//! Memory.

pub(crate) mod aligned;
pub(crate) mod shared;
pub(crate) mod slot;
pub(crate) mod stream;
