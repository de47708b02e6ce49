//! One kernel on synthetic samples, for timing or for counting instructions:
//! `kernel WORK SAMPLES REPEATS [BACKEND]` prints the microseconds per sample of the fastest repeat.
//!
//! WORK is a mechanism and what is done with it: `arm` (7 joints, 43 base columns) or `loop` (9 links, 3 coordinates,
//! 29 base columns), then `-regressor`, `-reduce`, `-filter` (41 taps, every tenth row), `-momentum` (the same without
//! accelerations), `-gram` (the Gram matrix), `-form` (gradients of a quadratic form), `-torque`, `-mass`,
//! `-acceleration` or `-felt` (apparent masses), the last four of given parameters.

use haptid_core::{
    ApparentMassQuery, Backend, Closure, EndEffector, Joint, Mechanism, Motion, Reduction, apparent_mass,
    forward_dynamics, gram_matrix, inverse_dynamics, mass_matrix, quadratic_form_gradients, reduce, regressor,
};
use std::time::Instant;

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [work, samples, repeats, rest @ ..] = &arguments[..] else { panic!("kernel WORK SAMPLES REPEATS [BACKEND]") };
    let number = |text: &str| text.parse::<usize>().expect("a whole number");
    let (samples, repeats) = (number(samples), number(repeats));
    let backend = rest.first().map_or_else(Backend::selected, |name| Backend::named(name)).expect("a backend");
    let (device, work) = work.split_once('-').expect("MECHANISM-WORK");
    let (mechanism, columns) = if device == "arm" { arm(backend) } else { closed_chain(backend) };
    let numbers = Numbers::new(mechanism.coordinates(), samples);
    let mut run: Box<dyn FnMut()> = match work {
        "regressor" => {
            let mut out = vec![0.0; mechanism.coordinates() * columns.len() * samples];
            let motion = numbers.motion(true);
            let (mechanism, columns) = (&mechanism, &columns);
            Box::new(move || regressor(mechanism, &motion, columns, &mut out).expect("shapes"))
        }
        "gram" | "form" => searching(work, &mechanism, &columns, numbers.motion(true)),
        "felt" => felt(&mechanism, &numbers),
        "reduce" => reducing(&mechanism, &columns, numbers.motion(true), &numbers, &[1.0], 1),
        "filter" => reducing(&mechanism, &columns, numbers.motion(true), &numbers, &[1.0 / 41.0; 41], 10),
        "momentum" => reducing(&mechanism, &columns, numbers.motion(false), &numbers, &[1.0 / 41.0; 41], 10),
        _ => dynamics(work, &mechanism, &numbers),
    };
    let fastest = (0..repeats).map(|_| seconds(&mut run)).fold(f64::INFINITY, f64::min);
    println!("{}", fastest * 1e6 / samples.max(1) as f64);
}

fn seconds(run: &mut dyn FnMut()) -> f64 {
    let begin = Instant::now();
    run();
    begin.elapsed().as_secs_f64()
}

fn reducing<'a>(
    mechanism: &'a Mechanism,
    columns: &'a [usize],
    motion: Motion<'a>,
    numbers: &'a Numbers,
    taps: &'static [f64],
    decimation: usize,
) -> Box<dyn FnMut() + 'a> {
    let rows = (motion.samples + decimation - taps.len()) / decimation;
    let derivative_taps = if motion.acceleration.is_some() { &[][..] } else { taps };
    let reduction = Reduction {
        columns,
        torque: &numbers.torque,
        taps,
        derivative_taps,
        decimation,
        first: taps.len() / 2,
        rows,
        block: rows.max(1),
        weights: &[],
    };
    Box::new(move || drop(reduce(mechanism, &motion, &reduction).expect("shapes")))
}

/// What a search for a motion asks.
fn searching<'a>(
    work: &str,
    mechanism: &'a Mechanism,
    columns: &'a [usize],
    motion: Motion<'a>,
) -> Box<dyn FnMut() + 'a> {
    let (na, p) = (mechanism.coordinates(), columns.len());
    let factors = vec![1.0; na * p];
    let mut gram = vec![0.0; p * p];
    if work == "gram" {
        return Box::new(move || gram_matrix(mechanism, &motion, columns, &factors, &mut gram).expect("shapes"));
    }
    gram.iter_mut().enumerate().for_each(|(k, x)| *x = (k as f64).sin());
    let mut out = vec![0.0; mechanism.channels() * motion.samples];
    Box::new(move || {
        quadratic_form_gradients(mechanism, &motion, columns, &gram, &factors, &mut out).expect("shapes");
    })
}

/// Masses at a point of the last link, of bodies with isotropic inertia.
fn felt<'a>(mechanism: &'a Mechanism, numbers: &'a Numbers) -> Box<dyn FnMut() + 'a> {
    let (links, free): (usize, Vec<usize>) = (mechanism.columns() / 10, (0..mechanism.coordinates()).collect());
    let chi = [0.1, 0.0, 0.0, 0.1, 0.0, 0.1, 0.0, 0.0, 0.0, 1.0].repeat(links);
    let poses = numbers.motion(false);
    Box::new(move || {
        let end_effector = EndEffector { link: links - 1, point: [0.0, 0.0, 0.1] };
        let query = ApparentMassQuery {
            rows: &[0, 1, 2],
            free: &free,
            max_condition: 1e9,
            covariance_factor: &[],
            factor_columns: 0,
        };
        drop(apparent_mass(mechanism, &poses, &end_effector, &chi, &query).expect("shapes"));
    })
}

