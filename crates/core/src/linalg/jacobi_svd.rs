//! The algebra of one pose: singular values and vectors of `J L^-T`, where `A = L L'`, by rotations.

/// Rounds of rotations at most; five are usual.
const ROUNDS: usize = 30;
/// Vectors count as orthogonal where the cosine of their angle is below this.
const ORTHOGONAL: f64 = 1e-15;

/// Masses, directions and rates of one pose: m rows, n coordinates, r = min(m, n).
pub(crate) struct Principal {
    m: usize,
    n: usize,
    /// Cholesky factor of A, n x n.
    factor: Vec<f64>,
    /// J, then L^-1 J': m vectors of length n.
    columns: Vec<f64>,
    /// The vectors that are made orthogonal, and the rotations that do it.
    vectors: Vec<f64>,
    turned: Vec<f64>,
    /// Singular values, and where they are from the smallest on.
    lengths: Vec<f64>,
    order: Vec<usize>,
    pub masses: Vec<f64>,
    pub directions: Vec<f64>,
    pub rates: Vec<f64>,
}

impl Principal {
    pub(crate) fn new(m: usize, n: usize) -> Principal {
        let (r, zeros) = (m.min(n), |len| vec![0.0; len]);
        Principal {
            m,
            n,
            factor: zeros(n * n),
            columns: zeros(m * n),
            vectors: zeros(m * n),
            turned: zeros(r * r),
            lengths: zeros(r),
            order: (0..r).collect(),
            masses: zeros(r),
            directions: zeros(r * m),
            rates: zeros(r * n),
        }
    }

    /// Ratio of the largest and the smallest singular value of J; infinite where it has less than full rank.
    pub(crate) fn condition(&mut self, jacobian: impl Fn(usize, usize) -> f64) -> f64 {
        for row in 0..self.m {
            for a in 0..self.n {
                self.columns[row * self.n + a] = jacobian(row, a);
            }
        }
        self.orthogonalise();
        let lengths = (0..self.order.len()).map(|e| self.length(e));
        let (low, high) = lengths.fold((f64::INFINITY, 0.0), |(low, high), s| (s.min(low), s.max(high)));
        if low > 0.0 { high / low } else { f64::INFINITY }
    }

    /// Masses, directions and rates; false where A is not positive definite.
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
            self.lengths[e] = self.length(e);
        }
        let lengths = &self.lengths;
        self.order.sort_unstable_by(|&a, &b| lengths[a].total_cmp(&lengths[b]));
        for place in 0..self.order.len() {
            let e = self.order[place];
            let s = self.lengths[e];
            self.masses[place] = 1.0 / (s * s);
            for row in 0..m {
                self.directions[place * m + row] =
                    if m <= n { self.turned[row * m + e] } else { self.vectors[e * m + row] / s };
            }
            self.set_upright(place);
            self.unit_speed(place);
        }
        true
    }

    /// Of a direction's two ways, the one in which its largest component is positive.
    fn set_upright(&mut self, place: usize) {
        let direction = &mut self.directions[place * self.m..][..self.m];
        let largest = direction.iter().copied().fold(0.0, |a: f64, b| if b.abs() > a.abs() { b } else { a });
        if largest < 0.0 {
            direction.iter_mut().for_each(|x| *x = -*x);
        }
    }

    /// A = L L'.
    fn decompose(&mut self, mass: impl Fn(usize, usize) -> f64) -> bool {
        let n = self.n;
        for a in 0..n {
            for b in 0..=a {
                let known: f64 = (0..b).map(|c| self.factor[a * n + c] * self.factor[b * n + c]).sum();
                let rest = mass(a, b) - known;
                if a == b {
                    // What is left of a pivot after cancellation below rounding is not known to be positive.
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

    /// Rates of the coordinates along one direction: m A^-1 J' v = m L^-T (L^-1 J') v.
    fn unit_speed(&mut self, place: usize) {
        let (m, n) = (self.m, self.n);
        for a in (0..n).rev() {
            let along: f64 = (0..m).map(|row| self.columns[row * n + a] * self.directions[place * m + row]).sum();
            let known: f64 = (a + 1..n).map(|b| self.factor[b * n + a] * self.rates[place * n + b]).sum();
            self.rates[place * n + a] = (self.masses[place] * along - known) / self.factor[a * n + a];
        }
    }

    /// Length of the vectors that are made orthogonal.
    fn long(&self) -> usize {
        self.m.max(self.n)
    }

    fn length(&self, e: usize) -> f64 {
        let long = self.long();
        self.vectors[e * long..][..long].iter().map(|x| x * x).sum::<f64>().sqrt()
    }

    /// One-sided Jacobi rotations (Hestenes 1958): the fewer of rows and columns, made orthogonal in pairs. Their lengths
    /// are the singular values.
    fn orthogonalise(&mut self) {
        let (m, n, r, long) = (self.m, self.n, self.order.len(), self.long());
        for e in 0..r {
            for k in 0..long {
                self.vectors[e * long + k] = if m <= n { self.columns[e * n + k] } else { self.columns[k * n + e] };
            }
            for f in 0..r {
                self.turned[e * r + f] = if e == f { 1.0 } else { 0.0 };
            }
        }
        for _ in 0..ROUNDS {
            let mut turned = false;
            for e in 0..r {
                for f in e + 1..r {
                    turned |= self.turn(e, f, long);
                }
            }
            if !turned {
                return;
            }
        }
    }

    /// Turn two vectors in their plane until they are orthogonal; false where they are.
    fn turn(&mut self, e: usize, f: usize, long: usize) -> bool {
        let r = self.order.len();
        let (head, tail) = self.vectors.split_at_mut(f * long);
        let (p, q) = (&mut head[e * long..][..long], &mut tail[..long]);
        let (mut pp, mut qq, mut pq) = (0.0, 0.0, 0.0);
        for (p, q) in p.iter().zip(q.iter()) {
            (pp, qq, pq) = (pp + p * p, qq + q * q, pq + p * q);
        }
        if pq * pq <= ORTHOGONAL * ORTHOGONAL * pp * qq {
            return false;
        }
        let zeta = (qq - pp) / (2.0 * pq);
        let t = zeta.signum() / (zeta.abs() + (1.0 + zeta * zeta).sqrt());
        let c = 1.0 / (1.0 + t * t).sqrt();
        let s = c * t;
        for (p, q) in p.iter_mut().zip(q.iter_mut()) {
            (*p, *q) = (c * *p - s * *q, s * *p + c * *q);
        }
        for row in self.turned.chunks_exact_mut(r) {
            (row[e], row[f]) = (c * row[e] - s * row[f], s * row[e] + c * row[f]);
        }
        true
    }
}
