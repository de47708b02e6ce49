//! Singular values of a Jacobian J and of `J L^-T` with `A = L L'` (A the mass matrix), at every pose of a batch, by
//! one-sided Jacobi rotations of triangles.
//!
//! With as many coordinates as rows or more, the rows of J and of `J L^-T` are first made orthogonal one after another
//! (modified Gram-Schmidt; Golub and Van Loan 2013, section 5.2.8): what is rotated are short vectors, whose directions
//! are the masses' own. No squared matrix is decomposed.
//!
//! Safety: unsafe functions take a `k` that is one of [`groups`], or a lane's.

use crate::memory::slot::{GROUP, Slot, groups};
use crate::simd::lane::Lane;
use crate::simd::token::Simd;

/// Maximum number of Jacobi sweeps; four are usual.
const MAX_SWEEPS: usize = 30;
/// Vectors are orthogonal if the cosine of their angle is below this.
const ORTHOGONALITY: f64 = 1e-15;
/// A pivot that cancellation has reduced to this share of the diagonal is not known to be positive.
const LEAST_PIVOT: f64 = 1e-14;

/// Decomposition at each pose, of m rows and n coordinates: r = min(m, n) masses in descending order.
#[derive(Default)]
pub(crate) struct JacobiSvd {
    m: usize,
    n: usize,
    /// Cholesky factor of A, its lower triangle row by row; the diagonal has reciprocals.
    factor: Vec<Slot>,
    /// `J L^-T`, m rows of length n.
    pub(crate) rows: Vec<Slot>,
    /// Vectors that are made orthogonal, m of length n.
    plain: Vec<Slot>,
    weighted: Vec<Slot>,
    /// Vectors that are rotated, r of length m.
    short: [Vec<Slot>; 2],
    /// Condition number of J: its largest singular value by its smallest; infinite where the rank is deficient.
    pub(crate) condition: Slot,
    /// One where A is positive definite, else zero.
    definite: Slot,
    /// Apparent masses 1 / s^2, r; NaN where they are not known.
    pub(crate) masses: Vec<Slot>,
    /// Unit directions of the masses, r x m, the largest component of each positive.
    pub(crate) directions: Vec<Slot>,
}

impl JacobiSvd {
    pub(crate) fn new(m: usize, n: usize) -> JacobiSvd {
        let (r, zeros) = (m.min(n), |len| vec![Slot::ZERO; len]);
        JacobiSvd {
            m,
            n,
            factor: zeros(n * (n + 1) / 2),
            rows: zeros(m * n),
            plain: zeros(m * n),
            weighted: zeros(m * n),
            short: [zeros(r * m), zeros(r * m)],
            condition: Slot::ZERO,
            definite: Slot::ZERO,
            masses: zeros(r),
            directions: zeros(r * m),
        }
    }