/// Dynamics of bodies with isotropic inertia.
fn dynamics<'a>(work: &str, mechanism: &'a Mechanism, numbers: &'a Numbers) -> Box<dyn FnMut() + 'a> {
    let chi = [0.1, 0.0, 0.0, 0.1, 0.0, 0.1, 0.0, 0.0, 0.0, 1.0].repeat(mechanism.columns() / 10);
    let (na, motion) = (mechanism.coordinates(), numbers.motion(true));
    let mut out = vec![0.0; na * na * motion.samples];
    match work {
        "torque" => {
            out.truncate(na * motion.samples);
            Box::new(move || inverse_dynamics(mechanism, &motion, &chi, &mut out).expect("shapes"))
        }
        "mass" => Box::new(move || mass_matrix(mechanism, &motion, &chi, &mut out).expect("shapes")),
        "acceleration" => {
            out.truncate(na * motion.samples);
            let mut run =
                move || forward_dynamics(mechanism, &motion, &numbers.torque, &chi, &mut out).expect("shapes");
            Box::new(move || assert!(run().is_none()))
        }
        _ => panic!("unknown work {work}"),
    }
}

/// Numbers between -2 and 2, the same on every machine.
struct Numbers {
    samples: usize,
    position: Vec<f64>,
    velocity: Vec<f64>,
    acceleration: Vec<f64>,
    torque: Vec<f64>,
}

impl Numbers {
    fn new(coordinates: usize, samples: usize) -> Numbers {
        let mut state = 0x9E37_79B9_7F4A_7C15_u64;
        let mut next = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 11) as f64 / (1u64 << 51) as f64 - 2.0
        };
        let mut some = || (0..coordinates * samples).map(|_| next()).collect();
        Numbers { samples, position: some(), velocity: some(), acceleration: some(), torque: some() }
    }

    fn motion(&self, accelerations: bool) -> Motion<'_> {
        Motion {
            samples: self.samples,
            position: &self.position,
            velocity: &self.velocity,
            acceleration: accelerations.then_some(&self.acceleration),
            external: &[],
            loops: &[],
        }
    }
}

const STRAIGHT: [f64; 9] = [1., 0., 0., 0., 1., 0., 0., 0., 1.];
const UP: [f64; 9] = [1., 0., 0., 0., 0., -1., 0., 1., 0.];
const DOWN: [f64; 9] = [1., 0., 0., 0., 0., 1., 0., -1., 0.];
const GRAVITY: [f64; 3] = [0.0, 0.0, -9.81];

fn joint(parent: Option<usize>, rotation: [f64; 9], translation: [f64; 3]) -> Joint {
    Joint { parent, rotation, translation, prismatic: false }
}

/// A chain of seven joints whose base parameters are 43 of the columns of link inertia.
fn arm(backend: Backend) -> (Mechanism, Vec<usize>) {
    let joints = [
        joint(None, STRAIGHT, [0.0, 0.0, 0.36]),
        joint(Some(0), DOWN, [0.03, 0.0, 0.0]),
        joint(Some(1), UP, [0.02, -0.42, 0.0]),
        joint(Some(2), UP, [0.025, 0.0, 0.0]),
        joint(Some(3), DOWN, [-0.02, 0.4, 0.0]),
        joint(Some(4), DOWN, [0.015, 0.0, 0.0]),
        joint(Some(5), UP, [0.08, -0.126, 0.0]),
    ];
    let kept = [0, 1, 2, 4, 5, 6, 7];
    let columns = std::iter::once(5).chain((1..7).flat_map(|i| kept.map(|p| 10 * i + p))).collect();
    let mechanism = Mechanism::new(&joints, &Closure::open(7), GRAVITY, &[], backend).expect("an arm");
    (mechanism, columns)
}

/// A rotating column that carries two parallelograms in a row: nine links, three coordinates.
fn closed_chain(backend: Backend) -> (Mechanism, Vec<usize>) {
    let parents = [None, Some(0), Some(1), Some(0), Some(3), Some(2), Some(1), Some(6), Some(5)];
    let rates = [
        [1., 0., 0.],
        [0., 1., 0.],
        [0., -1., 1.],
        [0., 0., 1.],
        [0., 1., -1.],
        [0., 0., -1.],
        [0., -1., 1.],
        [0., 0., -1.],
        [0., 1., 0.],
    ];
    let place = |i: usize| [0.11 + 0.02 * i as f64, 0.23 - 0.04 * i as f64, 0.05 * (i % 3) as f64];
    let turn = |i: usize| match i {
        0 => STRAIGHT,
        1 | 3 => UP,
        _ => {
            let (s, c) = (0.3 * i as f64).sin_cos();
            [c, -s, 0., s, c, 0., 0., 0., 1.]
        }
    };
    let joints: Vec<Joint> = (0..9).map(|i| joint(parents[i], turn(i), place(i))).collect();
    let closure = Closure { rates: rates.concat(), offset: vec![0.0; 9], given: Vec::new() };
    let columns = std::iter::once(5)
        .chain((1..3).flat_map(|i| [0, 1, 2, 4, 5, 6, 7].map(|p| 10 * i + p)))
        .chain((3..9).flat_map(|i| [6, 7].map(|p| 10 * i + p)))
        .chain([45, 55])
        .collect();
    let mechanism = Mechanism::new(&joints, &closure, GRAVITY, &[], backend).expect("a closed chain");
    (mechanism, columns)
}
