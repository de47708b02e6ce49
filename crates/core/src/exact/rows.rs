//! Rows of the regressor modulo a prime, at exact states of a closed chain; the same in floating point.
//!
//! Kane's form of inverse dynamics, in link frames: the torque of active joint m is the sum over links of the link's
//! force and moment times its partial velocities by m. Loops are in these partial velocities, so the tree's torques are
//! never formed (Khalil and Dombre 2002, eq. 10.25, for the same projection).

use crate::error::{Error, expect_length};
use crate::exact::field::{Field, Real, Ring};

/// Columns of a link: XX XY XZ YY YZ ZZ MX MY MZ M.
const OWN: usize = 10;
/// Numbers of a pose.
const POSE: usize = 16;

/// A tree of joints in normal form, at given states. All numbers are residues from 0 to p - 1, or all are floats.
///
/// States that share their lengths follow one another, `samples` of them for each set.
pub struct TreeStates<'a, N> {
    /// Parent of each joint, `None` for the base; parents come first.
    pub parent: &'a [Option<usize>],
    /// Whether each joint slides.
    pub prismatic: &'a [bool],
    /// Number of active joints.
    pub active: usize,
    /// States for each set of lengths.
    pub samples: usize,
    /// Pose of each joint in its parent's frame, joints x sets x 4 x 4.
    pub placements: &'a [N],
    /// Cosine, sine, slide, velocity and acceleration of each joint, 5 x joints x states.
    pub motion: &'a [N],
    /// Rate of each joint by active one, joints x states x active.
    pub rates: &'a [N],
    /// Acceleration of the base less gravity, states x 3.
    pub base: &'a [N],
}

/// States modulo a prime.
pub type ExactStates<'a> = TreeStates<'a, i64>;

type Vector<R> = [<R as Ring>::Element; 3];

/// Motion of a link's frame in its own axes.
#[derive(Clone)]
struct Link<R: Ring> {
    /// Angular velocity and acceleration.
    w: Vector<R>,
    dw: Vector<R>,
    /// Acceleration of the origin less gravity.
    a: Vector<R>,
    /// Partial velocity of the origin, and partial angular velocity, by active joint.
    linear: Vec<Vector<R>>,
    angular: Vec<Vector<R>>,
}

impl<R: Ring> Link<R> {
    fn still(active: usize) -> Self {
        let zero = [R::Element::default(); 3];
        Link { w: zero, dw: zero, a: zero, linear: vec![zero; active], angular: vec![zero; active] }
    }
}

#[inline(always)]
fn cross<R: Ring>(ring: R, a: Vector<R>, b: Vector<R>) -> Vector<R> {
    let entry = |i: usize, k: usize| ring.sum([(a[i], b[k])], [(a[k], b[i])]);
    [entry(1, 2), entry(2, 0), entry(0, 1)]
}

#[inline(always)]
fn add<R: Ring>(ring: R, a: Vector<R>, b: Vector<R>) -> Vector<R> {
    core::array::from_fn(|i| ring.add(a[i], b[i]))
}

/// The transpose of a matrix times a vector.
#[inline(always)]
fn back<R: Ring>(ring: R, matrix: &[Vector<R>; 3], v: Vector<R>) -> Vector<R> {
    core::array::from_fn(|i| ring.sum(core::array::from_fn::<_, 3, _>(|k| (matrix[k][i], v[k])), []))
}

#[inline(always)]
fn dot<R: Ring>(ring: R, a: Vector<R>, b: Vector<R>) -> R::Element {
    ring.sum(core::array::from_fn::<_, 3, _>(|k| (a[k], b[k])), [])
}

/// Rows of the regressor, states x active joints x 10 columns of each link, modulo a prime.
///
/// # Example
///
/// ```
/// # use haptid_core::*;
/// // A joint about z that turns by 3 with acceleration 5, in the plane of gravity 2 along -x: the pose is the identity.
/// let mut rows = [0; 10];
/// let states = ExactStates {
///     parent: &[None],
///     prismatic: &[false],
///     active: 1,
///     samples: 1,
///     placements: &[1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1],
///     motion: &[1, 0, 0, 3, 5],
///     rates: &[1],
///     base: &[2, 0, 0],
/// };
/// exact_rows(&states, 101, &mut rows)?;
/// // ZZ has the acceleration, MY the torque -2 of gravity modulo 101.
/// assert_eq!(rows, [0, 0, 0, 0, 0, 5, 0, 99, 0, 0]);
/// # Ok::<(), haptid_core::Error>(())
/// ```
pub fn exact_rows(states: &ExactStates, prime: u32, out: &mut [i64]) -> Result<(), Error> {
    let field = Field::new(prime)?;
    let numbers = [states.placements, states.motion, states.rates, states.base];
    if let Some(&got) = numbers.iter().copied().flatten().find(|&&x| x < 0 || x >= i64::from(prime)) {
        return Err(Error::Value { name: "a number of a state", got: got as f64, wanted: "a residue of the prime" });
    }
    states.rows(field, out)
}

