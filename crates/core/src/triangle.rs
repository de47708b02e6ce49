//! A small upper triangle that takes up blocks of rows: Householder QR of [R; A], panels of four columns.
//!
//! Never the normal equations: they lose one to three digits at the condition numbers of this field.
//!
//! Safety: [`fold`] checks that R and A are as large as their shape says, with rows padded to whole lanes. Every unsafe
//! function below takes columns of that A by pointer, and reads and writes whole lanes inside their `stride`.

use crate::dispatch::{Backend, dispatched};
use crate::lane::Lane;

const PANEL: usize = 4;

/// Fold `rows` rows into the triangle: R becomes the triangle of [R; A]. A is overwritten.
///
/// `r` is `columns` x `columns`, column-major, upper. Column c of A is at `a[c * stride..]`; its numbers from `rows`
/// to the next whole lane must be zero.
///
/// # Panics
/// When a slice is shorter than its shape says.
pub(crate) fn fold(backend: Backend, r: &mut [f64], columns: usize, a: &mut [f64], rows: usize, stride: usize) {
    let padded = rows.next_multiple_of(crate::lane::MAX_WIDTH);
    assert!(r.len() >= columns * columns && padded <= stride && a.len() >= columns * stride);
    if rows > 0 {
        // SAFETY: checked above: R and A are as large as the kernel takes them to be.
        unsafe { fold_raw(backend, r, columns, a.as_mut_ptr(), padded, stride) }
    }
}

dispatched! {
    unsafe fn fold_raw = fold_in_lanes(r: &mut [f64], columns: usize, a: *mut f64, rows: usize, stride: usize)
}

/// Inner product of two columns.
#[inline(always)]
unsafe fn product<T: Lane>(x: *const f64, y: *const f64, rows: usize) -> f64 {
    let mut sum = T::splat(0.0);
    let mut i = 0;
    while i < rows {
        sum = unsafe { T::load(x.add(i)).fma(T::load(y.add(i)), sum) };
        i += T::WIDTH;
    }
    sum.sum()
}

/// The reflectors of one panel: v_k is column `first + k` of A below a unit in row k of R, and T is the upper
/// triangle of the compact form I - V T V'.
struct Panel {
    first: usize,
    width: usize,
    t: [[f64; PANEL]; PANEL],
}

#[inline(always)]
unsafe fn fold_in_lanes<T: Lane>(r: &mut [f64], columns: usize, a: *mut f64, rows: usize, stride: usize) {
    let mut first = 0;
    while first < columns {
        let width = PANEL.min(columns - first);
        // SAFETY: columns first..first + width of A exist, and so do the later ones.
        unsafe {
            let panel = factor::<T>(r, columns, a, rows, stride, first, width);
            if width == PANEL {
                update::<T>(&panel, r, columns, a, rows, stride);
            }
        }
        first += width;
    }
}

#[inline(always)]
unsafe fn factor<T: Lane>(
    r: &mut [f64],
    columns: usize,
    a: *mut f64,
    rows: usize,
    stride: usize,
    first: usize,
    width: usize,
) -> Panel {
    let mut t = [[0.0; PANEL]; PANEL];
    for k in 0..width {
        let v = unsafe { a.add((first + k) * stride) };
        let below = unsafe { product::<T>(v, v, rows) };
        let diagonal = (first + k) * columns + first + k;
        let alpha = r[diagonal];
        // Below this the column is zero beside its diagonal, and its square may not be told from zero.
        if below < f64::MIN_POSITIVE {
            unsafe { scale::<T>(v, rows, 0.0) };
            continue;
        }
        let beta = -(alpha * alpha + below).sqrt().copysign(alpha);
        let tau = (beta - alpha) / beta;
        r[diagonal] = beta;
        unsafe { scale::<T>(v, rows, 1.0 / (alpha - beta)) };
        for c in k + 1..width {
            let x = unsafe { a.add((first + c) * stride) };
            let above = (first + c) * columns + first + k;
            let s = tau * (r[above] + unsafe { product::<T>(v, x, rows) });
            r[above] -= s;
            unsafe { subtract::<T>(x, v, s, rows) };
        }
        t[k][k] = tau;
        let inner: [f64; PANEL] = core::array::from_fn(|j| match j < k {
            true => unsafe { product::<T>(v, a.add((first + j) * stride), rows) },
            false => 0.0,
        });
        for (j, row) in t.iter_mut().enumerate().take(k) {
            row[k] = -tau * (j..k).map(|l| row[l] * inner[l]).sum::<f64>();
        }
    }
    Panel { first, width, t }
}

