//! Buffers: slots of a batch, cache-aligned arrays, outputs shared by threads, stores that bypass the caches.

pub(crate) mod aligned;
pub(crate) mod shared;
pub(crate) mod slot;
pub(crate) mod stream;