    /// Condition numbers, masses and directions at the first `samples` poses; `jacobian(row, a)` and `mass(a, b)` for `b
    /// <= a` are entries. Masses are unknown where the condition number exceeds its limit.
    #[inline(always)]
    pub(crate) fn solve<'s, T: Lane>(
        &mut self,
        simd: Simd<T>,
        samples: usize,
        jacobian: impl Fn(usize, usize) -> &'s Slot,
        mass: impl Fn(usize, usize) -> &'s Slot,
        max_condition: f64,
    ) {
        for k in groups(simd, samples) {
            // SAFETY: k is one of the groups, of which all functions here make use.
            unsafe {
                self.decompose(simd, k, &mass);
                self.solve_rows(simd, k, &jacobian);
                self.shorten(simd, k);
                match self.m {
                    0..=3 => self.rotate::<T, 3>(simd, k, max_condition),
                    _ => self.rotate::<T, 6>(simd, k, max_condition),
                }
            }
        }
    }

    /// Cholesky decomposition A = L L', and where A is positive definite.
    #[inline(always)]
    unsafe fn decompose<'s, T: Lane>(&mut self, simd: Simd<T>, k: usize, mass: impl Fn(usize, usize) -> &'s Slot) {
        let mut definite = [simd.splat(1.0); GROUP];
        for a in 0..self.n {
            let (above, row) = self.factor.split_at_mut(a * (a + 1) / 2);
            // SAFETY: the caller's promise about k, here and below.
            unsafe {
                for b in 0..a {
                    let (mut rest, other) = (mass(a, b).load_group(simd, k), &above[b * (b + 1) / 2..][..=b]);
                    for (known, other) in row[..b].iter().zip(other) {
                        rest = fnma(known.load_group(simd, k), other.load_group(simd, k), rest);
                    }
                    let pivot = other[b].load_group(simd, k);
                    row[b].store_group(k, mul(rest, pivot));
                }
                let entry = mass(a, a).load_group(simd, k);
                let mut rest = entry;
                for known in &row[..a] {
                    let known = known.load_group(simd, k);
                    rest = fnma(known, known, rest);
                }
                for (g, definite) in definite.iter_mut().enumerate() {
                    let least = entry[g].xor_sign(entry[g]).mul(simd.splat(LEAST_PIVOT));
                    *definite = T::select_gt(rest[g], least, *definite, simd.splat(0.0));
                    rest[g] = rest[g].inverse_sqrt();
                }
                row[a].store_group(k, rest);
            }
        }
        // SAFETY: as above.
        unsafe { self.definite.store_group(k, definite) };
    }

    /// `J L^-T`, and copies of it and of J that will be made orthogonal.
    #[inline(always)]
    unsafe fn solve_rows<'s, T: Lane>(&mut self, simd: Simd<T>, k: usize, jacobian: impl Fn(usize, usize) -> &'s Slot) {
        for a in 0..self.n {
            let factor = &self.factor[a * (a + 1) / 2..][..=a];
            for row in 0..self.m {
                let (known, made) = self.rows[row * self.n..].split_at_mut(a);
                // SAFETY: the caller's promise about k.
                unsafe {
                    let entry = jacobian(row, a).load_group(simd, k);
                    let mut rest = entry;
                    for (known, factor) in known.iter().zip(factor) {
                        rest = fnma(factor.load_group(simd, k), known.load_group(simd, k), rest);
                    }
                    let pivot = factor[a].load_group(simd, k);
                    let solved = mul(rest, pivot);
                    made[0].store_group(k, solved);
                    self.plain[row * self.n + a].store_group(k, entry);
                    self.weighted[row * self.n + a].store_group(k, solved);
                }
            }
        }
    }

    /// The vectors that are rotated: columns of both matrices, or the rows of the triangle that is left of their rows.
    #[inline(always)]
    unsafe fn shorten<T: Lane>(&mut self, simd: Simd<T>, k: usize) {
        let (m, n, none) = (self.m, self.n, simd.splat(0.0));
        for (long, short) in [&mut self.plain, &mut self.weighted].into_iter().zip(&mut self.short) {
            if m > n {
                for (at, to) in short.iter_mut().enumerate() {
                    // SAFETY: the caller's promise about k, here and below.
                    unsafe { to.store_group(k, long[at % m * n + at / m].load_group(simd, k)) };
                }
                continue;
            }
            for e in 0..m {
                let (head, others) = long[e * n..].split_at_mut(n);
                // SAFETY: as above.
                unsafe {
                    let square = dot(simd, head, head, k);
                    let mut inverse = square;
                    for inverse in &mut inverse {
                        *inverse = T::select_gt(*inverse, none, inverse.inverse_sqrt(), none);
                    }
                    short[e * m + e].store_group(k, mul(square, inverse));
                    for (f, other) in (e + 1..m).zip(others.chunks_exact_mut(n)) {
                        let mut share = mul(dot(simd, head, other, k), inverse);
                        short[e * m + f].store_group(k, share);
                        share = mul(share, inverse);
                        for (x, y) in head.iter().zip(other) {
                            y.store_group(k, fnma(x.load_group(simd, k), share, y.load_group(simd, k)));
                        }
                    }
                }
            }
        }
    }

    /// Rotate the short vectors of both matrices until they are orthogonal.
    #[inline(always)]
    unsafe fn rotate<T: Lane, const K: usize>(&mut self, simd: Simd<T>, k: usize, max_condition: f64) {
        let (m, r) = (self.m, self.m.min(self.n));
        for (place, short) in self.short.iter().enumerate() {
            let mut sets = [[[simd.splat(0.0); K]; K]; GROUP];
            for (e, vector) in short.chunks_exact(m).enumerate() {
                for (i, x) in vector.iter().enumerate() {
                    // SAFETY: the caller's promise about k, here and below.
                    let x = unsafe { x.load_group(simd, k) };
                    sets.iter_mut().zip(x).for_each(|(set, x)| set[e][i] = x);
                }
            }
            let mut turned = [true; GROUP];
            for _ in 0..MAX_SWEEPS {
                turned = sweep(simd, &mut sets, turned, r);
                if turned == [false; GROUP] {
                    break;
                }
            }
            for (g, vectors) in sets.iter_mut().enumerate() {
                let k = k + g * T::WIDTH;
                // SAFETY: as above.
                unsafe {
                    match place {
                        0 => self.condition.store(k, extent(simd, &vectors[..r])),
                        _ => {
                            let (condition, definite) = (self.condition.load(simd, k), self.definite.load(simd, k));
                            let known = T::select_gt(condition, simd.splat(max_condition), simd.splat(0.0), definite);
                            let squares = sort(simd, vectors, r);
                            put((vectors, squares), known, (&mut self.masses, &mut self.directions), (m, k));
                        }
                    }
                }
            }
        }
    }

    /// Rates of the n coordinates that move the end effector at unit speed along the direction of mass `e`: m A^-1 J' v
    /// = m L^-T (L^-1 J') v; zero where the mass is not known.
    ///
    /// # Safety
    ///
    /// As in the head of the file.
    #[inline(always)]
    pub(crate) unsafe fn unit_speed_rates<T: Lane>(&self, simd: Simd<T>, e: usize, k: usize, rates: &mut [Slot]) {
        let (m, n, none) = (self.m, self.n, simd.splat(0.0));
        // SAFETY: the caller's promise about k.
        unsafe {
            let mass = self.masses[e].load(simd, k);
            for a in (0..n).rev() {
                let mut along = none;
                for row in 0..m {
                    let share = self.directions[e * m + row].load(simd, k);
                    along = self.rows[row * n + a].load(simd, k).fma(share, along);
                }
                let mut rest = mass.mul(along);
                for (b, known) in rates.iter().enumerate().skip(a + 1) {
                    rest = self.factor[b * (b + 1) / 2 + a].load(simd, k).fnma(known.load(simd, k), rest);
                }
                let rate = rest.mul(self.factor[a * (a + 1) / 2 + a].load(simd, k));
                rates[a].store(k, T::select_gt(mass, none, rate, none));
            }
        }
    }
}