#[inline(always)]
unsafe fn scale<T: Lane>(x: *mut f64, rows: usize, by: f64) {
    let by = T::splat(by);
    let mut i = 0;
    while i < rows {
        unsafe { T::load(x.add(i)).mul(by).store(x.add(i)) };
        i += T::WIDTH;
    }
}

/// x -= s v
#[inline(always)]
unsafe fn subtract<T: Lane>(x: *mut f64, v: *const f64, s: f64, rows: usize) {
    let s = T::splat(s);
    let mut i = 0;
    while i < rows {
        unsafe { T::load(v.add(i)).fnma(s, T::load(x.add(i))).store(x.add(i)) };
        i += T::WIDTH;
    }
}

/// Apply the panel's reflectors to the columns after it, four at a time.
#[inline(always)]
unsafe fn update<T: Lane>(panel: &Panel, r: &mut [f64], columns: usize, a: *mut f64, rows: usize, stride: usize) {
    let mut c = panel.first + panel.width;
    while c + PANEL <= columns {
        unsafe { update_some::<T, PANEL>(panel, r, columns, a, rows, stride, c) };
        c += PANEL;
    }
    while c < columns {
        unsafe { update_some::<T, 1>(panel, r, columns, a, rows, stride, c) };
        c += 1;
    }
}

#[inline(always)]
unsafe fn update_some<T: Lane, const N: usize>(
    panel: &Panel,
    r: &mut [f64],
    columns: usize,
    a: *mut f64,
    rows: usize,
    stride: usize,
    c: usize,
) {
    let v: [*const f64; PANEL] = core::array::from_fn(|k| unsafe { a.add((panel.first + k) * stride).cast_const() });
    let x: [*mut f64; N] = core::array::from_fn(|j| unsafe { a.add((c + j) * stride) });
    let mut sums = [[T::splat(0.0); N]; PANEL];
    let mut i = 0;
    while i < rows {
        let lanes: [T; N] = core::array::from_fn(|j| unsafe { T::load(x[j].add(i)) });
        for (sums, v) in sums.iter_mut().zip(v) {
            let v = unsafe { T::load(v.add(i)) };
            for (sum, &x) in sums.iter_mut().zip(&lanes) {
                *sum = v.fma(x, *sum);
            }
        }
        i += T::WIDTH;
    }
    let mut weights = [[T::splat(0.0); N]; PANEL];
    for j in 0..N {
        let head = &mut r[(c + j) * columns + panel.first..][..PANEL];
        let s: [f64; PANEL] = core::array::from_fn(|k| sums[k][j].sum() + head[k]);
        for k in 0..PANEL {
            let weight: f64 = (0..=k).map(|l| panel.t[l][k] * s[l]).sum();
            weights[k][j] = T::splat(weight);
            head[k] -= weight;
        }
    }
    let mut i = 0;
    while i < rows {
        let v: [T; PANEL] = core::array::from_fn(|k| unsafe { T::load(v[k].add(i)) });
        for j in 0..N {
            let mut lane = unsafe { T::load(x[j].add(i)) };
            for k in 0..PANEL {
                lane = v[k].fnma(weights[k][j], lane);
            }
            unsafe { lane.store(x[j].add(i)) };
        }
        i += T::WIDTH;
    }
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
                    fold(backend, &mut r, columns, &mut a, rows, stride);
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
}
