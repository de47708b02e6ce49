//! Sequential TSQR: Householder QR of [R; A] updates an upper triangle R by a block of rows A, a panel of columns at a
//! time.
//!
//! The algorithm is left-looking: a panel is updated, by all panels before it, when its turn comes. The pass that
//! applies one panel's reflections to its columns also computes their inner products with the next panel's vectors, so
//! that each column is read and written once for both. (Compact WY form: Schreiber and Van Loan 1989, SIAM J. Sci.
//! Stat. Comput. 10(1), eq. 3.)
//!
//! The normal equations would lose one to three digits at the condition numbers of dynamic identification.
//!
//! Safety: [`fold`] checks the sizes of R and A, whose rows are padded to whole lanes. Every unsafe function below
//! relies on this block: column indices are below `columns`, and lanes are read and written at multiples of the lane
//! width below `rows`, hence inside a column's `stride` numbers.

use crate::simd::dispatch::{Backend, dispatched};
use crate::simd::inlined;
use crate::simd::lane::{Lane, MAX_WIDTH};
use crate::simd::token::Simd;

/// Width of the widest panel of any back end.
const MAX_PANEL: usize = 4;

/// T of a panel's compact WY form I - V T V'; column k of V is column k of the panel below a unit in row k of R.
pub(crate) type CompactPanel = [[f64; MAX_PANEL]; MAX_PANEL];

/// Fold rows into a triangle: R becomes the R factor of [R; A]. A is overwritten; `panels` is a buffer.
///
/// `r` is `columns` x `columns`, column-major, upper. Column c of A begins at `a[c * stride]`; its numbers from `rows`
/// to the next whole lane must be zero.
///
/// # Panics
///
/// If a slice is shorter than its shape requires.
pub(crate) fn fold(
    backend: Backend,
    r: &mut [f64],
    columns: usize,
    (a, rows, stride): (&mut [f64], usize, usize),
    panels: &mut Vec<CompactPanel>,
) {
    let padded = rows.next_multiple_of(MAX_WIDTH);
    assert!(r.len() >= columns * columns && padded <= stride && a.len() >= columns * stride);
    if rows > 0 {
        let block = Block { r, columns, a: a.as_mut_ptr(), rows: padded, stride };
        // SAFETY: the assertion above makes R and A as large as the head of the file requires.
        unsafe { fold_raw(backend, block, panels) }
    }
}

/// Fold the triangle `other`, of the same size, into `r`. `rows` is a buffer.
pub(crate) fn merge(backend: Backend, r: &mut [f64], other: &[f64], columns: usize, rows: &mut Vec<f64>) {
    let stride = columns.next_multiple_of(MAX_WIDTH);
    rows.clear();
    rows.resize(columns * stride, 0.0);
    for (column, source) in rows.chunks_exact_mut(stride).zip(other.chunks_exact(columns)) {
        column[..columns].copy_from_slice(source);
    }
    fold(backend, r, columns, (rows, columns, stride), &mut Vec::new());
}

/// A triangle R and the rows A to be folded into it, by pointer: several columns are written at a time.
struct Block<'a> {
    r: &'a mut [f64],
    columns: usize,
    a: *mut f64,
    rows: usize,
    stride: usize,
}

impl Block<'_> {
    #[inline(always)]
    unsafe fn column(&self, c: usize) -> *mut f64 {
        // SAFETY: c < columns, so that the column begins inside A.
        unsafe { self.a.add(c * self.stride) }
    }

    #[inline(always)]
    unsafe fn some<const N: usize>(&self, first: usize) -> [*mut f64; N] {
        // SAFETY: as for `column`, for columns `first..first + N`.
        inlined::from_fn(|k| unsafe { self.column(first + k) })
    }
}

dispatched! {
    unsafe fn fold_raw = fold_in_lanes(block: Block, panels: &mut Vec<CompactPanel>)
}