/// `a b`
#[inline(always)]
fn mul<T: Lane>(mut a: [T; GROUP], b: [T; GROUP]) -> [T; GROUP] {
    for (a, b) in a.iter_mut().zip(b) {
        *a = a.mul(b);
    }
    a
}

/// `c - a b`
#[inline(always)]
fn fnma<T: Lane>(a: [T; GROUP], b: [T; GROUP], mut c: [T; GROUP]) -> [T; GROUP] {
    for (g, c) in c.iter_mut().enumerate() {
        *c = a[g].fnma(b[g], *c);
    }
    c
}

/// Inner product.
#[inline(always)]
unsafe fn dot<T: Lane>(simd: Simd<T>, left: &[Slot], right: &[Slot], k: usize) -> [T; GROUP] {
    let mut sum = [simd.splat(0.0); GROUP];
    for (x, y) in left.iter().zip(right) {
        // SAFETY: the caller's promise about k.
        let (x, y) = unsafe { (x.load_group(simd, k), y.load_group(simd, k)) };
        for (g, sum) in sum.iter_mut().enumerate() {
            *sum = x[g].fma(y[g], *sum);
        }
    }
    sum
}

/// Order the first `r` vectors by length, the shortest first; their squared lengths.
#[inline(always)]
fn sort<T: Lane, const K: usize>(simd: Simd<T>, vectors: &mut [[T; K]; K], r: usize) -> [T; K] {
    let mut squares = [simd.splat(0.0); K];
    for (own, vector) in squares.iter_mut().zip(vectors.iter()) {
        *own = square(simd, vector);
    }
    for e in 0..r {
        for f in e + 1..r {
            let (a, b) = (squares[e], squares[f]);
            (squares[e], squares[f]) = (T::select_gt(a, b, b, a), T::select_gt(a, b, a, b));
            let (head, tail) = vectors.split_at_mut(f);
            for (x, y) in head[e].iter_mut().zip(&mut tail[0]) {
                (*x, *y) = (T::select_gt(a, b, *y, *x), T::select_gt(a, b, *x, *y));
            }
        }
    }
    squares
}

/// Store the masses of orthogonal vectors, of m components, and their directions, where `known` is above zero.
#[inline(always)]
unsafe fn put<T: Lane, const K: usize>(
    (vectors, squares): (&[[T; K]; K], [T; K]),
    known: T,
    (masses, directions): (&mut [Slot], &mut [Slot]),
    (m, k): (usize, usize),
) {
    let s = |x: f64| Simd::of(known).splat(x);
    for (e, (mass, direction)) in masses.iter_mut().zip(directions.chunks_exact_mut(m)).enumerate() {
        let mut largest = vectors[e][0];
        for &x in &vectors[e][1..] {
            largest = T::select_gt(x.xor_sign(x), largest.xor_sign(largest), x, largest);
        }
        let square = T::select_gt(known, s(0.0), squares[e], s(f64::NAN));
        // SAFETY: the caller promises room for a lane from k on, here and below.
        unsafe { mass.store(k, s(1.0).div(square)) };
        let inverse = square.inverse_sqrt().xor_sign(largest);
        for (to, &x) in direction.iter_mut().zip(&vectors[e]) {
            // SAFETY: as above.
            unsafe { to.store(k, x.mul(inverse)) };
        }
    }
}

