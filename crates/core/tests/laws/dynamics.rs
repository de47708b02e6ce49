//! Laws of dynamics.

use crate::few;
use crate::mechanisms::{Channels, Parts, apart, moving};
use haptid_core::{Backend, Mechanism, forward_dynamics, inverse_dynamics, mass_matrix, regressor};
use proptest::prelude::*;

/// Torques, coordinates x samples; without accelerations momenta, then the remainder of the torques.
fn torque(mechanism: &Mechanism, channels: &Channels, chi: &[f64], accelerations: bool) -> Vec<f64> {
    let motion = channels.motion(accelerations);
    let mut out = vec![f64::NAN; motion.sets() * channels.position.len()];
    inverse_dynamics(mechanism, &motion, chi, &mut out).expect("shapes");
    out
}

/// Mass matrices, samples x coordinates x coordinates.
fn mass(mechanism: &Mechanism, channels: &Channels, chi: &[f64]) -> Vec<f64> {
    let mut out = vec![f64::NAN; channels.position.len() * mechanism.coordinates()];
    mass_matrix(mechanism, &channels.motion(true), chi, &mut out).expect("shapes");
    out
}

/// M x at every sample, coordinates x samples.
fn times(mass: &[f64], channels: &Channels, x: &[f64]) -> Vec<f64> {
    let (n, na) = (channels.samples, x.len() / channels.samples);
    let entry = |at: usize| (0..na).map(|b| mass[((at % n) * na + at / n) * na + b] * x[b * n + at % n]).sum();
    (0..x.len()).map(entry).collect()
}

/// Whether a symmetric matrix is positive definite, by Cholesky's decomposition.
fn is_positive_definite(matrix: &[f64], n: usize) -> bool {
    let mut l = vec![0.0; n * n];
    for i in 0..n {
        for j in 0..=i {
            let rest = matrix[i * n + j] - (0..j).map(|k| l[i * n + k] * l[j * n + k]).sum::<f64>();
            l[i * n + j] = if i == j { rest.sqrt() } else { rest / l[j * n + j] };
        }
    }
    (0..n).all(|i| l[i * n + i] > 0.0)
}

/// Sum of two quantities.
fn sum(x: &[f64], y: &[f64]) -> Vec<f64> {
    x.iter().zip(y).map(|(x, y)| x + y).collect()
}

/// Potential energy of the bodies at coordinates, by the chain of transforms.
fn potential(parts: &Parts, coordinates: &[f64]) -> f64 {
    let q = parts.joint_positions(coordinates);
    let mut frames: Vec<([f64; 9], [f64; 3])> = Vec::new();
    let mut energy = 0.0;
    for (i, joint) in parts.joints.iter().enumerate() {
        let (above, origin) = joint.parent.map_or(([1., 0., 0., 0., 1., 0., 0., 0., 1.], [0.0; 3]), |p| frames[p]);
        let turned = |r: &[f64; 9], v: [f64; 3]| [0, 3, 6].map(|k| r[k] * v[0] + r[k + 1] * v[1] + r[k + 2] * v[2]);
        let product = |a: &[f64; 9], b: &[f64; 9]| -> [f64; 9] {
            core::array::from_fn(|e| (0..3).map(|k| a[e / 3 * 3 + k] * b[3 * k + e % 3]).sum())
        };
        let (s, c) = if joint.prismatic { (0.0, 1.0) } else { q[i].sin_cos() };
        let placed = product(&above, &joint.rotation);
        let slide = turned(&placed, [0.0, 0.0, if joint.prismatic { q[i] } else { 0.0 }]);
        let shift = turned(&above, joint.translation);
        let at: [f64; 3] = core::array::from_fn(|e| origin[e] + shift[e] + slide[e]);
        let frame = (product(&placed, &[c, -s, 0., s, c, 0., 0., 0., 1.]), at);
        let chi = &parts.chi[10 * i..10 * i + 10];
        let first = turned(&frame.0, [chi[6], chi[7], chi[8]]);
        energy -= (0..3).map(|e| parts.gravity[e] * (chi[9] * at[e] + first[e])).sum::<f64>();
        frames.push(frame);
    }
    energy
}