#[inline(always)]
unsafe fn fold_in_lanes<T: Lane>(simd: Simd<T>, block: Block, panels: &mut Vec<CompactPanel>) {
    // SAFETY: the caller's promise about the block.
    unsafe {
        match T::PANEL {
            2 => fold_panels::<T, 2>(simd, block, panels),
            3 => fold_panels::<T, 3>(simd, block, panels),
            _ => fold_panels::<T, MAX_PANEL>(simd, block, panels),
        }
    }
}

#[inline(always)]
unsafe fn fold_panels<T: Lane, const P: usize>(simd: Simd<T>, mut block: Block, panels: &mut Vec<CompactPanel>) {
    panels.clear();
    let block = &mut block;
    let mut first = 0;
    // SAFETY: the loops take columns `first..first + N` only while they are below `columns`.
    unsafe {
        while first + 2 * P <= block.columns {
            reflect::<T, P, P, 2>(simd, block, panels, 0, first);
            panels.push(factor::<T, P>(simd, block, first));
            reflect::<T, P, P, 1>(simd, block, panels, panels.len() - 1, first + P);
            panels.push(factor::<T, P>(simd, block, first + P));
            first += 2 * P;
        }
        if first + P <= block.columns {
            finish::<T, P, P>(simd, block, panels, first);
            first += P;
        }
        match block.columns - first {
            1 => finish::<T, P, 1>(simd, block, panels, first),
            2 => finish::<T, P, 2>(simd, block, panels, first),
            3 => finish::<T, P, 3>(simd, block, panels, first),
            _ => (),
        }
    }
}

/// Update and factorise one panel of N columns.
#[inline(always)]
unsafe fn finish<T: Lane, const P: usize, const N: usize>(
    simd: Simd<T>,
    block: &mut Block,
    panels: &mut Vec<CompactPanel>,
    first: usize,
) {
    // SAFETY: the caller promises that columns `first..first + N` exist.
    unsafe {
        reflect::<T, P, N, 1>(simd, block, panels, 0, first);
        panels.push(factor::<T, N>(simd, block, first));
    }
}

/// Apply the panels from `begin` on to G groups of N columns. The groups are interleaved: the horizontal sums of one
/// overlap with the passes of the next.
#[inline(always)]
unsafe fn reflect<T: Lane, const P: usize, const N: usize, const G: usize>(
    simd: Simd<T>,
    block: &mut Block,
    panels: &[CompactPanel],
    begin: usize,
    c: usize,
) {
    if begin == panels.len() {
        return;
    }
    // SAFETY: columns `c..c + G N` exist by the caller's promise, and those of a panel that is factorised do too;
    // `exchange` stays inside `rows`.
    unsafe {
        let none = [[simd.splat(0.0); N]; P];
        let x: [[*mut f64; N]; G] = inlined::from_fn(|g| block.some(c + g * N));
        let mut v = block.some::<P>(begin * P);
        let mut weights = [none; G];
        for g in 0..G {
            let sums = reflect_and_project::<T, P, N, false, true>(simd, v, &none, v, x[g], block.rows);
            weights[g] = reflection_weights(simd, block, &panels[begin], begin * P, c + g * N, &sums);
        }
        for (j, panel) in panels.iter().enumerate().skip(begin + 1) {
            let next = block.some::<P>(j * P);
            for g in 0..G {
                let sums = reflect_and_project::<T, P, N, true, true>(simd, v, &weights[g], next, x[g], block.rows);
                weights[g] = reflection_weights(simd, block, panel, j * P, c + g * N, &sums);
            }
            v = next;
        }
        for (weights, x) in weights.iter().zip(x) {
            reflect_and_project::<T, P, N, true, false>(simd, v, weights, v, x, block.rows);
        }
    }
}

