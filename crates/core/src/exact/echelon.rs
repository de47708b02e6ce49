//! Reduced row echelon forms modulo a prime.
//!
//! A row's multiple is reduced with the quotient of its factor by the prime, which is computed once for the row
//! (Shoup's multiplication: Harvey 2014, J. Symbolic Computation 60, alg. 2). All is in 32-bit integers, which the
//! compiler puts into vector registers.

use crate::error::{Error, expect_length};
use crate::exact::field::Field;
use crate::simd::dispatch::{Backend, dispatched};
use crate::simd::lane::Lane;
use crate::simd::token::Simd;

/// Bring matrices with the same pivots to reduced row echelon form, in place: their first rows are the forms' rows,
/// those after the pivots are undefined. Returns the pivots' columns, or `None` if the matrices differ in them. Only
/// the first `candidates` columns may be pivots. Entries may be any integers.
///
/// # Example
///
/// ```
/// // 2 x + 4 y = 6 modulo 7 is x + 2 y = 3.
/// let mut row = [2, 4, 6];
/// let pivots = haptid_core::echelon(haptid_core::Backend::best(), &mut row, [1, 1, 3], 3, 7)?;
/// assert_eq!((pivots, row), (Some(vec![0]), [1, 2, 3]));
/// # Ok::<(), haptid_core::Error>(())
/// ```
pub fn echelon(
    backend: Backend,
    matrices: &mut [i64],
    shape: [usize; 3],
    candidates: usize,
    prime: u32,
) -> Result<Option<Vec<usize>>, Error> {
    let ([count, rows, columns], field) = (shape, Field::new(prime)?);
    expect_length("matrices", matrices.len(), count * rows * columns)?;
    let mut first: Option<Vec<usize>> = None;
    let mut matrix = vec![0_u32; rows * columns];
    for entries in matrices.chunks_exact_mut((rows * columns).max(1)) {
        matrix.iter_mut().zip(&*entries).for_each(|(x, &entry)| *x = field.of(entry) as u32);
        let mut pivots = Vec::new();
        reduce_matrix(backend, &mut matrix, columns, candidates.min(columns), field, &mut pivots);
        entries.iter_mut().zip(&matrix).for_each(|(entry, &x)| *entry = x.into());
        match &first {
            Some(first) if *first != pivots => return Ok(None),
            Some(_) => (),
            None => first = Some(pivots),
        }
    }
    Ok(Some(first.unwrap_or_default()))
}

dispatched! {
    fn reduce_matrix = reduce_any(
        matrix: &mut [u32], columns: usize, candidates: usize, field: Field, pivots: &mut Vec<usize>,
    )
}

/// The type of lane chooses the instructions only.
#[inline(always)]
fn reduce_any<T: Lane>(
    _: Simd<T>,
    matrix: &mut [u32],
    columns: usize,
    candidates: usize,
    field: Field,
    pivots: &mut Vec<usize>,
) {
    let p = field.prime as u32;
    let whole = |x: u32| if x >= p { x - p } else { x };
    for column in 0..candidates {
        let top = pivots.len();
        let below = matrix.chunks_exact(columns).skip(top);
        let Some(found) = below.into_iter().position(|row| whole(row[column]) != 0) else { continue };
        // Entries left of the column are zero in both rows, below the pivots; those in pivots' columns above too.
        let (above, rest) = matrix.split_at_mut((top + 1) * columns);
        let pivot = &mut above[top * columns..];
        if found > 0 {
            pivot.swap_with_slice(&mut rest[(found - 1) * columns..found * columns]);
        }
        let scale = field.invert(whole(pivot[column]).into());
        pivot[column..].iter_mut().for_each(|x| *x = field.reduce(u64::from(*x) * scale) as u32);
        for row in rest.chunks_exact_mut(columns) {
            let factor = whole(row[column]);
            add_multiple(&mut row[column..], &pivot[column..], field.minus(factor.into()), p);
        }
        pivots.push(column);
    }
    for (k, &column) in pivots.iter().enumerate().rev() {
        let (above, rest) = matrix.split_at_mut(k * columns);
        let pivot = &rest[..columns];
        // Between the pivot and this column the row is zero already, as later pivots were eliminated first.
        let start = (column + 1..columns).find(|&c| whole(pivot[c]) != 0).unwrap_or(columns);
        for row in above.chunks_exact_mut(columns) {
            let factor = whole(row[column]);
            add_multiple(&mut row[start..], &pivot[start..], field.minus(factor.into()), p);
            row[column] = 0;
        }
    }
    matrix.iter_mut().for_each(|x| *x = whole(*x));
}