proptest! {
    #![proptest_config(few())]

    /// tau = M qdd + (torques without accelerations), and M is symmetric positive definite.
    #[test]
    fn torques_are_mass_times_acceleration_and_bias((parts, channels) in moving(true)) {
        let size = channels.position.len();
        for backend in Backend::available() {
            let mechanism = parts.made(backend);
            let (whole, mass) = (torque(&mechanism, &channels, &parts.chi, true), mass(&mechanism, &channels, &parts.chi));
            let still = channels.with(channels.velocity.clone(), vec![0.0; size]);
            let bias = torque(&mechanism, &still, &parts.chi, true);
            let wanted = sum(&times(&mass, &channels, &channels.acceleration), &bias);
            prop_assert!(apart(&whole, &wanted) < 1e-12, "{:?}: {}", backend, apart(&whole, &wanted));
            let na = parts.coordinates();
            for of_sample in mass.chunks_exact(na * na) {
                (0..na * na).for_each(|k| assert_eq!(of_sample[k], of_sample[k % na * na + k / na], "{backend:?}"));
                prop_assert!(is_positive_definite(of_sample, na), "{:?}: {:?}", backend, of_sample);
            }
        }
    }

    /// The accelerations of the torques of some accelerations have the same torques.
    #[test]
    fn forward_dynamics_inverts_inverse_dynamics((parts, channels) in moving(true)) {
        for backend in Backend::available() {
            let mechanism = parts.made(backend);
            let given = torque(&mechanism, &channels, &parts.chi, true);
            let mut found = vec![f64::NAN; given.len()];
            let singular = forward_dynamics(&mechanism, &channels.motion(false), &given, &parts.chi, &mut found);
            prop_assert_eq!(singular.expect("shapes"), None);
            let back = torque(&mechanism, &channels.with(channels.velocity.clone(), found), &parts.chi, true);
            // The residual of Cholesky's solution is small whatever the condition of M, relative to |M| |qdd|.
            prop_assert!(apart(&back, &given) < 1e-9, "{:?}: {}", backend, apart(&back, &given));
        }
    }

    /// The power of the torques is the rate of kinetic and potential energy, where nothing dissipates.
    #[test]
    fn power_is_the_rate_of_energy((parts, channels) in moving(false)) {
        const STEP: f64 = 1e-6;
        for backend in Backend::available() {
            let mechanism = parts.made(backend);
            let torque = torque(&mechanism, &channels, &parts.chi, true);
            // q + qd h + qdd h^2 / 2, and qd + qdd h.
            let energies = |h: f64| {
                let along = |x: &[f64], v: &[f64]| x.iter().zip(v).map(|(x, v)| x + v * h).collect::<Vec<f64>>();
                let middle = along(&channels.velocity, &channels.acceleration.iter().map(|a| 0.5 * a).collect::<Vec<_>>());
                let (position, velocity) =
                    (along(&channels.position, &middle), along(&channels.velocity, &channels.acceleration));
                let moved = Channels { position, velocity, ..channels.clone() };
                let momentum = times(&mass(&mechanism, &moved, &parts.chi), &moved, &moved.velocity);
                let energy = |k: usize| -> [f64; 2] {
                    let velocity = moved.at(&moved.velocity, k);
                    let kinetic = velocity.iter().zip(moved.at(&momentum, k)).map(|(v, p)| 0.5 * v * p).sum();
                    [kinetic, potential(&parts, &moved.at(&moved.position, k))]
                };
                (0..channels.samples).map(energy).collect::<Vec<_>>()
            };
            for (k, (ahead, behind)) in energies(STEP).into_iter().zip(energies(-STEP)).enumerate() {
                let products = channels.at(&channels.velocity, k).into_iter().zip(channels.at(&torque, k));
                let powers: Vec<f64> = products.map(|(v, t)| v * t).collect();
                let rate = (ahead[0] - behind[0] + ahead[1] - behind[1]) / (2.0 * STEP);
                let size = powers.iter().chain(&ahead).fold(1.0_f64, |most, x| most.max(x.abs()));
                let error = (powers.iter().sum::<f64>() - rate).abs() / size;
                prop_assert!(error < 1e-5, "{:?}, sample {}: {}", backend, k, error);
            }
        }
    }

    /// Torques, and momenta with the remainder of the torques, are rows times parameters.
    #[test]
    fn torques_are_rows_times_parameters((parts, channels) in moving(true), accelerations: bool) {
        let columns: Vec<usize> = (0..parts.chi.len()).collect();
        let n = channels.samples;
        for backend in Backend::available() {
            let mechanism = parts.made(backend);
            let motion = channels.motion(accelerations);
            let rows = motion.sets() * parts.coordinates();
            let mut y = vec![f64::NAN; rows * columns.len() * n];
            regressor(&mechanism, &motion, &columns, &mut y).expect("shapes");
            let entry = |row: usize, k: usize| -> f64 {
                parts.chi.iter().enumerate().map(|(c, x)| x * y[(row * columns.len() + c) * n + k]).sum()
            };
            let wanted: Vec<f64> = (0..rows * n).map(|at| entry(at / n, at % n)).collect();
            let got = torque(&mechanism, &channels, &parts.chi, accelerations);
            prop_assert!(apart(&got, &wanted) < 1e-12, "{:?}: {}", backend, apart(&got, &wanted));
        }
    }

    /// Momenta are M qd.
    #[test]
    fn momenta_are_mass_times_velocity((parts, channels) in moving(true)) {
        for backend in Backend::available() {
            let mechanism = parts.made(backend);
            let momenta = torque(&mechanism, &channels, &parts.chi, false);
            let wanted = times(&mass(&mechanism, &channels, &parts.chi), &channels, &channels.velocity);
            let error = apart(&momenta[..wanted.len()], &wanted);
            prop_assert!(error < 1e-12, "{:?}: {}", backend, error);
        }
    }
}