/// Weights with which the panel's vectors are subtracted from N columns, whose entries in R are updated here.
#[inline(always)]
fn reflection_weights<T: Lane, const P: usize, const N: usize>(
    simd: Simd<T>,
    block: &mut Block,
    panel: &CompactPanel,
    first: usize,
    c: usize,
    sums: &[[T; N]; P],
) -> [[T; N]; P] {
    let mut weights = [[simd.splat(0.0); N]; P];
    for j in 0..N {
        let head = &mut block.r[(c + j) * block.columns + first..][..P];
        let s: [f64; P] = inlined::from_fn(|k| sums[k][j].sum() + head[k]);
        for k in 0..P {
            let weight: f64 = (0..=k).map(|l| panel[l][k] * s[l]).sum();
            weights[k][j] = simd.splat(weight);
            head[k] -= weight;
        }
    }
    weights
}

/// Subtract the vectors `v` with their weights from N columns (if `TAKE`), and return the inner products of the result
/// with the vectors `next` (if `SUM`).
#[inline(always)]
unsafe fn reflect_and_project<T: Lane, const P: usize, const N: usize, const TAKE: bool, const SUM: bool>(
    simd: Simd<T>,
    v: [*mut f64; P],
    weights: &[[T; N]; P],
    next: [*mut f64; P],
    x: [*mut f64; N],
    rows: usize,
) -> [[T; N]; P] {
    let mut sums = [[simd.splat(0.0); N]; P];
    let mut i = 0;
    while i < rows {
        // SAFETY: i < rows, a multiple of the lane width: the lane is inside the column, as for all accesses of the
        // loop.
        let mut lanes: [T; N] = inlined::from_fn(|j| unsafe { simd.load(x[j].add(i)) });
        if TAKE {
            for (v, weights) in v.iter().zip(weights) {
                // SAFETY: as above.
                let v = unsafe { simd.load(v.add(i)) };
                for (lane, &weight) in lanes.iter_mut().zip(weights) {
                    *lane = v.fnma(weight, *lane);
                }
            }
            for (lane, x) in lanes.iter().zip(x) {
                // SAFETY: as above.
                unsafe { lane.store(x.add(i)) };
            }
        }
        if SUM {
            for (v, sums) in next.iter().zip(&mut sums) {
                // SAFETY: as above.
                let v = unsafe { simd.load(v.add(i)) };
                for (sum, &lane) in sums.iter_mut().zip(&lanes) {
                    *sum = v.fma(lane, *sum);
                }
            }
        }
        i += T::WIDTH;
    }
    sums
}

/// Factorise a panel: reflect its columns onto R one after the other.
///
/// The pass that applies a reflection to the columns after it also computes the inner products of the next column with
/// all of them.
#[inline(always)]
unsafe fn factor<T: Lane, const W: usize>(simd: Simd<T>, block: &mut Block, first: usize) -> CompactPanel {
    let (columns, rows) = (block.columns, block.rows);
    let mut t = [[0.0; MAX_PANEL]; MAX_PANEL];
    // The column to be reflected, those after it, then those before it.
    // SAFETY: the caller promises that columns `first..first + W` exist.
    let mut x = unsafe { block.some::<W>(first) };
    // SAFETY: the columns are inside the block, as below.
    let mut products = unsafe { subtract_reflection::<T, W, 0>(simd, x, (1.0, [0.0; W]), rows) };
    for k in 0..W {
        let (mut scale, mut taken) = (0.0, [0.0; W]);
        let diagonal = (first + k) * columns + first + k;
        let (alpha, below) = (block.r[diagonal], products[0]);
        // Below this the column is zero compared with its diagonal, and its square may underflow. NaN propagates.
        if below >= f64::MIN_POSITIVE || below.is_nan() {
            let beta = -(alpha * alpha + below).sqrt().copysign(alpha);
            let tau = (beta - alpha) / beta;
            scale = 1.0 / (alpha - beta);
            block.r[diagonal] = beta;
            for c in 1..W - k {
                let above = diagonal + c * columns;
                taken[c] = tau * (block.r[above] + scale * products[c]);
                block.r[above] -= taken[c];
            }
            let inner = |j: usize| scale * products[W - k + j];
            t[k][k] = tau;
            for (j, row) in t.iter_mut().enumerate().take(k) {
                row[k] = -tau * (j..k).map(|l| row[l] * inner(l)).sum::<f64>();
            }
        }
        // SAFETY: as above.
        products = unsafe { subtract_reflection::<T, W, 1>(simd, x, (scale, taken), rows) };
        x.rotate_left(1);
        products.rotate_left(1);
    }
    t
}

