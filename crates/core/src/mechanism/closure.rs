//! How a joint, or what a term acts on, follows the coordinates: linearly, or as the motion brings it with every sample.

/// How the tree's joints follow the coordinates: `q = G c + offset`.
///
/// Of loops that are not linear the motion brings, with every sample, the position of each joint that has a given rate,
/// its given rates `G = dq/dc`, and their changes `dG/dt`: see [`crate::Motion::loops`].
#[derive(Debug, Clone, PartialEq)]
pub struct Closure {
    /// Rates `dq/dc`, joints x coordinates, row-major.
    pub rates: Vec<f64>,
    /// Joint positions at zero coordinates, rad or m.
    pub offset: Vec<f64>,
    /// Which rates come with the motion, joints x coordinates, row-major; empty for none.
    pub given: Vec<bool>,
}

impl Closure {
    /// Every joint is its own coordinate.
    pub fn open(joints: usize) -> Closure {
        let mut rates = vec![0.0; joints * joints];
        for j in 0..joints {
            rates[j * joints + j] = 1.0;
        }
        Closure { rates, offset: vec![0.0; joints], given: Vec::new() }
    }
}

/// A rate with one coordinate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Rate {
    Constant(f64),
    /// Staged channels of the rate, and of its own rate of change with time.
    Varying {
        rate: usize,
        derivative: usize,
    },
}

impl Rate {
    pub(crate) fn is_zero(self) -> bool {
        self == Rate::Constant(0.0)
    }
}

/// A position as a function of the coordinates.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct JointMap {
    /// Staged channel of the position, where the motion brings it.
    pub given: Option<usize>,
    /// Position at zero coordinates, where it does not.
    pub offset: f64,
    /// The coordinates that move it; no rate is zero.
    pub rates: Vec<(usize, Rate)>,
}

impl JointMap {
    pub(crate) fn linear(offset: f64, rates: impl IntoIterator<Item = (usize, f64)>) -> JointMap {
        let rates = rates.into_iter().filter(|r| r.1 != 0.0).map(|(a, rate)| (a, Rate::Constant(rate))).collect();
        JointMap { given: None, offset, rates }
    }

    /// The course of a joint that the motion brings: from `next` on its position, its given rates, and their changes.
    /// Returns the first channel after them.
    pub(crate) fn given(next: usize, rates: &[f64], given: &[bool]) -> (JointMap, usize) {
        let many = given.iter().filter(|&&g| g).count();
        let mut rate = next + 1;
        let mut found = Vec::new();
        for (a, (&constant, &given)) in rates.iter().zip(given).enumerate() {
            if given {
                found.push((a, Rate::Varying { rate, derivative: rate + many }));
                rate += 1;
            } else if constant != 0.0 {
                found.push((a, Rate::Constant(constant)));
            }
        }
        (JointMap { given: Some(next), offset: 0.0, rates: found }, rate + many)
    }

    /// The rate with a coordinate.
    pub(crate) fn rate(&self, coordinate: usize) -> Rate {
        self.rates.iter().find(|r| r.0 == coordinate).map_or(Rate::Constant(0.0), |r| r.1)
    }
}
