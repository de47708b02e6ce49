//! Inverse and forward dynamics against the regressor, and against each other.

use crate::mechanisms::{Channels, SAMPLES, assert_close, closed_chain, parameters};
use haptid_core::{Backend, forward_dynamics, inverse_dynamics, mass_matrix, regressor};

#[test]
fn torques_are_rows_times_parameters_and_forward_dynamics_inverts_them() {
    let chi = parameters();
    let columns: Vec<usize> = (0..chi.len()).collect();
    for backend in Backend::available() {
        for (varying, accelerations) in [(false, true), (false, false), (true, true), (true, false)] {
            let (mechanism, channels) = (closed_chain(backend, varying), Channels::new(SAMPLES, varying));
            let (motion, what) = (channels.motion(accelerations), format!("{backend:?}, varying: {varying}"));
            let rows = motion.sets() * 3;
            let (mut y, mut torque) = (vec![0.0; rows * chi.len() * SAMPLES], vec![0.0; rows * SAMPLES]);
            regressor(&mechanism, &motion, &columns, &mut y).expect("shapes");
            inverse_dynamics(&mechanism, &motion, &chi, &mut torque).expect("shapes");
            let entry = |row: usize, k: usize| -> f64 {
                chi.iter().enumerate().map(|(c, x)| x * y[(row * chi.len() + c) * SAMPLES + k]).sum()
            };
            let wanted: Vec<f64> = (0..rows * SAMPLES).map(|at| entry(at / SAMPLES, at % SAMPLES)).collect();
            assert_close(&torque, &wanted, 1e-12, &what);
            if let Some(acceleration) = motion.acceleration {
                let mut back = vec![0.0; 3 * SAMPLES];
                let singular = forward_dynamics(&mechanism, &motion, &torque, &chi, &mut back).expect("shapes");
                assert_eq!(singular, None, "{what}");
                assert_close(&back, acceleration, 1e-11, &what);
            }
        }
    }
}

/// The difference of torques at two accelerations is M times their difference.
#[test]
fn the_mass_matrix_is_the_torque_of_unit_accelerations() {
    let chi = parameters();
    for backend in Backend::available() {
        let (mechanism, channels) = (closed_chain(backend, true), Channels::new(SAMPLES, true));
        let torque = |acceleration: &[f64]| {
            let motion = haptid_core::Motion { acceleration: Some(acceleration), ..channels.motion(true) };
            let mut torque = vec![0.0; 3 * SAMPLES];
            inverse_dynamics(&mechanism, &motion, &chi, &mut torque).expect("shapes");
            torque
        };
        let mut mass = vec![0.0; 9 * SAMPLES];
        mass_matrix(&mechanism, &channels.motion(true), &chi, &mut mass).expect("shapes");
        let bias = torque(&[0.0; 3 * SAMPLES]);
        for b in 0..3 {
            let mut unit = [0.0; 3 * SAMPLES];
            unit[b * SAMPLES..][..SAMPLES].fill(1.0);
            let with = torque(&unit);
            let column: Vec<f64> = with.iter().zip(&bias).map(|(with, bias)| with - bias).collect();
            let got: Vec<f64> = (0..3 * SAMPLES).map(|at| mass[(at % SAMPLES * 3 + at / SAMPLES) * 3 + b]).collect();
            assert_close(&got, &column, 1e-12, &format!("{backend:?}, coordinate {b}"));
        }
    }
}

#[test]
fn a_mass_matrix_that_is_not_positive_definite_is_reported() {
    let (channels, mut chi) = (Channels::new(SAMPLES, false), parameters());
    chi.iter_mut().for_each(|x| *x = -*x);
    for backend in Backend::available() {
        let mechanism = closed_chain(backend, false);
        let (torque, mut out) = (vec![0.0; 3 * SAMPLES], vec![0.0; 3 * SAMPLES]);
        let singular = forward_dynamics(&mechanism, &channels.motion(false), &torque, &chi, &mut out).expect("shapes");
        assert_eq!(singular, Some(0), "{backend:?}");
    }
}

/// Samples are divided among sets of parameters evenly, in order.
#[test]
fn several_sets_of_parameters_are_each_evaluated_at_their_own_samples() {
    let (one, other) = (parameters(), parameters().iter().map(|x| 2.0 * x).collect::<Vec<f64>>());
    let both: Vec<f64> = one.iter().chain(&other).copied().collect();
    for backend in Backend::available() {
        let (mechanism, channels) = (closed_chain(backend, false), Channels::new(2 * SAMPLES, false));
        let torque = |chi: &[f64]| {
            let mut out = vec![0.0; 3 * 2 * SAMPLES];
            inverse_dynamics(&mechanism, &channels.motion(true), chi, &mut out).expect("shapes");
            out
        };
        let (first, second, got) = (torque(&one), torque(&other), torque(&both));
        for (k, got) in got.iter().enumerate() {
            let wanted = if k % (2 * SAMPLES) < SAMPLES { first[k] } else { second[k] };
            assert_eq!(*got, wanted, "{backend:?} at {k}");
        }
    }
}