/// Scale the first column, subtract it from the others, and return their inner products with column NEXT.
#[inline(always)]
unsafe fn subtract_reflection<T: Lane, const W: usize, const NEXT: usize>(
    simd: Simd<T>,
    x: [*mut f64; W],
    (scale, taken): (f64, [f64; W]),
    rows: usize,
) -> [f64; W] {
    let (scale, taken, mut sums) = (simd.splat(scale), inlined::map(taken, |x| simd.splat(x)), [simd.splat(0.0); W]);
    let mut i = 0;
    while i < rows {
        // SAFETY: i < rows, a multiple of the lane width: the lane is inside the column, as below.
        let mut lanes: [T; W] = inlined::from_fn(|c| unsafe { simd.load(x[c].add(i)) });
        lanes[0] = lanes[0].mul(scale);
        for c in 1..W {
            lanes[c] = lanes[0].fnma(taken[c], lanes[c]);
        }
        for (sum, &lane) in sums.iter_mut().zip(&lanes) {
            *sum = lanes[NEXT % W].fma(lane, *sum);
        }
        for (lane, x) in lanes.iter().zip(x) {
            // SAFETY: as above.
            unsafe { lane.store(x.add(i)) };
        }
        i += T::WIDTH;
    }
    sums.map(T::sum)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::linalg::draws;

    /// Pseudo-random numbers in -1..1, the same on every machine.
    fn numbers(count: usize, seed: u64) -> Vec<f64> {
        let mut next = draws(seed);
        (0..count).map(|_| next()).collect()
    }

    /// R'R equals A'A on every back end, for shapes around the panel and lane widths.
    #[test]
    fn the_r_factor_keeps_the_inner_products() {
        for backend in Backend::available() {
            for columns in [1, 2, 3, 4, 5, 7, 8, 9, 13, 44] {
                for rows in [1usize, 2, 7, 8, 9, 31, 100] {
                    let stride = rows.next_multiple_of(8) + 8;
                    let mut a = vec![0.0; columns * stride];
                    for c in 0..columns {
                        a[c * stride..c * stride + rows].copy_from_slice(&numbers(rows, (c * 1000 + rows) as u64));
                    }
                    let kept = a.clone();
                    let mut r = vec![0.0; columns * columns];
                    fold(backend, &mut r, columns, (&mut a, rows, stride), &mut Vec::new());
                    for i in 0..columns {
                        for j in 0..columns {
                            let wanted: f64 = (0..rows).map(|k| kept[i * stride + k] * kept[j * stride + k]).sum();
                            let got: f64 = (0..columns).map(|k| r[i * columns + k] * r[j * columns + k]).sum();
                            assert!((wanted - got).abs() < 1e-12 * rows as f64, "{backend:?} {columns} {rows}");
                        }
                    }
                }
            }
        }
    }

    /// Merging two triangles gives that of all rows.
    #[test]
    fn merging_two_r_factors_gives_that_of_all_rows() {
        for backend in Backend::available() {
            let (columns, rows) = (7, 40);
            let a = numbers(columns * rows, 3);
            let of = |from: usize, count: usize| {
                let stride = count.next_multiple_of(8);
                let mut some = vec![0.0; columns * stride];
                for c in 0..columns {
                    some[c * stride..][..count].copy_from_slice(&a[c * rows + from..][..count]);
                }
                let mut r = vec![0.0; columns * columns];
                fold(backend, &mut r, columns, (&mut some, count, stride), &mut Vec::new());
                r
            };
            let (mut some, whole) = (of(0, 19), of(0, rows));
            merge(backend, &mut some, &of(19, rows - 19), columns, &mut Vec::new());
            for (got, wanted) in some.iter().zip(&whole) {
                assert!((got.abs() - wanted.abs()).abs() < 1e-13, "{backend:?} {got} {wanted}");
            }
        }
    }
}
