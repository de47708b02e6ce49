//! Linear algebra.

pub(crate) mod jacobi_svd;
pub(crate) mod small_qr;
pub(crate) mod tsqr;
pub(crate) mod vector;
