//! Every back end gives what the portable one does, within rounding.

use crate::mechanisms::{apart, moving};
use crate::{below, few};
use haptid_core::{
    Backend, Reduction, forward_dynamics, gram_matrix, inverse_dynamics, mass_matrix, quadratic_form_gradients,
    r_factor, reduce, regressor, torque_gradients,
};
use proptest::collection::vec;
use proptest::prelude::*;

/// Assert that `made` gives on every back end what it gives on the portable one.
fn agree(tolerance: f64, made: impl Fn(Backend) -> Vec<f64>) -> Result<(), TestCaseError> {
    let wanted = made(Backend::named("portable").expect("is everywhere"));
    for backend in Backend::available() {
        let error = apart(&made(backend), &wanted);
        prop_assert!(error <= tolerance, "{:?}: {}", backend, error);
    }
    Ok(())
}

proptest! {
    #![proptest_config(few())]

    #[test]
    fn on_recursions((parts, channels) in moving(true), accelerations: bool) {
        let (na, n, chi) = (parts.coordinates(), channels.samples, &parts.chi);
        let motion = channels.motion(accelerations);
        let columns: Vec<usize> = (0..chi.len()).collect();
        agree(1e-12, |backend| {
            let mut out = vec![f64::NAN; motion.sets() * na * n];
            inverse_dynamics(&parts.made(backend), &motion, chi, &mut out).expect("shapes");
            out
        })?;
        agree(1e-12, |backend| {
            let mut out = vec![f64::NAN; na * na * n];
            mass_matrix(&parts.made(backend), &motion, chi, &mut out).expect("shapes");
            out
        })?;
        agree(1e-12, |backend| {
            let mut out = vec![f64::NAN; motion.sets() * na * columns.len() * n];
            regressor(&parts.made(backend), &motion, &columns, &mut out).expect("shapes");
            out
        })?;
        // A linear system: errors are multiplied by its condition, which the bodies bound.
        agree(1e-7, |backend| {
            let (mut out, torque) = (vec![f64::NAN; na * n], &channels.acceleration);
            let motion = channels.motion(false);
            forward_dynamics(&parts.made(backend), &motion, torque, chi, &mut out).expect("shapes");
            out
        })?;
    }

    #[test]
    fn on_gradients_and_inner_products((parts, channels) in moving(true)) {
        let (na, motion) = (parts.coordinates(), channels.motion(true));
        let columns: Vec<usize> = (0..parts.chi.len()).collect();
        let square = columns.len() * columns.len();
        let factors: Vec<f64> = (0..na * columns.len()).map(|k| 1.0 + (k as f64 * 0.3).sin()).collect();
        agree(1e-12, |backend| {
            let mechanism = parts.made(backend);
            let mut out = vec![f64::NAN; na * mechanism.channels() * motion.samples];
            torque_gradients(&mechanism, &motion, &columns, &parts.chi, &mut out).expect("shapes");
            out
        })?;
        agree(1e-12, |backend| {
            let mut out = vec![f64::NAN; square];
            gram_matrix(&parts.made(backend), &motion, &columns, &factors, &mut out).expect("shapes");
            out
        })?;
        let form: Vec<f64> = (0..square).map(|k| (k as f64 * 0.7).sin()).collect();
        agree(1e-11, |backend| {
            let mechanism = parts.made(backend);
            let mut out = vec![f64::NAN; mechanism.channels() * motion.samples];
            quadratic_form_gradients(&mechanism, &motion, &columns, &form, &factors, &mut out).expect("shapes");
            out
        })?;
    }

    /// Products R'R: R itself is as sensitive as its columns are dependent.
    #[test]
    fn on_reductions((parts, channels) in moving(true), taps in vec(-1.0..1.0, 0..below(4, 2)), block in 1..below(60, 8)) {
        let columns: Vec<usize> = (0..parts.chi.len()).collect();
        let taps: Vec<f64> = taps.iter().copied().chain([1.0]).chain(taps.iter().rev().copied()).collect();
        prop_assume!(taps.len() <= channels.samples);
        let reduction = Reduction {
            columns: &columns,
            torque: &channels.acceleration,
            taps: &taps,
            derivative_taps: &[],
            decimation: 1,
            first: taps.len() / 2,
            rows: channels.samples + 1 - taps.len(),
            block,
            weights: &[],
        };
        agree(1e-12, |backend| {
            let made = reduce(&parts.made(backend), &channels.motion(true), &reduction).expect("shapes");
            let gram = |(r, size): (&Vec<f64>, usize)| -> Vec<f64> {
                let entry = |at: usize| (0..size).map(|k| r[k * size + at / size] * r[k * size + at % size]).sum();
                (0..size * size).map(entry).collect()
            };
            let blocks = made.iter().flat_map(|motor| motor.blocks.iter().map(|r| (r, motor.columns.len() + 1)));
            blocks.flat_map(gram).collect()
        })?;
    }

    #[test]
    fn on_r_factors(columns in 1_usize..14, numbers in vec(-1.0..1.0, 0..below(700, 60))) {
        let rows = &numbers[..numbers.len() / columns * columns];
        agree(1e-13, |backend| {
            let mut r = vec![f64::NAN; columns * columns];
            r_factor(backend, rows, columns, &mut r).expect("shapes");
            (0..columns * columns)
                .map(|at| (0..columns).map(|k| r[k * columns + at / columns] * r[k * columns + at % columns]).sum())
                .collect()
        })?;
    }
}
