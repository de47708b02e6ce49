//! A small upper triangle that takes up blocks of rows: Householder QR of [R; A], a panel of columns at a time.
//!
//! A panel is worked on when its turn comes, by all panels before it: the step that takes one panel's reflections out of
//! its columns finds their inner products with the next panel's too, so that a column is read and written once for both.
//! (Reflections in compact form: Schreiber and Van Loan 1989, SIAM J. Sci. Stat. Comput. 10(1), eq. 3.)
//!
//! Never the normal equations: they lose one to three digits at the condition numbers of this field.
//!
//! Safety: [`fold`] checks that R and A are as large as their shape says, with rows padded to whole lanes. Every unsafe
//! function below takes columns of that A by pointer, and reads and writes whole lanes inside their `stride`.

use crate::simd::dispatch::{Backend, dispatched};
use crate::simd::lane::{Lane, MAX_WIDTH};

/// Widest panel of any back end.
const MAX_PANEL: usize = 4;

/// The upper triangle of a panel's compact form I - V T V', where column k of V is that of A below a unit in row k of R.
pub(crate) type CompactPanel = [[f64; MAX_PANEL]; MAX_PANEL];

/// Fold `rows` rows into the triangle: R becomes the triangle of [R; A]. A is overwritten, and so is `panels`.
///
/// `r` is `columns` x `columns`, column-major, upper. Column c of A is at `a[c * stride..]`; its numbers from `rows`
/// to the next whole lane must be zero.
///
/// # Panics
/// When a slice is shorter than its shape says.
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
        // SAFETY: checked above: R and A are as large as the kernel takes them to be.
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

/// The triangle and the rows it takes up.
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
        unsafe { self.a.add(c * self.stride) }
    }

    #[inline(always)]
    unsafe fn some<const N: usize>(&self, first: usize) -> [*mut f64; N] {
        core::array::from_fn(|k| unsafe { self.column(first + k) })
    }
}

dispatched! {
    unsafe fn fold_raw = fold_in_lanes(block: Block, panels: &mut Vec<CompactPanel>)
}

#[inline(always)]
unsafe fn fold_in_lanes<T: Lane>(block: Block, panels: &mut Vec<CompactPanel>) {
    // SAFETY: the caller's promise.
    unsafe {
        match T::PANEL {
            2 => fold_panels::<T, 2>(block, panels),
            3 => fold_panels::<T, 3>(block, panels),
            _ => fold_panels::<T, MAX_PANEL>(block, panels),
        }
    }
}

#[inline(always)]
unsafe fn fold_panels<T: Lane, const P: usize>(mut block: Block, panels: &mut Vec<CompactPanel>) {
    panels.clear();
    let block = &mut block;
    let mut first = 0;
    // SAFETY: columns up to `first`, and those taken next, are columns of A.
    unsafe {
        while first + 2 * P <= block.columns {
            reflect::<T, P, P, 2>(block, panels, 0, first);
            panels.push(factor::<T, P>(block, first));
            reflect::<T, P, P, 1>(block, panels, panels.len() - 1, first + P);
            panels.push(factor::<T, P>(block, first + P));
            first += 2 * P;
        }
        if first + P <= block.columns {
            finish::<T, P, P>(block, panels, first);
            first += P;
        }
        match block.columns - first {
            1 => finish::<T, P, 1>(block, panels, first),
            2 => finish::<T, P, 2>(block, panels, first),
            3 => finish::<T, P, 3>(block, panels, first),
            _ => (),
        }
    }
}

/// One panel of N columns, from all before it.
#[inline(always)]
unsafe fn finish<T: Lane, const P: usize, const N: usize>(
    block: &mut Block,
    panels: &mut Vec<CompactPanel>,
    first: usize,
) {
    unsafe {
        reflect::<T, P, N, 1>(block, panels, 0, first);
        panels.push(factor::<T, N>(block, first));
    }
}

/// Apply the panels from `begin` on to G times N columns. While one N of them is worked on, the weights of the next are
/// found: a sum across a lane takes long to come.
#[inline(always)]
unsafe fn reflect<T: Lane, const P: usize, const N: usize, const G: usize>(
    block: &mut Block,
    panels: &[CompactPanel],
    begin: usize,
    c: usize,
) {
    if begin == panels.len() {
        return;
    }
    unsafe {
        let none = [[T::splat(0.0); N]; P];
        let x: [[*mut f64; N]; G] = core::array::from_fn(|g| block.some(c + g * N));
        let mut v = block.some::<P>(begin * P);
        let mut weights = [none; G];
        for g in 0..G {
            let sums = reflect_and_project::<T, P, N, false, true>(v, &none, v, x[g], block.rows);
            weights[g] = reflection_weights(block, &panels[begin], begin * P, c + g * N, &sums);
        }
        for (j, panel) in panels.iter().enumerate().skip(begin + 1) {
            let next = block.some::<P>(j * P);
            for g in 0..G {
                let sums = reflect_and_project::<T, P, N, true, true>(v, &weights[g], next, x[g], block.rows);
                weights[g] = reflection_weights(block, panel, j * P, c + g * N, &sums);
            }
            v = next;
        }
        for (weights, x) in weights.iter().zip(x) {
            reflect_and_project::<T, P, N, true, false>(v, weights, v, x, block.rows);
        }
    }
}

