//! Linear algebra: QR of long stacks of rows (TSQR), least squares in lanes, singular values of one pose, condition
//! numbers of Gram matrices, three-vectors.

pub(crate) mod condition;
pub(crate) mod jacobi_svd;
pub(crate) mod lane_gram;
pub(crate) mod preconditioned_gram;
pub(crate) mod small_qr;
pub(crate) mod square;
pub(crate) mod tsqr;
pub(crate) mod vector;
