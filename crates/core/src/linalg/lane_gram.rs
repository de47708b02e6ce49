//! Gram matrices A'A of long columns, summed in lanes: square tiles of columns keep their products in registers.

use crate::memory::aligned::Aligned;
use crate::simd::dispatch::{Backend, dispatched};
use crate::simd::inlined;
use crate::simd::lane::{Lane, MAX_WIDTH};
use crate::simd::token::Simd;

/// Width of the widest tile of any back end.
const MAX_TILE: usize = 4;

/// Sums of products of columns, a lane for each: tiles of the upper triangle, column of tiles by column of tiles.
#[derive(Default)]
pub(crate) struct LaneGram {
    lanes: Aligned,
}

impl LaneGram {
    /// Set to zero, for matrices with this number of columns.
    pub(crate) fn clear(&mut self, columns: usize) {
        // The narrowest tile makes the most of them.
        let across = columns.div_ceil(2);
        self.lanes.clear(across * (across + 1) / 2 * MAX_TILE * MAX_TILE * MAX_WIDTH);
    }

    /// Add A'A. Column c of A begins at `a[c * stride]`; its numbers from `rows` to the next whole lane must be zero.
    ///
    /// # Panics
    ///
    /// If `a` is shorter than its shape requires, or the sums were cleared for fewer columns.
    pub(crate) fn add(&mut self, backend: Backend, a: &[f64], columns: usize, rows: usize, stride: usize) {
        let (padded, across) = (rows.next_multiple_of(MAX_WIDTH), columns.div_ceil(2));
        assert!(padded <= stride && a.len() >= columns * stride);
        assert!(self.lanes.len() >= across * (across + 1) / 2 * MAX_TILE * MAX_TILE * MAX_WIDTH);
        // SAFETY: the assertions above keep all columns inside A, and all tiles inside the lanes.
        unsafe { add_products(backend, self.lanes.as_mut_ptr(), a.as_ptr(), (columns, stride), padded) }
    }

    /// Add the sums to a symmetric matrix of which only the upper triangle, column-major, is written.
    pub(crate) fn drain(&mut self, backend: Backend, columns: usize, out: &mut [f64]) {
        assert!(out.len() >= columns * columns);
        // SAFETY: as for `add`.
        unsafe { sum_lanes(backend, self.lanes.as_mut_ptr(), columns, out) };
    }
}

dispatched! {
    unsafe fn add_products = add_in_lanes(lanes: *mut f64, a: *const f64, shape: (usize, usize), rows: usize)
}

dispatched! {
    unsafe fn sum_lanes = sum_in_lanes(lanes: *mut f64, columns: usize, out: &mut [f64])
}

#[inline(always)]
unsafe fn add_in_lanes<T: Lane>(
    simd: Simd<T>,
    lanes: *mut f64,
    a: *const f64,
    (columns, stride): (usize, usize),
    rows: usize,
) {
    // SAFETY: the caller's promise, passed on.
    unsafe {
        match T::PANEL {
            2 => add_tiles::<T, 2>(simd, lanes, a, columns, stride, rows),
            3 => add_tiles::<T, 3>(simd, lanes, a, columns, stride, rows),
            _ => add_tiles::<T, MAX_TILE>(simd, lanes, a, columns, stride, rows),
        }
    }
}

#[inline(always)]
unsafe fn add_tiles<T: Lane, const P: usize>(
    simd: Simd<T>,
    mut lanes: *mut f64,
    a: *const f64,
    columns: usize,
    stride: usize,
    rows: usize,
) {
    for first in (0..columns).step_by(P) {
        // SAFETY: columns `first..first + N` exist, and tiles are as many as `LaneGram::clear` makes room for.
        unsafe {
            lanes = match columns - first {
                1 => add_column_of_tiles::<T, P, 1>(simd, lanes, a, first, stride, rows),
                2 if P > 2 => add_column_of_tiles::<T, P, 2>(simd, lanes, a, first, stride, rows),
                3 if P > 3 => add_column_of_tiles::<T, P, 3>(simd, lanes, a, first, stride, rows),
                _ => add_column_of_tiles::<T, P, P>(simd, lanes, a, first, stride, rows),
            };
        }
    }
}

