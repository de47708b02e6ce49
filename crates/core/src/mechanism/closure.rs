//! How joints follow the coordinates: linearly, or as a motion prescribes sample by sample.

/// Joint positions as functions of the independent coordinates c: `q = G c + offset`.
///
/// For loops with varying rates a motion brings, with every sample, the position of each joint that has a given rate,
/// those rates `G = dq/dc`, and their derivatives `dG/dt`: see [`crate::Motion::loops`].
#[derive(Debug, Clone, PartialEq)]
pub struct Closure {
    /// Rates `dq/dc`, joints x coordinates, row-major.
    pub rates: Vec<f64>,
    /// Joint positions at zero coordinates, rad or m.
    pub offset: Vec<f64>,
    /// Rates that come with the motion, joints x coordinates, row-major; empty for none.
    pub given: Vec<bool>,
}

impl Closure {
    /// The closure of an open tree: every joint is a coordinate.
    ///
    /// # Example
    ///
    /// ```
    /// assert_eq!(haptid_core::Closure::open(2).rates, [1., 0., 0., 1.]);
    /// ```
    pub fn open(joints: usize) -> Closure {
        let mut rates = vec![0.0; joints * joints];
        for j in 0..joints {
            rates[j * joints + j] = 1.0;
        }
        Closure { rates, offset: vec![0.0; joints], given: Vec::new() }
    }
}

/// Rate of a joint with respect to one coordinate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Rate {
    Constant(f64),
    /// Channels of the rate and of its time derivative.
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

/// Position of a joint, or of the displacement that a term acts on, as a function of the coordinates.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct JointMap {
    /// Channel of the position, where the motion prescribes it.
    pub given: Option<usize>,
    /// Position at zero coordinates, where the motion does not.
    pub offset: f64,
    /// Coordinates and rates; no rate is zero.
    pub rates: Vec<(usize, Rate)>,
}

impl JointMap {
    pub(crate) fn linear(offset: f64, rates: impl IntoIterator<Item = (usize, f64)>) -> JointMap {
        let rates = rates.into_iter().filter(|r| r.1 != 0.0).map(|(a, rate)| (a, Rate::Constant(rate))).collect();
        JointMap { given: None, offset, rates }
    }

    /// The map of a joint that a motion prescribes: channel `next` is its position; its given rates and their
    /// derivatives follow. Returns the first channel after them.
    pub(crate) fn given(next: usize, rates: &[f64], given: &[bool]) -> (JointMap, usize) {
        let count = given.iter().filter(|&&g| g).count();
        let mut rate = next + 1;
        let mut found = Vec::new();
        for (a, (&constant, &given)) in rates.iter().zip(given).enumerate() {
            if given {
                found.push((a, Rate::Varying { rate, derivative: rate + count }));
                rate += 1;
            } else if constant != 0.0 {
                found.push((a, Rate::Constant(constant)));
            }
        }
        (JointMap { given: Some(next), offset: 0.0, rates: found }, rate + count)
    }

    /// The rate with respect to a coordinate.
    pub(crate) fn rate(&self, coordinate: usize) -> Rate {
        self.rates.iter().find(|r| r.0 == coordinate).map_or(Rate::Constant(0.0), |r| r.1)
    }
}
