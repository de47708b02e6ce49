//! Singular values and vectors of `J L^-T` with `A = L L'` (J the Jacobian, A the mass matrix of a pose), by one-sided
//! Jacobi rotations, for a group of poses together.
//!
//! Safety: pose slots have [`crate::memory::slot::POSES`] numbers; unsafe functions take a `k` with
//! `k + T::WIDTH <= POSES`.

use crate::memory::slot::{PoseSlot, pose_lanes};
use crate::simd::lane::Lane;
use crate::simd::token::Simd;

/// Maximum number of Jacobi sweeps; five are usual.
const MAX_SWEEPS: usize = 30;
/// Vectors are orthogonal if the cosine of their angle is below this.
const ORTHOGONALITY: f64 = 1e-15;
/// A pivot that cancellation has reduced to this share of the diagonal is not known to be positive.
const LEAST_PIVOT: f64 = 1e-14;

/// Decomposition at each pose, of m rows and n coordinates: r = min(m, n) singular triplets, in no order.
pub(crate) struct JacobiSvd {
    m: usize,
    n: usize,
    /// Cholesky factor of A below the diagonal, n x n; the diagonal has reciprocals.
    factor: Vec<PoseSlot>,
    /// L^-1 J': m vectors of length n.
    columns: Vec<PoseSlot>,
    /// Rows or columns of J, and of `J L^-T`, whichever are fewer.
    plain: Vectors,
    weighted: Vectors,
    /// Condition number of J: its largest singular value by its smallest; infinite where the rank is deficient.
    pub(crate) condition: PoseSlot,
    /// One where A is positive definite, else zero.
    pub(crate) definite: PoseSlot,
    /// Apparent masses 1 / s^2, r.
    pub(crate) masses: Vec<PoseSlot>,
    /// Unit directions of the masses, r x m.
    pub(crate) directions: Vec<PoseSlot>,
    /// Coordinate rates that move the end effector at unit speed along each direction, r x n.
    pub(crate) rates: Vec<PoseSlot>,
}

impl JacobiSvd {
    pub(crate) fn new(m: usize, n: usize) -> JacobiSvd {
        let (r, zeros) = (m.min(n), |len| vec![PoseSlot::ZERO; len]);
        JacobiSvd {
            m,
            n,
            factor: zeros(n * n),
            columns: zeros(m * n),
            plain: Vectors::new(r, m.max(n)),
            weighted: Vectors::new(r, m.max(n)),
            condition: PoseSlot::ZERO,
            definite: PoseSlot::ZERO,
            masses: zeros(r),
            directions: zeros(r * m),
            rates: zeros(r * n),
        }
    }

    fn triplets(&self) -> usize {
        self.m.min(self.n)
    }