/// One sweep over all pairs of the first `r` vectors of the sets that still turn (Hestenes 1958); which have turned.
#[inline(always)]
fn sweep<T: Lane, const K: usize>(
    simd: Simd<T>,
    sets: &mut [[[T; K]; K]; GROUP],
    active: [bool; GROUP],
    r: usize,
) -> [bool; GROUP] {
    let mut turned = [false; GROUP];
    for e in 0..K {
        for f in e + 1..K {
            if f >= r {
                continue;
            }
            for s in 0..GROUP {
                if active[s] {
                    let (head, tail) = sets[s].split_at_mut(f);
                    turned[s] |= rotate_pair(simd, &mut head[e], &mut tail[0]);
                }
            }
        }
    }
    turned
}

/// Rotate two vectors in their plane until they are nearly orthogonal; false where they are so at every pose already.
#[inline(always)]
fn rotate_pair<T: Lane, const K: usize>(simd: Simd<T>, p: &mut [T; K], q: &mut [T; K]) -> bool {
    let s = |x: f64| simd.splat(x);
    let (mut pp, mut qq, mut pq) = (p[0].mul(p[0]), q[0].mul(q[0]), p[0].mul(q[0]));
    for i in 1..K {
        (pp, qq, pq) = (p[i].fma(p[i], pp), q[i].fma(q[i], qq), p[i].fma(q[i], pq));
    }
    let (square, bound) = (pq.mul(pq), pp.mul(qq).mul(s(ORTHOGONALITY * ORTHOGONALITY)));
    // The comparison is false for NaN, which no rotation mends.
    if !T::any_gt(square, bound) {
        return false;
    }
    // A rotation by theta, tan 2 theta = b / a, makes them orthogonal. Half of it has a rational tangent here, exact for
    // small angles up to the square and within 4 per cent of any other: the next sweep mends it. Cosine and sine belong
    // to each other whatever the angle, and take one quotient (the idea is McAdams' et al. 2011, TR1690, section 2).
    let (gap, twice) = (qq.sub(pp), pq.add(pq));
    let (a, b) = (gap.xor_sign(gap), twice.xor_sign(twice));
    let up = b.mul(b.fma(s(0.7405), a));
    let along = a.mul(a.fma(s(4.0), b.mul(s(2.962)))).add(b.mul(b).mul(s(1.788)));
    let (uu, inverse) = (up.mul(up), s(1.0).div(up.fma(up, along.mul(along))));
    let cosine = along.fma(along, uu.neg()).mul(inverse);
    let sine = along.add(along).mul(up).mul(inverse).xor_sign(twice).xor_sign(gap);
    let c = T::select_gt(square, bound, cosine, s(1.0));
    let s = T::select_gt(square, bound, sine, s(0.0));
    for (p, q) in p.iter_mut().zip(q) {
        (*p, *q) = (s.fnma(*q, c.mul(*p)), s.fma(*p, c.mul(*q)));
    }
    true
}

/// Squared norm of a vector.
#[inline(always)]
fn square<T: Lane, const K: usize>(simd: Simd<T>, vector: &[T; K]) -> T {
    let mut sum = simd.splat(0.0);
    for x in vector {
        sum = x.fma(*x, sum);
    }
    sum
}

/// Largest norm by smallest, infinite where one is zero or not a number.
#[inline(always)]
fn extent<T: Lane, const K: usize>(simd: Simd<T>, vectors: &[[T; K]]) -> T {
    let (mut low, mut high, mut sum) = (simd.splat(f64::INFINITY), simd.splat(0.0), simd.splat(0.0));
    for vector in vectors {
        let square = square(simd, vector);
        sum = sum.add(square);
        low = T::select_gt(low, square, square, low);
        high = T::select_gt(square, high, square, high);
    }
    let known = T::select_gt(low, simd.splat(0.0), high.div(low).sqrt(), simd.splat(f64::INFINITY));
    T::select_gt(sum, simd.splat(0.0), known, simd.splat(f64::INFINITY))
}