/// The same in floating point.
pub fn real_rows(states: &TreeStates<f64>, out: &mut [f64]) -> Result<(), Error> {
    states.rows(Real, out)
}

impl<N: Copy> TreeStates<'_, N> {
    fn rows<R: Ring<Number = N>>(&self, ring: R, out: &mut [N]) -> Result<(), Error> {
        let (joints, active, count) = (self.parent.len(), self.active, self.base.len() / 3);
        let sets = count / self.samples.max(1);
        expect_length("base", self.base.len(), sets * self.samples * 3)?;
        expect_length("prismatic", self.prismatic.len(), joints)?;
        expect_length("placements", self.placements.len(), joints * sets * POSE)?;
        expect_length("motion", self.motion.len(), 5 * joints * count)?;
        expect_length("rates", self.rates.len(), joints * count * active)?;
        expect_length("out", out.len(), count * active * OWN * joints)?;
        if let Some((joint, &Some(got))) = self.parent.iter().enumerate().find(|(j, p)| p.is_some_and(|p| p >= *j)) {
            return Err(Error::Index { name: "parent", got, limit: joint });
        }
        let mut links = vec![Link::<R>::still(active); joints];
        let mut base = Link::<R>::still(active);
        for (state, out) in out.chunks_exact_mut((active * OWN * joints).max(1)).enumerate() {
            base.a = core::array::from_fn(|i| R::element(self.base[state * 3 + i]));
            for joint in 0..joints {
                let (before, rest) = links.split_at_mut(joint);
                let parent = self.parent[joint].map_or(&base, |parent| &before[parent]);
                self.moved(ring, joint, state, (sets, count), parent, &mut rest[0]);
                let columns = LinkColumns::new(ring, &rest[0]);
                for m in 0..active {
                    let own = &mut out[(m * joints + joint) * OWN..][..OWN];
                    columns.row(ring, &rest[0], m, own);
                }
            }
        }
        Ok(())
    }

    /// The motion of a joint's link from that of its parent's.
    fn moved<R: Ring<Number = N>>(
        &self,
        ring: R,
        j: usize,
        state: usize,
        (sets, count): (usize, usize),
        parent: &Link<R>,
        link: &mut Link<R>,
    ) {
        let (joints, none) = (self.parent.len(), R::Element::default());
        let placed = &self.placements[(j * sets + state / self.samples) * POSE..][..POSE];
        let number = |kind: usize| R::element(self.motion[(kind * joints + j) * count + state]);
        let (cos, sin, slide, rate, acceleration) = (number(0), number(1), number(2), number(3), number(4));
        let entry = |i: usize, k: usize| R::element(placed[4 * i + k]);
        let turn: [Vector<R>; 3] = core::array::from_fn(|i| {
            [
                ring.sum([(entry(i, 0), cos), (entry(i, 1), sin)], []),
                ring.sum([(entry(i, 1), cos)], [(entry(i, 0), sin)]),
                entry(i, 2),
            ]
        });
        let origin = core::array::from_fn(|i| ring.add(entry(i, 3), ring.sum([(entry(i, 2), slide)], [])));
        let swing = cross(ring, parent.w, cross(ring, parent.w, origin));
        let carried = add(ring, cross(ring, parent.dw, origin), swing);
        link.a = back(ring, &turn, add(ring, parent.a, carried));
        (link.w, link.dw) = (back(ring, &turn, parent.w), back(ring, &turn, parent.dw));
        // w x z times the rate.
        let across = [ring.sum([(link.w[1], rate)], []), ring.sum([], [(link.w[0], rate)]), none];
        let own = [none, none, acceleration];
        if self.prismatic[j] {
            link.a = add(ring, link.a, add(ring, own, add(ring, across, across)));
        } else {
            link.w[2] = ring.add(link.w[2], rate);
            link.dw = add(ring, link.dw, add(ring, own, across));
        }
        let rates = &self.rates[(j * count + state) * self.active..][..self.active];
        for (m, &rate) in rates.iter().enumerate() {
            // Velocity of the joint's origin: that of the parent's, and w x origin.
            let lever = cross(ring, parent.angular[m], origin);
            link.linear[m] = back(ring, &turn, add(ring, parent.linear[m], lever));
            link.angular[m] = back(ring, &turn, parent.angular[m]);
            let along = if self.prismatic[j] { &mut link.linear[m] } else { &mut link.angular[m] };
            along[2] = ring.add(along[2], R::element(rate));
        }
    }
}

