//! Mechanisms and motions that the tests share.

use haptid_core::{Backend, Closure, Joint, Law, Mechanism, Motion, Term};

/// Samples of a motion: three batches, of which the last is neither full nor made of whole lanes.
pub const SAMPLES: usize = 77;

/// Inertial parameters of a body whose mass matrix is positive definite.
pub const BODY: [f64; 10] = [0.3, 0.01, -0.02, 0.3, 0.03, 0.3, 0.1, -0.2, 0.15, 1.5];

/// Four joints of a tree, one prismatic and one with its axis through the parent's origin, with all special cases of the
/// constant rotation.
pub fn joints() -> Vec<Joint> {
    let (s, c) = 0.4_f64.sin_cos();
    let rotations = [
        [c, -s, 0.0, s, c, 0.0, 0.0, 0.0, 1.0],
        [1.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 1.0, 0.0],
        [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, -1.0, 0.0],
        [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
    ];
    let joint = |i: usize| Joint {
        parent: [None, Some(0), Some(1), Some(1)][i],
        rotation: rotations[i],
        translation: if i == 2 { [0.0; 3] } else { [0.1, -0.2, 0.3] },
        prismatic: i == 1,
    };
    (0..4).map(joint).collect()
}

/// The tree of [`joints`], every joint a coordinate, without terms.
pub fn tree(backend: Backend) -> Mechanism {
    Mechanism::new(&joints(), &Closure::open(4), [0.0, 1.0, -9.81], &[], backend).expect("a tree")
}

/// The same links closed to three coordinates, with one term of every law that is smooth. Two rates of the last joint
/// vary, if `varying`: the motion prescribes it.
pub fn closed_chain(backend: Backend, varying: bool) -> Mechanism {
    let rates = vec![1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.5, 0.0, -1.0];
    let mut given = Vec::new();
    if varying {
        given.resize(12, false);
        (given[9], given[10]) = (true, true);
    }
    let closure = Closure { rates, offset: vec![0.1; 4], given };
    let laws = [
        Law::Rotor,
        Law::Viscous,
        Law::Coulomb { width: 0.2 },
        Law::CoulombForward { width: 0.3 },
        Law::CoulombBackward { width: 0.3 },
        Law::Stribeck { velocity: 0.8, exponent: 1.5, width: 0.2 },
        Law::Offset,
        Law::Spring { rest: 0.3 },
        Law::External,
    ];
    let term = |law| Term { law, weights: vec![(0, 1.0), (2, -0.5)], offset: 0.2, joint: varying.then_some(3) };
    Mechanism::new(&joints(), &closure, [0.0, 1.0, -9.81], &laws.map(term), backend).expect("a closed chain")
}

/// Channels of a motion of [`closed_chain`], one after the other.
#[derive(Clone)]
pub struct Channels {
    pub numbers: Vec<f64>,
    pub samples: usize,
    loops: usize,
}

impl Channels {
    pub fn new(samples: usize, varying: bool) -> Channels {
        // Position, two rates and their two derivatives of the joint that the motion prescribes.
        let loops = if varying { 5 } else { 0 };
        let at = |k: usize| (k as f64 * 0.37 + 0.1).sin() + 0.3 * (k as f64 * 1.93).cos();
        Channels { numbers: (0..(10 + loops) * samples).map(at).collect(), samples, loops }
    }

    pub fn motion(&self, accelerations: bool) -> Motion<'_> {
        let n = self.samples;
        let part = |first: usize, many: usize| &self.numbers[first * n..(first + many) * n];
        Motion {
            samples: n,
            position: part(0, 3),
            velocity: part(3, 3),
            acceleration: accelerations.then_some(part(6, 3)),
            external: part(9, 1),
            loops: part(10, self.loops),
        }
    }
}

/// Parameters of [`closed_chain`].
pub fn parameters() -> Vec<f64> {
    BODY.repeat(4).into_iter().chain([0.2, 0.5, 0.3, 0.1, 0.15, 0.25, 0.4, 3.0, 0.7]).collect()
}

/// Numbers agree, relative to the largest of them.
#[track_caller]
pub fn assert_close(got: &[f64], wanted: &[f64], tolerance: f64, what: &str) {
    assert_eq!(got.len(), wanted.len(), "{what}");
    let size = wanted.iter().fold(1.0_f64, |most, x| most.max(x.abs()));
    for (k, (got, wanted)) in got.iter().zip(wanted).enumerate() {
        assert!((got - wanted).abs() <= tolerance * size, "{what} at {k}: {got}, not {wanted}");
    }
}