    /// Determine condition number, masses and directions; `jacobian(row, a)` and `mass(a, b)` for `b <= a` are entries.
    #[inline(always)]
    pub(crate) fn solve<'s, T: Lane>(
        &mut self,
        simd: Simd<T>,
        jacobian: impl Fn(usize, usize) -> &'s PoseSlot,
        mass: impl Fn(usize, usize) -> &'s PoseSlot,
    ) {
        let (m, n) = (self.m, self.n);
        self.decompose(simd, mass);
        for row in 0..m {
            for a in 0..n {
                let (entries, at) = (jacobian(row, a), if m <= n { row * n + a } else { a * m + row });
                for k in pose_lanes(simd) {
                    // SAFETY: `pose_lanes` leaves room for a lane, here and below.
                    unsafe {
                        let entry = entries.load(simd, k);
                        let mut rest = entry;
                        for b in 0..a {
                            let known = self.columns[row * n + b].load(simd, k);
                            rest = self.factor[a * n + b].load(simd, k).fnma(known, rest);
                        }
                        let made = rest.mul(self.factor[a * n + a].load(simd, k));
                        self.columns[row * n + a].store(k, made);
                        self.plain.entries[at].store(k, entry);
                        self.weighted.entries[at].store(k, made);
                    }
                }
            }
        }
        self.weighted.begin_rotations();
        let (mut plain, mut weighted) = (true, true);
        for _ in 0..MAX_SWEEPS {
            (plain, weighted) = self.sweep(simd, plain, weighted);
            if !plain && !weighted {
                break;
            }
        }
        for k in pose_lanes(simd) {
            // SAFETY: as above.
            unsafe {
                let condition = self.plain.extent(simd, k);
                self.condition.store(k, condition);
                self.triplets_of_vectors(simd, k);
            }
        }
    }

    /// Coordinate rates for each direction v: m A^-1 J' v = m L^-T (L^-1 J') v.
    #[inline(always)]
    pub(crate) unsafe fn unit_speed_rates<T: Lane>(&mut self, simd: Simd<T>, k: usize) {
        let (m, n) = (self.m, self.n);
        for e in 0..self.triplets() {
            for a in (0..n).rev() {
                // SAFETY: the caller's promise about k.
                unsafe {
                    let mut along = simd.splat(0.0);
                    for row in 0..m {
                        let share = self.directions[e * m + row].load(simd, k);
                        along = self.columns[row * n + a].load(simd, k).fma(share, along);
                    }
                    let mut rest = self.masses[e].load(simd, k).mul(along);
                    for b in a + 1..n {
                        let known = self.rates[e * n + b].load(simd, k);
                        rest = self.factor[b * n + a].load(simd, k).fnma(known, rest);
                    }
                    self.rates[e * n + a].store(k, rest.mul(self.factor[a * n + a].load(simd, k)));
                }
            }
        }
    }

    /// Cholesky decomposition A = L L', and where A is positive definite.
    #[inline(always)]
    fn decompose<'s, T: Lane>(&mut self, simd: Simd<T>, mass: impl Fn(usize, usize) -> &'s PoseSlot) {
        let n = self.n;
        self.definite.0.fill(1.0);
        for a in 0..n {
            for b in 0..=a {
                let entries = mass(a, b);
                for k in pose_lanes(simd) {
                    // SAFETY: `pose_lanes` leaves room for a lane.
                    unsafe {
                        let entry = entries.load(simd, k);
                        let mut rest = entry;
                        for c in 0..b {
                            let other = self.factor[b * n + c].load(simd, k);
                            rest = self.factor[a * n + c].load(simd, k).fnma(other, rest);
                        }
                        let made = if a == b {
                            let least = entry.xor_sign(entry).mul(simd.splat(LEAST_PIVOT));
                            let so_far = self.definite.load(simd, k);
                            self.definite.store(k, T::select_gt(rest, least, so_far, simd.splat(0.0)));
                            simd.splat(1.0).div(rest.sqrt())
                        } else {
                            rest.mul(self.factor[b * n + b].load(simd, k))
                        };
                        self.factor[a * n + b].store(k, made);
                    }
                }
            }
        }
    }

    /// Masses and directions of the orthogonal vectors.
    #[inline(always)]
    unsafe fn triplets_of_vectors<T: Lane>(&mut self, simd: Simd<T>, k: usize) {
        let (m, r) = (self.m, self.triplets());
        for e in 0..r {
            // SAFETY: the caller's promise about k.
            unsafe {
                let square = self.weighted.square(simd, e, k);
                self.masses[e].store(k, simd.splat(1.0).div(square));
                let inverse = simd.splat(1.0).div(square.sqrt());
                for row in 0..m {
                    let share = if m <= self.n {
                        self.weighted.rotations[row * r + e].load(simd, k)
                    } else {
                        self.weighted.entries[e * m + row].load(simd, k).mul(inverse)
                    };
                    self.directions[e * m + row].store(k, share);
                }
            }
        }
    }

    /// One sweep over all pairs of both sets that still turn (Hestenes 1958); which of them has turned. The rotations of
    /// one set, or lane, wait for square roots, while the others' go on.
    #[inline(always)]
    fn sweep<T: Lane>(&mut self, simd: Simd<T>, plain: bool, weighted: bool) -> (bool, bool) {
        let mut turned = (false, false);
        for e in 0..self.triplets() {
            for f in e + 1..self.triplets() {
                for k in pose_lanes(simd) {
                    // SAFETY: `pose_lanes` leaves room for a lane.
                    unsafe {
                        turned.0 |= plain && self.plain.rotate_pair::<T, false>(simd, e, f, k);
                        turned.1 |= weighted && self.weighted.rotate_pair::<T, true>(simd, e, f, k);
                    }
                }
            }
        }
        turned
    }
}