/// What is taken out of N columns along each reflector, and out of their heads in R.
#[inline(always)]
fn reflection_weights<T: Lane, const P: usize, const N: usize>(
    block: &mut Block,
    panel: &CompactPanel,
    first: usize,
    c: usize,
    sums: &[[T; N]; P],
) -> [[T; N]; P] {
    let mut weights = [[T::splat(0.0); N]; P];
    for j in 0..N {
        let head = &mut block.r[(c + j) * block.columns + first..][..P];
        let s: [f64; P] = core::array::from_fn(|k| sums[k][j].sum() + head[k]);
        for k in 0..P {
            let weight: f64 = (0..=k).map(|l| panel[l][k] * s[l]).sum();
            weights[k][j] = T::splat(weight);
            head[k] -= weight;
        }
    }
    weights
}

/// Take one panel's reflections out of N columns, if `TAKE`; if `SUM`, return their inner products with the next panel.
#[inline(always)]
unsafe fn reflect_and_project<T: Lane, const P: usize, const N: usize, const TAKE: bool, const SUM: bool>(
    v: [*mut f64; P],
    weights: &[[T; N]; P],
    next: [*mut f64; P],
    x: [*mut f64; N],
    rows: usize,
) -> [[T; N]; P] {
    let mut sums = [[T::splat(0.0); N]; P];
    let mut i = 0;
    while i < rows {
        let mut lanes: [T; N] = core::array::from_fn(|j| unsafe { T::load(x[j].add(i)) });
        if TAKE {
            for (v, weights) in v.iter().zip(weights) {
                let v = unsafe { T::load(v.add(i)) };
                for (lane, &weight) in lanes.iter_mut().zip(weights) {
                    *lane = v.fnma(weight, *lane);
                }
            }
            for (lane, x) in lanes.iter().zip(x) {
                unsafe { lane.store(x.add(i)) };
            }
        }
        if SUM {
            for (v, sums) in next.iter().zip(&mut sums) {
                let v = unsafe { T::load(v.add(i)) };
                for (sum, &lane) in sums.iter_mut().zip(&lanes) {
                    *sum = v.fma(lane, *sum);
                }
            }
        }
        i += T::WIDTH;
    }
    sums
}

/// Reflect a panel's columns onto R.
///
/// The step that takes a reflection out of the columns after it finds the inner products of the next one with them all.
#[inline(always)]
unsafe fn factor<T: Lane, const W: usize>(block: &mut Block, first: usize) -> CompactPanel {
    let (columns, rows) = (block.columns, block.rows);
    let mut t = [[0.0; MAX_PANEL]; MAX_PANEL];
    // The column to be reflected, those after it, then those before it.
    let mut x = unsafe { block.some::<W>(first) };
    let mut products = unsafe { subtract_reflection::<T, W, 0>(x, (1.0, [0.0; W]), rows) };
    for k in 0..W {
        let (mut scale, mut taken) = (0.0, [0.0; W]);
        let diagonal = (first + k) * columns + first + k;
        let (alpha, below) = (block.r[diagonal], products[0]);
        // Below this the column is zero beside its diagonal, and its square may not be told from zero. What is not a number
        // stays none.
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
        products = unsafe { subtract_reflection::<T, W, 1>(x, (scale, taken), rows) };
        x.rotate_left(1);
        products.rotate_left(1);
    }
    t
}

/// Scale the first column, take it out of the others, and return their inner products with column NEXT.
#[inline(always)]
unsafe fn subtract_reflection<T: Lane, const W: usize, const NEXT: usize>(
    x: [*mut f64; W],
    (scale, taken): (f64, [f64; W]),
    rows: usize,
) -> [f64; W] {
    let (scale, taken, mut sums) = (T::splat(scale), taken.map(T::splat), [T::splat(0.0); W]);
    let mut i = 0;
    while i < rows {
        let mut lanes: [T; W] = core::array::from_fn(|c| unsafe { T::load(x[c].add(i)) });
        lanes[0] = lanes[0].mul(scale);
        for c in 1..W {
            lanes[c] = lanes[0].fnma(taken[c], lanes[c]);
        }
        for (sum, &lane) in sums.iter_mut().zip(&lanes) {
            *sum = lanes[NEXT % W].fma(lane, *sum);
        }
        for (lane, x) in lanes.iter().zip(x) {
            unsafe { lane.store(x.add(i)) };
        }
        i += T::WIDTH;
    }
    sums.map(T::sum)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A few pseudo-random numbers in -1..1, the same on every machine.
    fn numbers(count: usize, seed: u64) -> Vec<f64> {
        let mut state = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1;
        let next = |_| {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            (state >> 11) as f64 / (1u64 << 52) as f64 - 1.0
        };
        (0..count).map(next).collect()
    }

    /// R'R equals A'A on every backend, for shapes around the panel and lane widths.
    #[test]
    fn the_triangle_keeps_the_inner_products() {
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

    /// A triangle merged into another is that of all the rows.
    #[test]
    fn merged_triangles_are_that_of_all_rows() {
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