/// Add the products of N columns from `first` on with all columns before them and with one another.
#[inline(always)]
unsafe fn add_column_of_tiles<T: Lane, const P: usize, const N: usize>(
    simd: Simd<T>,
    mut lanes: *mut f64,
    a: *const f64,
    first: usize,
    stride: usize,
    rows: usize,
) -> *mut f64 {
    // SAFETY: `first` is a multiple of P, so that P columns exist from each earlier multiple on.
    unsafe {
        let right: [*const f64; N] = inlined::from_fn(|k| a.add((first + k) * stride));
        for before in (0..first).step_by(P) {
            let left: [*const f64; P] = inlined::from_fn(|k| a.add((before + k) * stride));
            add_tile::<T, P, N, false>(simd, lanes, left, right, rows);
            lanes = lanes.add(P * P * MAX_WIDTH);
        }
        add_tile::<T, N, N, true>(simd, lanes, right, right, rows);
        lanes.add(P * P * MAX_WIDTH)
    }
}

/// Add the products of M columns with N others; only the upper triangle where they are the same.
#[inline(always)]
unsafe fn add_tile<T: Lane, const M: usize, const N: usize, const SAME: bool>(
    simd: Simd<T>,
    lanes: *mut f64,
    left: [*const f64; M],
    right: [*const f64; N],
    rows: usize,
) {
    // SAFETY: the tile has M x N lanes of `MAX_WIDTH` numbers, and the columns whole lanes up to `rows`.
    unsafe {
        let mut sums: [[T; M]; N] =
            inlined::from_fn(|j| inlined::from_fn(|i| simd.load(lanes.add((j * M + i) * MAX_WIDTH))));
        let mut k = 0;
        while k < rows {
            let left: [T; M] = inlined::from_fn(|i| simd.load(left[i].add(k)));
            for j in 0..N {
                let right = if SAME { left[j % M] } else { simd.load(right[j].add(k)) };
                for i in 0..M {
                    if !SAME || i <= j {
                        sums[j][i] = left[i].fma(right, sums[j][i]);
                    }
                }
            }
            k += T::WIDTH;
        }
        for (j, sums) in sums.iter().enumerate() {
            for (i, sum) in sums.iter().enumerate() {
                sum.store(lanes.add((j * M + i) * MAX_WIDTH));
            }
        }
    }
}

#[inline(always)]
unsafe fn sum_in_lanes<T: Lane>(simd: Simd<T>, mut lanes: *mut f64, columns: usize, out: &mut [f64]) {
    let tile = T::PANEL;
    for first in (0..columns).step_by(tile) {
        let across = tile.min(columns - first);
        for before in (0..=first).step_by(tile) {
            let down = if before == first { across } else { tile };
            for j in 0..across {
                for i in (0..down).filter(|i| before + i <= first + j) {
                    // SAFETY: the same tiles, in the same order, as in `add_tiles`.
                    out[(first + j) * columns + before + i] +=
                        unsafe { simd.load(lanes.add((j * down + i) * MAX_WIDTH)).sum() };
                }
            }
            // SAFETY: as above.
            lanes = unsafe { lanes.add(tile * tile * MAX_WIDTH) };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn products_are_those_of_columns_on_every_back_end() {
        for backend in Backend::available() {
            for columns in [1, 2, 3, 4, 5, 6, 7, 8, 9, 13, 44] {
                for rows in [1_usize, 7, 8, 9, 100] {
                    let stride = rows.next_multiple_of(MAX_WIDTH) + MAX_WIDTH;
                    let mut a = vec![0.0; columns * stride];
                    for c in 0..columns {
                        (0..rows).for_each(|k| a[c * stride + k] = ((c * 37 + k * 11) % 19) as f64 - 9.0);
                    }
                    let (mut sums, mut got) = (LaneGram::default(), vec![1.0; columns * columns]);
                    sums.clear(columns);
                    sums.add(backend, &a, columns, rows, stride);
                    sums.add(backend, &a, columns, rows, stride);
                    sums.drain(backend, columns, &mut got);
                    for j in 0..columns {
                        for i in 0..=j {
                            let one: f64 = (0..rows).map(|k| a[i * stride + k] * a[j * stride + k]).sum();
                            assert_eq!(got[j * columns + i], 1.0 + 2.0 * one, "{backend:?} {columns} {rows} {i} {j}");
                        }
                    }
                }
            }
        }
    }
}
