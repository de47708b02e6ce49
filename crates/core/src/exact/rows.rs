//! Rows of the regressor modulo a prime, at exact states of a closed chain.
//!
//! Kane's form of inverse dynamics, in link frames: the torque of active joint m is the sum over links of the link's
//! force and moment times its partial velocities by m. Loops are in these partial velocities, so the tree's torques are
//! never formed (Khalil and Dombre 2002, eq. 10.25, for the same projection).

use crate::error::{Error, expect_length};
use crate::exact::field::Field;

/// Columns of a link: XX XY XZ YY YZ ZZ MX MY MZ M.
const OWN: usize = 10;
/// Numbers of a pose.
const POSE: usize = 16;

/// A tree of joints in normal form, at exact states. All numbers are residues from 0 to p - 1.
///
/// States that share their lengths follow one another, `samples` of them for each set.
pub struct ExactStates<'a> {
    /// Parent of each joint, `None` for the base; parents come first.
    pub parent: &'a [Option<usize>],
    /// Whether each joint slides.
    pub prismatic: &'a [bool],
    /// Number of active joints.
    pub active: usize,
    /// States for each set of lengths.
    pub samples: usize,
    /// Pose of each joint in its parent's frame, joints x sets x 4 x 4.
    pub placements: &'a [i64],
    /// Cosine, sine, slide, velocity and acceleration of each joint, 5 x joints x states.
    pub motion: &'a [i64],
    /// Rate of each joint by active one, joints x states x active.
    pub rates: &'a [i64],
    /// Acceleration of the base less gravity, states x 3.
    pub base: &'a [i64],
}

type Vector = [u64; 3];

/// Motion of a link's frame in its own axes.
#[derive(Clone, Default)]
struct Link {
    /// Angular velocity and acceleration.
    w: Vector,
    dw: Vector,
    /// Acceleration of the origin less gravity.
    a: Vector,
    /// Partial velocity of the origin, and partial angular velocity, by active joint.
    linear: Vec<Vector>,
    angular: Vec<Vector>,
}

impl Field {
    /// The residues of signed products' sums: `plus` and `minus` have at most eight terms each.
    #[inline(always)]
    fn sum<const N: usize, const M: usize>(self, plus: [(u64, u64); N], minus: [(u64, u64); M]) -> u64 {
        let plus: u64 = plus.iter().map(|(x, y)| x * y).sum();
        let minus: u64 = minus.iter().map(|(x, y)| x * (self.prime - y)).sum();
        self.reduce(plus + minus)
    }

    #[inline(always)]
    fn cross(self, a: Vector, b: Vector) -> Vector {
        let entry = |i: usize, k: usize| self.sum([(a[i], b[k])], [(a[k], b[i])]);
        [entry(1, 2), entry(2, 0), entry(0, 1)]
    }

    #[inline(always)]
    fn add(self, a: Vector, b: Vector) -> Vector {
        core::array::from_fn(|i| self.reduce(a[i] + b[i]))
    }

    /// The transpose of a matrix times a vector.
    #[inline(always)]
    fn back(self, matrix: &[Vector; 3], v: Vector) -> Vector {
        core::array::from_fn(|i| self.sum(core::array::from_fn::<_, 3, _>(|k| (matrix[k][i], v[k])), []))
    }

    #[inline(always)]
    fn dot(self, a: Vector, b: Vector) -> u64 {
        self.sum(core::array::from_fn::<_, 3, _>(|k| (a[k], b[k])), [])
    }
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
    let (field, joints, active) = (Field::new(prime)?, states.parent.len(), states.active);
    let count = states.base.len() / 3;
    let sets = count / states.samples.max(1);
    expect_length("base", states.base.len(), sets * states.samples * 3)?;
    expect_length("prismatic", states.prismatic.len(), joints)?;
    expect_length("placements", states.placements.len(), joints * sets * POSE)?;
    expect_length("motion", states.motion.len(), 5 * joints * count)?;
    expect_length("rates", states.rates.len(), joints * count * active)?;
    expect_length("out", out.len(), count * active * OWN * joints)?;
    if let Some((joint, &Some(got))) = states.parent.iter().enumerate().find(|(j, p)| p.is_some_and(|p| p >= *j)) {
        return Err(Error::Index { name: "parent", got, limit: joint });
    }
    let numbers = [states.placements, states.motion, states.rates, states.base];
    if let Some(&got) = numbers.iter().copied().flatten().find(|&&x| x < 0 || x >= i64::from(prime)) {
        return Err(Error::Value { name: "a number of a state", got: got as f64, wanted: "a residue of the prime" });
    }
    let still = vec![Vector::default(); active];
    let empty = Link { linear: still.clone(), angular: still, ..Link::default() };
    let mut links = vec![empty.clone(); joints];
    let mut base = empty;
    for (state, out) in out.chunks_exact_mut((active * OWN * joints).max(1)).enumerate() {
        base.a = core::array::from_fn(|i| states.base[state * 3 + i] as u64);
        for joint in 0..joints {
            let (before, rest) = links.split_at_mut(joint);
            let parent = states.parent[joint].map_or(&base, |parent| &before[parent]);
            states.moved(field, joint, state, (sets, count), parent, &mut rest[0]);
            let columns = LinkColumns::new(field, &rest[0]);
            for m in 0..active {
                let own = &mut out[(m * joints + joint) * OWN..][..OWN];
                columns.row(field, &rest[0], m, own);
            }
        }
    }
    Ok(())
}

