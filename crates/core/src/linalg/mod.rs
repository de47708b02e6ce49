//! Linear algebra: QR of long stacks of rows (TSQR), least squares in lanes, singular values of one pose, condition
//! numbers of Gram matrices, three-vectors, recursive filters.

pub(crate) mod condition;
pub(crate) mod jacobi_svd;
pub(crate) mod lane_gram;
pub(crate) mod preconditioned_gram;
pub(crate) mod sections;
pub(crate) mod small_qr;
pub(crate) mod square;
pub(crate) mod tsqr;
pub(crate) mod vector;

/// Numbers between -1 and 1 that a seed gives again, for tests: Marsaglia's xorshift (2003), Journal of Statistical
/// Software 8(14).
#[cfg(test)]
pub(crate) fn draws(seed: u64) -> impl FnMut() -> f64 {
    let mut state = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1;
    move || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
    }
}
