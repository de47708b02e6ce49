//! The triangle of rows that are already there.

use crate::aligned::Aligned;
use crate::dispatch::Backend;
use crate::error::{Error, expect_length};
use crate::lane::MAX_WIDTH;
use crate::triangle::fold;

/// Rows folded at a time, and how far apart the columns of such a block are: see `reduce`.
const FOLD: usize = 256;
const STRIDE: usize = FOLD + MAX_WIDTH;

/// The square upper triangle R with R'R = A'A, row-major, of rows A of so many columns, row-major. There may be fewer rows
/// than columns, or none.
pub fn triangle(rows: &[f64], columns: usize, out: &mut [f64]) -> Result<(), Error> {
    let many = rows.len().checked_div(columns).unwrap_or(0);
    expect_length("rows", rows.len(), many * columns)?;
    expect_length("out", out.len(), columns * columns)?;
    let (mut r, mut block, mut panels) = (vec![0.0; columns * columns], Aligned::default(), Vec::new());
    for rows in rows.chunks(FOLD * columns.max(1)) {
        block.clear(columns * STRIDE);
        for (k, row) in rows.chunks_exact(columns).enumerate() {
            row.iter().enumerate().for_each(|(c, &x)| block[c * STRIDE + k] = x);
        }
        fold(Backend::best(), &mut r, columns, (&mut block, rows.len() / columns, STRIDE), &mut panels);
    }
    out.iter_mut().enumerate().for_each(|(k, x)| *x = r[k % columns * columns + k / columns]);
    Ok(())
}
