//! Gradients against central differences, for every channel, term law and back end.

use crate::mechanisms::{Channels, assert_close, closed_chain, parameters};
use haptid_core::{
    Backend, Mechanism, gram_matrix, inverse_dynamics, quadratic_form_gradients, regressor, torque_gradients,
};

const SAMPLES: usize = 45;
const STEP: f64 = 1e-6;

/// Derivatives of what `evaluate` gives (values x samples) by every channel: (values x channels x samples).
fn differences(channels: &Channels, evaluate: impl Fn(&Channels) -> Vec<f64>) -> Vec<f64> {
    let (n, many) = (channels.samples, channels.numbers.len() / channels.samples);
    let values = evaluate(channels).len() / n;
    let mut out = vec![0.0; values * many * n];
    for c in 0..many {
        let shifted = |by: f64| {
            let mut shifted = channels.clone();
            shifted.numbers[c * n..][..n].iter_mut().for_each(|x| *x += by);
            evaluate(&shifted)
        };
        let (ahead, behind) = (shifted(STEP), shifted(-STEP));
        for value in 0..values {
            for k in 0..n {
                let at = value * n + k;
                out[(value * many + c) * n + k] = (ahead[at] - behind[at]) / (2.0 * STEP);
            }
        }
    }
    out
}

#[test]
fn gradients_of_torques_are_those_of_differences() {
    let chi = parameters();
    let columns: Vec<usize> = (0..chi.len()).collect();
    for (backend, varying) in Backend::available().into_iter().flat_map(|b| [(b, false), (b, true)]) {
        let (mechanism, channels) = (closed_chain(backend, varying), Channels::new(SAMPLES, varying));
        let wanted = differences(&channels, |channels| {
            let mut torque = vec![0.0; 3 * SAMPLES];
            inverse_dynamics(&mechanism, &channels.motion(true), &chi, &mut torque).expect("shapes");
            torque
        });
        let mut got = vec![0.0; wanted.len()];
        torque_gradients(&mechanism, &channels.motion(true), &columns, &chi, &mut got).expect("shapes");
        assert_close(&got, &wanted, 1e-8, &format!("{backend:?}, varying: {varying}"));
    }
}

/// Entries of the chosen columns, rows x columns x samples.
fn entries(mechanism: &Mechanism, channels: &Channels, columns: &[usize]) -> Vec<f64> {
    let mut y = vec![0.0; 3 * columns.len() * channels.samples];
    regressor(mechanism, &channels.motion(true), columns, &mut y).expect("shapes");
    y
}

/// Factors of the entries, rows x columns: no row is as another, and one is left out.
fn factors(p: usize) -> Vec<f64> {
    (0..3 * p).map(|k| if k / p == 1 { 0.0 } else { 1.0 + (k as f64 * 0.37).sin() }).collect()
}

#[test]
fn gradients_of_quadratic_forms_are_those_of_differences() {
    let columns = [5, 6, 13, 17, 19, 27, 33, 39, 40, 42, 45, 47, 48];
    let p = columns.len();
    let form: Vec<f64> = (0..p * p).map(|k| (k as f64 * 0.71).sin()).collect();
    let factors = factors(p);
    for (backend, varying) in Backend::available().into_iter().flat_map(|b| [(b, false), (b, true)]) {
        let (mechanism, channels) = (closed_chain(backend, varying), Channels::new(SAMPLES, varying));
        let wanted = differences(&channels, |channels| {
            let y = entries(&mechanism, channels, &columns);
            let sum = |k: usize| -> f64 {
                let term = |at: usize| {
                    let (row, i, j) = (at / (p * p), at / p % p, at % p);
                    let entry = |c: usize| factors[row * p + c] * y[(row * p + c) * SAMPLES + k];
                    form[i * p + j] * entry(i) * entry(j)
                };
                (0..3 * p * p).map(term).sum()
            };
            (0..SAMPLES).map(sum).collect()
        });
        let mut got = vec![0.0; wanted.len()];
        quadratic_form_gradients(&mechanism, &channels.motion(true), &columns, &form, &factors, &mut got)
            .expect("shapes");
        assert_close(&got, &wanted, 1e-8, &format!("{backend:?}, varying: {varying}"));
    }
}

#[test]
fn the_gram_matrix_has_the_products_of_the_columns() {
    // Not in order: rows come to their columns by index.
    let columns = [48, 5, 6, 13, 17, 39, 19, 27, 33, 40, 42, 45, 47];
    let p = columns.len();
    let factors = factors(p);
    for backend in Backend::available() {
        // More samples than one part has.
        let (mechanism, channels) = (closed_chain(backend, true), Channels::new(4001, true));
        let y = entries(&mechanism, &channels, &columns);
        let mut got = vec![f64::NAN; p * p];
        gram_matrix(&mechanism, &channels.motion(true), &columns, &factors, &mut got).expect("shapes");
        let run = |row: usize, c: usize| &y[(row * p + c) * channels.samples..][..channels.samples];
        let product = |row: usize, i: usize, j: usize| -> f64 {
            let inner: f64 = run(row, i).iter().zip(run(row, j)).map(|(x, y)| x * y).sum();
            factors[row * p + i] * factors[row * p + j] * inner
        };
        let sum = |at: usize| -> f64 { (0..3).map(|row| product(row, at / p, at % p)).sum() };
        let wanted: Vec<f64> = (0..got.len()).map(sum).collect();
        assert_close(&got, &wanted, 1e-12, &format!("{backend:?}"));
    }
}
