//! Three-vectors of lanes.

use crate::simd::inlined;
use crate::simd::lane::Lane;
use crate::simd::token::Simd;

/// A three-vector.
pub(crate) type Vector<T> = [T; 3];

/// Index i and the two after it, cyclically.
#[inline(always)]
pub(crate) fn cycle(i: usize) -> [usize; 3] {
    [i, (i + 1) % 3, (i + 2) % 3]
}

/// The zero vector.
#[inline(always)]
pub(crate) fn zero<T: Lane>(simd: Simd<T>) -> Vector<T> {
    [simd.splat(0.0); 3]
}

/// Inner product.
#[inline(always)]
pub(crate) fn dot<T: Lane>(a: Vector<T>, b: Vector<T>) -> T {
    a[2].fma(b[2], a[1].fma(b[1], a[0].mul(b[0])))
}

/// Cross product `a x b`.
#[inline(always)]
pub(crate) fn cross<T: Lane>(a: Vector<T>, b: Vector<T>) -> Vector<T> {
    [a[2].fnma(b[1], a[1].mul(b[2])), a[0].fnma(b[2], a[2].mul(b[0])), a[1].fnma(b[0], a[0].mul(b[1]))]
}

/// `a + b`
#[inline(always)]
pub(crate) fn add<T: Lane>(a: Vector<T>, b: Vector<T>) -> Vector<T> {
    inlined::from_fn(|e| a[e].add(b[e]))
}

/// `s a + c`
#[inline(always)]
pub(crate) fn scale_add<T: Lane>(a: Vector<T>, s: T, c: Vector<T>) -> Vector<T> {
    inlined::from_fn(|e| a[e].fma(s, c[e]))
}

/// `c + a x b`
#[inline(always)]
pub(crate) fn cross_add<T: Lane>(a: Vector<T>, b: Vector<T>, c: Vector<T>) -> Vector<T> {
    [
        a[2].fnma(b[1], a[1].fma(b[2], c[0])),
        a[0].fnma(b[2], a[2].fma(b[0], c[1])),
        a[1].fnma(b[0], a[0].fma(b[1], c[2])),
    ]
}
