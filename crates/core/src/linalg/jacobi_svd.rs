//! Singular values and vectors of `J L^-T` with `A = L L'` (J the Jacobian, A the mass matrix of one pose), by
//! one-sided Jacobi rotations.

/// Maximum number of Jacobi sweeps; five are usual.
const MAX_SWEEPS: usize = 30;
/// Vectors are orthogonal if the cosine of their angle is below this.
const ORTHOGONALITY: f64 = 1e-15;

/// Decomposition at one pose, of m rows and n coordinates: r = min(m, n) apparent masses, their directions, and the
/// coordinate rates that move the end effector along them.
pub(crate) struct JacobiSvd {
    m: usize,
    n: usize,
    /// Cholesky factor of A, n x n.
    factor: Vec<f64>,
    /// J, then L^-1 J': m vectors of length n.
    columns: Vec<f64>,
    /// The vectors that are orthogonalised, and the accumulated rotations.
    vectors: Vec<f64>,
    rotations: Vec<f64>,
    /// Singular values, and their indices in ascending order.
    singular_values: Vec<f64>,
    order: Vec<usize>,
    /// Apparent masses 1 / s^2, largest first, r.
    pub(crate) masses: Vec<f64>,
    /// Unit directions of the masses, r x m.
    pub(crate) directions: Vec<f64>,
    /// Coordinate rates that move the end effector at unit speed along each direction, r x n.
    pub(crate) rates: Vec<f64>,
}

impl JacobiSvd {
    pub(crate) fn new(m: usize, n: usize) -> JacobiSvd {
        let (r, zeros) = (m.min(n), |len| vec![0.0; len]);
        JacobiSvd {
            m,
            n,
            factor: zeros(n * n),
            columns: zeros(m * n),
            vectors: zeros(m * n),
            rotations: zeros(r * r),
            singular_values: zeros(r),
            order: (0..r).collect(),
            masses: zeros(r),
            directions: zeros(r * m),
            rates: zeros(r * n),
        }
    }

    /// Condition number of J: the ratio of its largest and smallest singular value, infinite if the rank is deficient.
    pub(crate) fn condition_number(&mut self, jacobian: impl Fn(usize, usize) -> f64) -> f64 {
        for row in 0..self.m {
            for a in 0..self.n {
                self.columns[row * self.n + a] = jacobian(row, a);
            }
        }
        self.orthogonalise();
        let singular_values = (0..self.order.len()).map(|e| self.norm(e));
        let (low, high) = singular_values.fold((f64::INFINITY, 0.0), |(low, high), s| (s.min(low), s.max(high)));
        if low > 0.0 { high / low } else { f64::INFINITY }
    }

    /// Determine masses, directions and rates; false where A is not positive definite.
    pub(crate) fn solve(&mut self, jacobian: impl Fn(usize, usize) -> f64, mass: impl Fn(usize, usize) -> f64) -> bool {
        if !self.decompose(mass) {
            return false;
        }
        let (m, n) = (self.m, self.n);
        for row in 0..m {
            for a in 0..n {
                let known: f64 = (0..a).map(|b| self.factor[a * n + b] * self.columns[row * n + b]).sum();
                self.columns[row * n + a] = (jacobian(row, a) - known) / self.factor[a * n + a];
            }
        }
        self.orthogonalise();
        for e in 0..self.order.len() {
            self.singular_values[e] = self.norm(e);
        }
        let singular_values = &self.singular_values;
        self.order.sort_unstable_by(|&a, &b| singular_values[a].total_cmp(&singular_values[b]));
        for place in 0..self.order.len() {
            let e = self.order[place];
            let s = self.singular_values[e];
            self.masses[place] = 1.0 / (s * s);
            for row in 0..m {
                self.directions[place * m + row] =
                    if m <= n { self.rotations[row * m + e] } else { self.vectors[e * m + row] / s };
            }
            self.fix_sign(place);
            self.unit_speed_rates(place);
        }
        true
    }

