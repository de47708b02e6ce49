//! Random mechanisms with bodies that can exist, and random motions of them.

use crate::below;
use haptid_core::{Backend, Closure, Joint, Law, Mechanism, Motion, Term};
use proptest::collection::vec;
use proptest::prelude::*;

/// A mechanism in parts, so that it can be made for every back end, with its parameters.
#[derive(Debug, Clone)]
pub struct Parts {
    pub joints: Vec<Joint>,
    pub closure: Closure,
    pub gravity: [f64; 3],
    pub terms: Vec<Term>,
    pub chi: Vec<f64>,
}

impl Parts {
    pub fn made(&self, backend: Backend) -> Mechanism {
        Mechanism::new(&self.joints, &self.closure, self.gravity, &self.terms, backend).expect("a mechanism")
    }

    pub fn coordinates(&self) -> usize {
        self.closure.rates.len() / self.joints.len()
    }

    /// Positions of the joints at coordinates.
    pub fn joint_positions(&self, coordinates: &[f64]) -> Vec<f64> {
        let rows = self.closure.rates.chunks_exact(coordinates.len()).zip(&self.closure.offset);
        rows.map(|(rates, offset)| offset + rates.iter().zip(coordinates).map(|(g, c)| g * c).sum::<f64>()).collect()
    }
}

/// Channels of a motion, coordinates x samples each.
#[derive(Debug, Clone)]
pub struct Channels {
    pub samples: usize,
    pub position: Vec<f64>,
    pub velocity: Vec<f64>,
    pub acceleration: Vec<f64>,
}

impl Channels {
    pub fn motion(&self, accelerations: bool) -> Motion<'_> {
        Motion {
            samples: self.samples,
            position: &self.position,
            velocity: &self.velocity,
            acceleration: accelerations.then_some(&self.acceleration),
            external: &[],
            loops: &[],
        }
    }

    /// The same samples with other velocities and accelerations.
    pub fn with(&self, velocity: Vec<f64>, acceleration: Vec<f64>) -> Channels {
        Channels { velocity, acceleration, ..self.clone() }
    }

    /// One quantity of all coordinates at sample `k`.
    pub fn at(&self, quantity: &[f64], k: usize) -> Vec<f64> {
        quantity.iter().skip(k).step_by(self.samples).copied().collect()
    }
}

/// A rotation matrix: turns about x by quarters, which the kernels have shapes for, or any.
fn rotation() -> impl Strategy<Value = [f64; 9]> {
    let any = (vec(-1.0..1.0, 4)).prop_filter("a direction", |q| q.iter().map(|x| x * x).sum::<f64>() > 0.01);
    let any = any.prop_map(|q| {
        let length = q.iter().map(|x| x * x).sum::<f64>().sqrt();
        let [w, x, y, z] = [0, 1, 2, 3].map(|k| q[k] / length);
        [
            1.0 - 2.0 * (y * y + z * z),
            2.0 * (x * y - w * z),
            2.0 * (x * z + w * y),
            2.0 * (x * y + w * z),
            1.0 - 2.0 * (x * x + z * z),
            2.0 * (y * z - w * x),
            2.0 * (x * z - w * y),
            2.0 * (y * z + w * x),
            1.0 - 2.0 * (x * x + y * y),
        ]
    });
    prop_oneof![
        Just([1., 0., 0., 0., 1., 0., 0., 0., 1.]),
        Just([1., 0., 0., 0., 0., -1., 0., 1., 0.]),
        Just([1., 0., 0., 0., 0., 1., 0., -1., 0.]),
        any
    ]
}

/// Parameters of a body that can exist: a mass at a point, with a positive definite second moment about it.
fn body() -> impl Strategy<Value = Vec<f64>> {
    (0.1..3.0, vec(-0.2..0.2, 3), vec(-0.1..0.1, 9)).prop_map(|(mass, centre, spread): (f64, Vec<f64>, Vec<f64>)| {
        let second = |i: usize, j: usize| {
            let own: f64 = (0..3).map(|k| spread[3 * i + k] * spread[3 * j + k]).sum();
            mass * (own + centre[i] * centre[j] + if i == j { 1e-3 } else { 0.0 })
        };
        let moment = |i: usize, j: usize| if i == j { second(0, 0) + second(1, 1) + second(2, 2) } else { 0.0 };
        let tensor = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)].map(|(i, j)| moment(i, j) - second(i, j));
        tensor.into_iter().chain(centre.iter().map(|x| mass * x)).chain([mass]).collect()
    })
}