/// Vectors that one-sided Jacobi rotations make orthogonal; their norms become the singular values.
struct Vectors {
    count: usize,
    long: usize,
    /// The vectors, one after another.
    entries: Vec<PoseSlot>,
    /// Product of the rotations, count x count.
    rotations: Vec<PoseSlot>,
}

impl Vectors {
    fn new(count: usize, long: usize) -> Vectors {
        let zeros = |len| vec![PoseSlot::ZERO; len];
        Vectors { count, long, entries: zeros(count * long), rotations: zeros(count * count) }
    }

    fn begin_rotations(&mut self) {
        for (at, slot) in self.rotations.iter_mut().enumerate() {
            slot.0.fill(if at % (self.count + 1) == 0 { 1.0 } else { 0.0 });
        }
    }

    /// Squared norm of a vector.
    #[inline(always)]
    unsafe fn square<T: Lane>(&self, simd: Simd<T>, e: usize, k: usize) -> T {
        let mut sum = simd.splat(0.0);
        for x in &self.entries[e * self.long..][..self.long] {
            // SAFETY: the caller's promise about k.
            let x = unsafe { x.load(simd, k) };
            sum = x.fma(x, sum);
        }
        sum
    }

    /// Largest norm by smallest, infinite where one is zero.
    #[inline(always)]
    unsafe fn extent<T: Lane>(&self, simd: Simd<T>, k: usize) -> T {
        let (mut low, mut high) = (simd.splat(f64::INFINITY), simd.splat(0.0));
        for e in 0..self.count {
            // SAFETY: the caller's promise about k.
            let square = unsafe { self.square(simd, e, k) };
            low = T::select_gt(low, square, square, low);
            high = T::select_gt(square, high, square, high);
        }
        T::select_gt(low, simd.splat(0.0), high.div(low).sqrt(), simd.splat(f64::INFINITY))
    }

    /// Rotate two vectors in their plane until they are orthogonal; false where they are so at every pose already.
    #[inline(always)]
    unsafe fn rotate_pair<T: Lane, const ACCUMULATE: bool>(
        &mut self,
        simd: Simd<T>,
        e: usize,
        f: usize,
        k: usize,
    ) -> bool {
        let (long, none, one) = (self.long, simd.splat(0.0), simd.splat(1.0));
        let (head, tail) = self.entries.split_at_mut(f * long);
        let (first, second) = (&mut head[e * long..][..long], &mut tail[..long]);
        let (mut pp, mut qq, mut pq) = (none, none, none);
        // SAFETY: the caller's promise about k, here and below.
        unsafe {
            for (p, q) in first.iter().zip(second.iter()) {
                let (p, q) = (p.load(simd, k), q.load(simd, k));
                (pp, qq, pq) = (p.fma(p, pp), q.fma(q, qq), p.fma(q, pq));
            }
            let (square, bound) = (pq.mul(pq), pp.mul(qq).mul(simd.splat(ORTHOGONALITY * ORTHOGONALITY)));
            // The comparison is false for NaN, which no rotation mends.
            if T::select_gt(square, bound, one, none).sum() == 0.0 {
                return false;
            }
            // The smaller of the two angles whose tangent solves t^2 + 2 zeta t = 1, zeta = (qq - pp) / (2 pq): cosine and
            // sine by one quotient, of which nothing cancels.
            let (gap, twice) = (qq.sub(pp), pq.add(pq));
            let root = gap.fma(gap, twice.mul(twice)).sqrt();
            let across = gap.xor_sign(gap).add(root);
            let inverse = one.div(across.mul(root.add(root)).sqrt());
            let c = T::select_gt(square, bound, across.mul(inverse), one);
            let s = T::select_gt(square, bound, twice.xor_sign(gap).mul(inverse), none);
            let turn = |p: &mut PoseSlot, q: &mut PoseSlot| {
                let (x, y) = (p.load(simd, k), q.load(simd, k));
                p.store(k, s.fnma(y, c.mul(x)));
                q.store(k, s.fma(x, c.mul(y)));
            };
            first.iter_mut().zip(second).for_each(|(p, q)| turn(p, q));
            if ACCUMULATE {
                for row in self.rotations.chunks_exact_mut(self.count) {
                    let (left, right) = row.split_at_mut(f);
                    turn(&mut left[e], &mut right[0]);
                }
            }
        }
        true
    }
}
