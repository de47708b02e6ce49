//! Symmetric matrices of some tens of columns, in lanes: extreme eigenvalues, powers and inverses.
//!
//! Columns are whole lanes with zeros after their last number, so that loops over lanes have no ends of their own; both
//! triangles are computed, which in lanes takes less time than half of each column would.

use crate::memory::aligned::Aligned;
use crate::simd::dispatch::dispatched;
use crate::simd::inlined;
use crate::simd::lane::{Lane, MAX_WIDTH};
use crate::simd::token::Simd;

/// Columns, and lanes of each, of a tile of a product: as many sums as stay in registers.
const ACROSS: usize = 4;
const LANES: usize = 3;
/// Zeros, then ones: from `MAX_WIDTH - k` on a lane whose first `k` numbers are zero.
static AFTER: [f64; 2 * MAX_WIDTH] = [0., 0., 0., 0., 0., 0., 0., 0., 1., 1., 1., 1., 1., 1., 1., 1.];

/// Length of a column, beside entries up to two, that changes no eigenvalue.
const NEGLIGIBLE: f64 = 1e-60;

/// A symmetric matrix, with at least one column of zeros after its last.
#[derive(Clone)]
pub(crate) struct Square {
    n: usize,
    stride: usize,
    numbers: Aligned,
}

impl Square {
    pub(crate) fn zeros(n: usize) -> Square {
        let stride = (n + 1).next_multiple_of(LANES * MAX_WIDTH);
        let mut numbers = Aligned::default();
        numbers.clear((n + 1).next_multiple_of(ACROSS) * stride);
        Square { n, stride, numbers }
    }

    /// From n x n numbers, each multiplied by a factor.
    pub(crate) fn of(matrix: &[f64], n: usize, factor: f64) -> Square {
        let mut made = Square::zeros(n);
        for (to, from) in made.numbers.chunks_exact_mut(made.stride).zip(matrix.chunks_exact(n.max(1))) {
            to.iter_mut().zip(from).for_each(|(to, from)| *to = from * factor);
        }
        made
    }

    pub(crate) fn diagonal(n: usize, entry: f64) -> Square {
        let mut made = Square::zeros(n);
        (0..n).for_each(|k| made.numbers[k * made.stride + k] = entry);
        made
    }

    pub(crate) fn size(&self) -> usize {
        self.n
    }

    /// The columns, without the zeros after them.
    pub(crate) fn columns(&self) -> impl Iterator<Item = &[f64]> {
        self.numbers.chunks_exact(self.stride).take(self.n).map(|column| &column[..self.n])
    }

    /// Sum of the products of all entries: the trace of the product.
    pub(crate) fn inner(&self, other: &Square) -> f64 {
        let (left, right) = (self.numbers.as_chunks::<MAX_WIDTH>().0, other.numbers.as_chunks::<MAX_WIDTH>().0);
        let mut sums = [0.0; MAX_WIDTH];
        for (left, right) in left.iter().zip(right) {
            sums.iter_mut().zip(left.iter().zip(right)).for_each(|(sum, (x, y))| *sum += x * y);
        }
        sums.iter().sum()
    }

    pub(crate) fn trace(&self) -> f64 {
        self.columns().enumerate().map(|(k, column)| column[k]).sum()
    }
}

dispatched! {
    /// The product of two matrices that commute, which is symmetric as they are. All three are of one size.
    pub(crate) fn multiply = multiply_in_lanes(left: &Square, right: &Square, out: &mut Square)
}

#[inline(always)]
fn multiply_in_lanes<T: Lane>(simd: Simd<T>, left: &Square, right: &Square, out: &mut Square) {
    assert!(left.n == out.n && right.n == out.n);
    let (n, stride) = (out.n, out.stride);
    let (x, y, to) = (left.numbers.as_ptr(), right.numbers.as_ptr(), out.numbers.as_mut_ptr());
    for j in (0..n).step_by(ACROSS) {
        for l in (0..n).step_by(LANES * T::WIDTH) {
            let mut sums = [[simd.splat(0.0); LANES]; ACROSS];
            for k in 0..n {
                // SAFETY: columns come in multiples of ACROSS, and each has multiples of LANES lanes; all are of one
                // size. Here and below.
                unsafe {
                    let left: [T; LANES] = inlined::from_fn(|e| simd.load(x.add(k * stride + l + e * T::WIDTH)));
                    for (c, sums) in sums.iter_mut().enumerate() {
                        let right = simd.splat(*y.add((j + c) * stride + k));
                        for (sum, left) in sums.iter_mut().zip(left) {
                            *sum = left.fma(right, *sum);
                        }
                    }
                }
            }
            for (c, sums) in sums.iter().enumerate() {
                for (e, sum) in sums.iter().enumerate() {
                    // SAFETY: as above.
                    unsafe { sum.store(to.add((j + c) * stride + l + e * T::WIDTH)) };
                }
            }
        }
    }
}

dispatched! {
    /// Replace a positive definite matrix by its inverse (Goodnight 1979, The American Statistician 33(3)); `definite`
    /// becomes false, and the matrix is lost, where a pivot is not positive.
    pub(crate) fn invert = invert_in_lanes(matrix: &mut Square, definite: &mut bool)
}