/// Moment by each inertia, and force by each first moment, of a link.
struct LinkColumns<R: Ring> {
    moment: [Vector<R>; 6],
    force: [Vector<R>; 3],
}

impl<R: Ring> LinkColumns<R> {
    fn new(ring: R, link: &Link<R>) -> Self {
        // Component pairs of XX XY XZ YY YZ ZZ.
        const PAIRS: [(usize, usize); 6] = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)];
        let none = [R::Element::default(); 3];
        let times_inertia = |v: Vector<R>, (i, k): (usize, usize)| {
            let mut made = none;
            made[i] = v[k];
            made[k] = v[i];
            made
        };
        let moment =
            PAIRS.map(|pair| add(ring, times_inertia(link.dw, pair), cross(ring, link.w, times_inertia(link.w, pair))));
        let force = core::array::from_fn(|i| {
            let mut axis = none;
            axis[i] = R::ONE;
            add(ring, cross(ring, link.dw, axis), cross(ring, link.w, cross(ring, link.w, axis)))
        });
        LinkColumns { moment, force }
    }

    /// The torque of active joint m by each of the link's parameters.
    fn row(&self, ring: R, link: &Link<R>, m: usize, out: &mut [R::Number]) {
        let (linear, angular) = (link.linear[m], link.angular[m]);
        for (out, &moment) in out.iter_mut().zip(&self.moment) {
            *out = R::number(dot(ring, angular, moment));
        }
        // A first moment s makes the moment s x a: its product with w is that of s with a x w.
        let lever = cross(ring, link.a, angular);
        for i in 0..3 {
            out[6 + i] = R::number(ring.add(dot(ring, linear, self.force[i]), lever[i]));
        }
        out[9] = R::number(dot(ring, linear, link.a));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arguments_are_checked() {
        let good = || ExactStates {
            parent: &[None],
            prismatic: &[false],
            active: 1,
            samples: 1,
            placements: &[0; 16],
            motion: &[0; 5],
            rates: &[0],
            base: &[0; 3],
        };
        let told = |states: ExactStates| exact_rows(&states, 101, &mut [0; 10]).is_err();
        assert!(!told(good()));
        assert!(told(ExactStates { parent: &[Some(0)], ..good() }));
        assert!(told(ExactStates { samples: 2, ..good() }));
        assert!(told(ExactStates { samples: 0, ..good() }));
        assert!(told(ExactStates { rates: &[101], ..good() }));
        assert!(told(ExactStates { base: &[0, 0, -1], ..good() }));
        assert!(told(ExactStates { motion: &[0; 4], ..good() }));
    }

    /// Where no residue wraps around, rows modulo a prime are those in floating point: here with small whole numbers.
    #[test]
    fn rows_modulo_a_prime_are_those_of_whole_numbers() {
        let prime = 1_073_741_783;
        let mut state = 5_u64;
        let mut draw = |count: usize| -> Vec<i64> {
            let mut next = || {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                (state >> 60) as i64 - 8
            };
            (0..count).map(|_| next()).collect()
        };
        let (joints, active, samples, sets) = (3, 2, 2, 2);
        let count = samples * sets;
        let numbers = [joints * sets * POSE, 5 * joints * count, joints * count * active, count * 3].map(&mut draw);
        let residues = numbers.clone().map(|part| part.iter().map(|x| x.rem_euclid(prime)).collect::<Vec<i64>>());
        let floats = numbers.map(|part| part.iter().map(|&x| x as f64).collect::<Vec<f64>>());
        let (parent, prismatic) = ([None, Some(0), Some(1)], [false, true, false]);
        let size = count * active * OWN * joints;
        let (mut exact, mut real) = (vec![0; size], vec![0.0; size]);
        fn states<'a, N>(parts: &'a [Vec<N>; 4], parent: &'a [Option<usize>], slides: &'a [bool]) -> TreeStates<'a, N> {
            let [placements, motion, rates, base] = parts;
            TreeStates { parent, prismatic: slides, active: 2, samples: 2, placements, motion, rates, base }
        }
        exact_rows(&states(&residues, &parent, &prismatic), prime as u32, &mut exact).unwrap();
        real_rows(&states(&floats, &parent, &prismatic), &mut real).unwrap();
        assert!(real.iter().any(|&x| x != 0.0));
        for (exact, real) in exact.iter().zip(real) {
            assert!(real.abs() < 2_f64.powi(53));
            assert_eq!(*exact, (real as i64).rem_euclid(prime));
        }
    }
}
