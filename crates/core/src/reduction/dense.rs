//! R factor of rows that are in memory already.

use crate::error::{Error, expect_length};
use crate::linalg::tsqr::fold;
use crate::memory::aligned::Aligned;
use crate::simd::dispatch::Backend;
use crate::simd::lane::MAX_WIDTH;

/// Rows per block, and distance of its columns: see `reduce`.
const FOLD: usize = 256;
const STRIDE: usize = FOLD + MAX_WIDTH;

/// The R factor of a matrix A: the upper triangle with R'R = A'A, square and row-major. A has `columns` columns,
/// row-major, and any number of rows.
///
/// # Example
///
/// ```
/// use haptid_core::{Backend, r_factor};
/// let mut r = [0.];
/// r_factor(Backend::best(), &[3., 4.], 1, &mut r)?;
/// assert!((r[0].abs() - 5.).abs() < 1e-12);
/// # Ok::<(), haptid_core::Error>(())
/// ```
pub fn r_factor(backend: Backend, rows: &[f64], columns: usize, out: &mut [f64]) -> Result<(), Error> {
    let count = rows.len().checked_div(columns).unwrap_or(0);
    expect_length("rows", rows.len(), count * columns)?;
    expect_length("out", out.len(), columns * columns)?;
    let (mut r, mut block, mut panels) = (vec![0.0; columns * columns], Aligned::default(), Vec::new());
    for rows in rows.chunks(FOLD * columns.max(1)) {
        block.clear(columns * STRIDE);
        for (k, row) in rows.chunks_exact(columns).enumerate() {
            row.iter().enumerate().for_each(|(c, &x)| block[c * STRIDE + k] = x);
        }
        fold(backend, &mut r, columns, (&mut block, rows.len() / columns, STRIDE), &mut panels);
    }
    out.iter_mut().enumerate().for_each(|(k, x)| *x = r[k % columns * columns + k / columns]);
    Ok(())
}