fn joints(count: usize) -> impl Strategy<Value = Vec<Joint>> {
    let joint = (any::<prop::sample::Index>(), rotation(), vec(-0.5..0.5, 3), any::<bool>(), prop::bool::weighted(0.3));
    vec(joint, count).prop_map(|joints| {
        let made = joints.into_iter().enumerate().map(|(i, (parent, rotation, shift, moved, prismatic))| Joint {
            // The base, or any link before this one.
            parent: parent.index(i + 1).checked_sub(1),
            rotation,
            translation: if moved { [shift[0], shift[1], shift[2]] } else { [0.0; 3] },
            prismatic,
        });
        made.collect()
    })
}

/// A closure whose first joints are the coordinates; the others follow them.
fn closure(joints: usize, coordinates: usize) -> impl Strategy<Value = Closure> {
    let rate = prop_oneof![Just(0.0), Just(1.0), Just(-1.0), -2.0..2.0];
    (vec(rate, joints * coordinates), vec(-1.0..1.0, joints)).prop_map(move |(mut rates, offset)| {
        for j in 0..coordinates {
            (0..coordinates).for_each(|a| rates[j * coordinates + a] = if a == j { 1.0 } else { 0.0 });
        }
        Closure { rates, offset, given: Vec::new() }
    })
}

/// Any mechanism, with friction, springs and rotors, or without.
pub fn parts(with_terms: bool) -> impl Strategy<Value = Parts> {
    let law = prop::sample::select(vec![
        Law::Rotor,
        Law::Viscous,
        Law::Coulomb { width: 0.2 },
        Law::Stribeck { velocity: 0.8, exponent: 2.0, width: 0.2 },
        Law::Offset,
        Law::Spring { rest: 0.3 },
    ]);
    let terms = vec((law, any::<prop::sample::Index>(), 0.5..2.0, 0.0..1.0), if with_terms { 0..4 } else { 0..1 });
    (1..below(6, 4)).prop_flat_map(|count| (Just(count), 1..=count)).prop_flat_map(move |(count, coordinates)| {
        let gravity = vec(-10.0..10.0, 3);
        (joints(count), closure(count, coordinates), gravity, terms.clone(), vec(body(), count)).prop_map(
            move |(joints, closure, gravity, terms, bodies)| {
                let parameters = terms.iter().map(|&(.., parameter)| parameter);
                let chi = bodies.concat().into_iter().chain(parameters).collect();
                let term = |&(law, at, weight, _): &(Law, prop::sample::Index, f64, f64)| Term {
                    law,
                    weights: vec![(at.index(coordinates), weight)],
                    offset: 0.1,
                    joint: None,
                };
                let terms = terms.iter().map(term).collect();
                Parts { joints, closure, gravity: [gravity[0], gravity[1], gravity[2]], terms, chi }
            },
        )
    })
}

/// A mechanism and a motion of it, at a few samples or more than a batch.
pub fn moving(with_terms: bool) -> impl Strategy<Value = (Parts, Channels)> {
    (parts(with_terms), 1..below(50, 6)).prop_flat_map(|(parts, samples)| {
        let size = parts.coordinates() * samples;
        let channels = (vec(-3.0..3.0, size), vec(-2.0..2.0, size), vec(-5.0..5.0, size));
        let channels = channels.prop_map(move |(position, velocity, acceleration)| Channels {
            samples,
            position,
            velocity,
            acceleration,
        });
        (Just(parts), channels)
    })
}

/// Largest difference, relative to the largest number.
pub fn apart(got: &[f64], wanted: &[f64]) -> f64 {
    assert_eq!(got.len(), wanted.len());
    let size = wanted.iter().fold(f64::MIN_POSITIVE, |most, x| most.max(x.abs()));
    // A difference that is no number is larger than any.
    let difference = |(x, y): (&f64, &f64)| if (x - y).is_nan() { f64::INFINITY } else { (x - y).abs() };
    got.iter().zip(wanted).map(difference).fold(0.0, f64::max) / size
}