    /// Choose the sign of a direction: its component of largest magnitude is positive.
    fn fix_sign(&mut self, place: usize) {
        let direction = &mut self.directions[place * self.m..][..self.m];
        let largest = direction.iter().copied().fold(0.0, |a: f64, b| if b.abs() > a.abs() { b } else { a });
        if largest < 0.0 {
            direction.iter_mut().for_each(|x| *x = -*x);
        }
    }

    /// Cholesky decomposition A = L L'; false where A is not positive definite.
    fn decompose(&mut self, mass: impl Fn(usize, usize) -> f64) -> bool {
        let n = self.n;
        for a in 0..n {
            for b in 0..=a {
                let known: f64 = (0..b).map(|c| self.factor[a * n + c] * self.factor[b * n + c]).sum();
                let rest = mass(a, b) - known;
                if a == b {
                    // A pivot that cancellation has reduced to rounding error is not known to be positive.
                    if rest.is_nan() || rest <= 1e-14 * mass(a, a).abs() {
                        return false;
                    }
                    self.factor[a * n + a] = rest.sqrt();
                } else {
                    self.factor[a * n + b] = rest / self.factor[b * n + b];
                }
            }
        }
        true
    }

    /// Coordinate rates for one direction v: m A^-1 J' v = m L^-T (L^-1 J') v.
    fn unit_speed_rates(&mut self, place: usize) {
        let (m, n) = (self.m, self.n);
        for a in (0..n).rev() {
            let along: f64 = (0..m).map(|row| self.columns[row * n + a] * self.directions[place * m + row]).sum();
            let known: f64 = (a + 1..n).map(|b| self.factor[b * n + a] * self.rates[place * n + b]).sum();
            self.rates[place * n + a] = (self.masses[place] * along - known) / self.factor[a * n + a];
        }
    }

    /// Length of the vectors that are orthogonalised.
    fn vector_length(&self) -> usize {
        self.m.max(self.n)
    }

    fn norm(&self, e: usize) -> f64 {
        let long = self.vector_length();
        self.vectors[e * long..][..long].iter().map(|x| x * x).sum::<f64>().sqrt()
    }

    /// One-sided Jacobi rotations (Hestenes 1958): of rows and columns the fewer are orthogonalised pair by pair. Their
    /// norms are the singular values.
    fn orthogonalise(&mut self) {
        let (m, n, r, long) = (self.m, self.n, self.order.len(), self.vector_length());
        for e in 0..r {
            for k in 0..long {
                self.vectors[e * long + k] = if m <= n { self.columns[e * n + k] } else { self.columns[k * n + e] };
            }
            for f in 0..r {
                self.rotations[e * r + f] = if e == f { 1.0 } else { 0.0 };
            }
        }
        for _ in 0..MAX_SWEEPS {
            let mut turned = false;
            for e in 0..r {
                for f in e + 1..r {
                    turned |= self.rotate_pair(e, f, long);
                }
            }
            if !turned {
                return;
            }
        }
    }

    /// Rotate two vectors in their plane until they are orthogonal; false where they are already.
    fn rotate_pair(&mut self, e: usize, f: usize, long: usize) -> bool {
        let r = self.order.len();
        let (head, tail) = self.vectors.split_at_mut(f * long);
        let (p, q) = (&mut head[e * long..][..long], &mut tail[..long]);
        let (mut pp, mut qq, mut pq) = (0.0, 0.0, 0.0);
        for (p, q) in p.iter().zip(q.iter()) {
            (pp, qq, pq) = (pp + p * p, qq + q * q, pq + p * q);
        }
        if pq * pq <= ORTHOGONALITY * ORTHOGONALITY * pp * qq {
            return false;
        }
        let zeta = (qq - pp) / (2.0 * pq);
        let t = zeta.signum() / (zeta.abs() + (1.0 + zeta * zeta).sqrt());
        let c = 1.0 / (1.0 + t * t).sqrt();
        let s = c * t;
        for (p, q) in p.iter_mut().zip(q.iter_mut()) {
            (*p, *q) = (c * *p - s * *q, s * *p + c * *q);
        }
        for row in self.rotations.chunks_exact_mut(r) {
            (row[e], row[f]) = (c * row[e] - s * row[f], s * row[e] + c * row[f]);
        }
        true
    }
}