/// Add a multiple of a row to another; entries are below 2 p, before and after.
#[inline(always)]
fn add_multiple(row: &mut [u32], other: &[u32], factor: u64, p: u32) {
    if factor == 0 {
        return;
    }
    let quotient = (factor << 32) / u64::from(p);
    let (factor, twice) = (factor as u32, 2 * p);
    for (x, &y) in row.iter_mut().zip(other) {
        let whole = ((u64::from(y) * quotient) >> 32) as u32;
        let sum = *x + y.wrapping_mul(factor).wrapping_sub(whole.wrapping_mul(p)); // below 4 p < 2^32
        *x = sum.min(sum.wrapping_sub(twice));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PRIME: u32 = 1_073_741_783;

    /// Rows of a random combination of `rank` random ones, so that the pivots are the first `rank` columns.
    fn matrix(rank: usize, rows: usize, columns: usize, seed: u64) -> Vec<i64> {
        let mut state = seed | 1;
        let mut draw = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 33) as i64 % i64::from(PRIME)
        };
        let base: Vec<i64> = (0..rank * columns).map(|_| draw()).collect();
        let weights: Vec<i64> = (0..rows * rank).map(|_| draw()).collect();
        let p = i128::from(PRIME);
        let entry = |i: usize, j: usize| {
            let sum: i128 =
                (0..rank).map(|k| i128::from(weights[i * rank + k]) * i128::from(base[k * columns + j])).sum();
            (sum % p) as i64
        };
        (0..rows * columns).map(|k| entry(k / columns, k % columns)).collect()
    }

    /// The forms span the rows: every row is the sum of the forms' rows with its own entries at the pivots.
    #[test]
    fn forms_span_the_rows_on_every_back_end() {
        for backend in Backend::available() {
            for (rank, rows, columns) in [(1, 1, 1), (2, 5, 3), (4, 4, 9), (7, 20, 31), (19, 19, 19)] {
                let kept: Vec<i64> = (0..3).flat_map(|k| matrix(rank, rows, columns, 77 + k)).collect();
                let mut made = kept.clone();
                let pivots = echelon(backend, &mut made, [3, rows, columns], columns, PRIME).unwrap().unwrap();
                assert_eq!(pivots, (0..rank).collect::<Vec<_>>());
                for (form, rows) in made.chunks_exact(rows * columns).zip(kept.chunks_exact(rows * columns)) {
                    for row in rows.chunks_exact(columns) {
                        for j in 0..columns {
                            let sum: i128 = pivots
                                .iter()
                                .enumerate()
                                .map(|(k, &c)| i128::from(row[c]) * i128::from(form[k * columns + j]))
                                .sum();
                            assert_eq!(sum % i128::from(PRIME), i128::from(row[j]));
                        }
                    }
                }
            }
        }
    }

    #[test]
    fn different_pivots_and_wrong_arguments_are_told() {
        let backend = Backend::best();
        assert_eq!(echelon(backend, &mut [1, 2, 0, 3], [2, 1, 2], 2, PRIME), Ok(None));
        assert_eq!(echelon(backend, &mut [0, 2, 0, 3], [2, 1, 2], 1, PRIME), Ok(Some(vec![])));
        assert_eq!(echelon(backend, &mut [], [0, 4, 2], 2, PRIME), Ok(Some(vec![])));
        assert!(echelon(backend, &mut [1], [1, 1, 2], 2, PRIME).is_err());
        assert!(echelon(backend, &mut [1], [1, 1, 1], 1, 1 << 31).is_err());
    }
}