#[inline(always)]
fn invert_in_lanes<T: Lane>(simd: Simd<T>, matrix: &mut Square, definite: &mut bool) {
    let (n, stride) = (matrix.n, matrix.stride);
    let mut pivotal = Aligned::default();
    pivotal.clear(stride);
    for k in 0..n {
        pivotal.copy_from_slice(&matrix.numbers[k * stride..][..stride]);
        let pivot = pivotal[k];
        if pivot.is_nan() || pivot <= 0.0 {
            *definite = false;
            return;
        }
        let inverse = 1.0 / pivot;
        // The pivot's column is made of what is left of it.
        matrix.numbers[k * stride..][..stride].fill(0.0);
        let a = matrix.numbers.as_mut_ptr();
        for j in 0..n {
            let share = if j == k { -inverse } else { pivotal[j] * inverse };
            let along = simd.splat(share);
            for l in (0..n).step_by(T::WIDTH) {
                // SAFETY: columns are whole lanes, here and below.
                unsafe {
                    let (to, by) = (a.add(j * stride + l), simd.load(pivotal.as_ptr().add(l)));
                    by.fnma(along, simd.load(to)).store(to);
                }
            }
            // SAFETY: as above.
            unsafe { *a.add(j * stride + k) = share };
        }
    }
    matrix.numbers.iter_mut().for_each(|x| *x = -*x);
}

dispatched! {
    /// Reduce a matrix to tridiagonal form by reflections (Golub and Van Loan 2013, algorithm 8.3.1): its diagonal, and
    /// the entries beside it. Entries of the matrix are at most two; it is lost.
    pub(crate) fn tridiagonal = tridiagonal_in_lanes(matrix: &mut Square, diagonal: &mut [f64], beside: &mut [f64])
}

#[inline(always)]
fn tridiagonal_in_lanes<T: Lane>(simd: Simd<T>, matrix: &mut Square, diagonal: &mut [f64], beside: &mut [f64]) {
    let (n, stride, a) = (matrix.n, matrix.stride, matrix.numbers.as_mut_ptr());
    // The last reflection's vector v and w, by which every column c still has to lose v w(c) + w v(c); the next one's
    // vector, and the products of the matrix with it. Numbers before the part that is left are of no consequence.
    let mut four: [Aligned; 4] = Default::default();
    four.iter_mut().for_each(|vector| vector.clear(stride));
    let [mut v, mut w, mut next, mut products] = four;
    for k in 0..n {
        let first = k - k % T::WIDTH;
        let (vk, wk) = (simd.splat(v[k]), simd.splat(w[k]));
        let mut square = simd.splat(0.0);
        for l in (first..n).step_by(T::WIDTH) {
            // SAFETY: columns and vectors are whole lanes, here and below; a lane of `AFTER` begins at most at its middle.
            unsafe {
                let (v, w) = (simd.load(v.as_ptr().add(l)), simd.load(w.as_ptr().add(l)));
                let entry = v.fnma(wk, w.fnma(vk, simd.load(a.add(k * stride + l))));
                entry.store(a.add(k * stride + l));
                let below =
                    entry.mul(simd.load(AFTER.as_ptr().add(MAX_WIDTH - (k + 1).saturating_sub(l).min(T::WIDTH))));
                below.store(next.as_mut_ptr().add(l));
                square = below.fma(below, square);
            }
        }
        // SAFETY: as above.
        diagonal[k] = unsafe { *a.add(k * stride + k) };
        if k + 1 == n {
            break;
        }
        let (length, head) = (square.sum().sqrt(), next[k + 1]);
        beside[k] = -length.copysign(head);
        next[k + 1] = head - beside[k];
        // What is left of shorter columns is rounding, and would overflow in squares of the weight.
        let weight = if length > NEGLIGIBLE { 1.0 / (length * (length + head.abs())) } else { 0.0 };
        products.fill(0.0);
        for j in (k + 1..n).step_by(2) {
            // SAFETY: as above; after the last column and number of a vector there is one of zeros.
            unsafe {
                let pair = |x: &[f64]| [simd.splat(x[j]), simd.splat(x[j + 1])];
                let (vs, ws, shares) = (pair(&v), pair(&w), pair(&next));
                for l in (first..n).step_by(T::WIDTH) {
                    let (v, w) = (simd.load(v.as_ptr().add(l)), simd.load(w.as_ptr().add(l)));
                    let mut product = simd.load(products.as_ptr().add(l));
                    for e in 0..2 {
                        let at = a.add((j + e) * stride + l);
                        let entry = v.fnma(ws[e], w.fnma(vs[e], simd.load(at)));
                        entry.store(at);
                        product = entry.fma(shares[e], product);
                    }
                    product.store(products.as_mut_ptr().add(l));
                }
            }
        }
        let mut along = simd.splat(0.0);
        for l in (first..n).step_by(T::WIDTH) {
            // SAFETY: as above.
            along = unsafe { simd.load(products.as_ptr().add(l)).fma(simd.load(next.as_ptr().add(l)), along) };
        }
        let along = simd.splat(-0.5 * weight * weight * along.sum());
        for l in (first..n).step_by(T::WIDTH) {
            // SAFETY: as above.
            unsafe {
                let scaled = simd.load(products.as_ptr().add(l)).mul(simd.splat(weight));
                simd.load(next.as_ptr().add(l)).fma(along, scaled).store(w.as_mut_ptr().add(l));
            }
        }
        core::mem::swap(&mut v, &mut next);
    }
}