impl ExactStates<'_> {
    /// The motion of a joint's link from that of its parent's.
    fn moved(&self, field: Field, j: usize, state: usize, size: (usize, usize), parent: &Link, link: &mut Link) {
        let ((sets, count), joints) = (size, self.parent.len());
        let placed = &self.placements[(j * sets + state / self.samples) * POSE..][..POSE];
        let number = |kind: usize| self.motion[(kind * joints + j) * count + state] as u64;
        let (cos, sin, slide, rate, acceleration) = (number(0), number(1), number(2), number(3), number(4));
        let entry = |i: usize, k: usize| placed[4 * i + k] as u64;
        let turn: [Vector; 3] = core::array::from_fn(|i| {
            [
                field.sum([(entry(i, 0), cos), (entry(i, 1), sin)], []),
                field.sum([(entry(i, 1), cos)], [(entry(i, 0), sin)]),
                entry(i, 2),
            ]
        });
        let origin = core::array::from_fn(|i| field.reduce(entry(i, 3) + entry(i, 2) * slide));
        let swing = field.cross(parent.w, field.cross(parent.w, origin));
        let carried = field.add(field.cross(parent.dw, origin), swing);
        link.a = field.back(&turn, field.add(parent.a, carried));
        (link.w, link.dw) = (field.back(&turn, parent.w), field.back(&turn, parent.dw));
        // w x z times the rate.
        let across = [field.sum([(link.w[1], rate)], []), field.sum([], [(link.w[0], rate)]), 0];
        let own = [0, 0, acceleration];
        if self.prismatic[j] {
            link.a = field.add(link.a, field.add(own, field.add(across, across)));
        } else {
            link.w[2] = field.reduce(link.w[2] + rate);
            link.dw = field.add(link.dw, field.add(own, across));
        }
        let rates = &self.rates[(j * count + state) * self.active..][..self.active];
        for (m, &rate) in rates.iter().enumerate() {
            // Velocity of the joint's origin: that of the parent's, and w x origin.
            let lever = field.cross(parent.angular[m], origin);
            link.linear[m] = field.back(&turn, field.add(parent.linear[m], lever));
            link.angular[m] = field.back(&turn, parent.angular[m]);
            let along = if self.prismatic[j] { &mut link.linear[m] } else { &mut link.angular[m] };
            along[2] = field.reduce(along[2] + rate as u64);
        }
    }
}

/// Moment by each inertia, and force by each first moment, of a link.
struct LinkColumns {
    moment: [Vector; 6],
    force: [Vector; 3],
}

impl LinkColumns {
    fn new(field: Field, link: &Link) -> LinkColumns {
        // Component pairs of XX XY XZ YY YZ ZZ.
        const PAIRS: [(usize, usize); 6] = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)];
        let times_inertia = |v: Vector, (i, k): (usize, usize)| {
            let mut made = Vector::default();
            made[i] = v[k];
            made[k] = v[i];
            made
        };
        let moment =
            PAIRS.map(|pair| field.add(times_inertia(link.dw, pair), field.cross(link.w, times_inertia(link.w, pair))));
        let force = core::array::from_fn(|i| {
            let mut axis = Vector::default();
            axis[i] = 1;
            field.add(field.cross(link.dw, axis), field.cross(link.w, field.cross(link.w, axis)))
        });
        LinkColumns { moment, force }
    }

    /// The torque of active joint m by each of the link's parameters.
    fn row(&self, field: Field, link: &Link, m: usize, out: &mut [i64]) {
        let (linear, angular) = (link.linear[m], link.angular[m]);
        for (out, &moment) in out.iter_mut().zip(&self.moment) {
            *out = field.dot(angular, moment) as i64;
        }
        // A first moment s makes the moment s x a: its product with w is that of s with a x w.
        let lever = field.cross(link.a, angular);
        for i in 0..3 {
            out[6 + i] = field.reduce(field.dot(linear, self.force[i]) + lever[i]) as i64;
        }
        out[9] = field.dot(linear, link.a) as i64;
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
}
