//! Laws of the end effector: its Jacobian is that of a point mass, apparent masses are what rates at unit speed feel.

use crate::few;
use crate::mechanisms::{Channels, Parts, apart, moving};
use haptid_core::{
    ApparentMassQuery, Backend, EndEffector, Mechanism, apparent_mass, end_effector_dynamics, extreme_eigenvalues,
    mass_matrix,
};
use proptest::collection::vec;
use proptest::prelude::*;

/// Condition number of a Jacobian, and of a mass matrix, up to which a law is held to [`NEAR`].
const WORST: f64 = 1e3;
const NEAR: f64 = 1e-8;

/// Mass matrices, samples x coordinates x coordinates.
fn mass(mechanism: &Mechanism, channels: &Channels, chi: &[f64]) -> Vec<f64> {
    let mut out = vec![f64::NAN; channels.position.len() * mechanism.coordinates()];
    mass_matrix(mechanism, &channels.motion(false), chi, &mut out).expect("shapes");
    out
}

/// All six rows of the Jacobian and the mass matrix of every pose, rows x coordinates and coordinates x coordinates.
fn dynamics(mechanism: &Mechanism, channels: &Channels, end: &EndEffector, chi: &[f64]) -> Vec<(Vec<f64>, Vec<f64>)> {
    let na = mechanism.coordinates();
    let width = (6 + na) * na;
    let mut out = vec![f64::NAN; channels.samples * width];
    end_effector_dynamics(mechanism, &channels.motion(false), end, chi, &[0, 1, 2, 3, 4, 5], &mut out).expect("shapes");
    out.chunks_exact(width).map(|row| (row[..6 * na].to_vec(), row[6 * na..].to_vec())).collect()
}

/// Row-major products A B of matrices with `inner` columns and rows.
fn times(a: &[f64], b: &[f64], inner: usize) -> Vec<f64> {
    let (rows, columns) = (a.len() / inner, b.len() / inner);
    let entry = |at: usize| (0..inner).map(|k| a[at / columns * inner + k] * b[k * columns + at % columns]).sum();
    (0..rows * columns).map(entry).collect()
}

fn transposed(a: &[f64], columns: usize) -> Vec<f64> {
    let rows = a.len() / columns;
    (0..a.len()).map(|at| a[at % rows * columns + at / rows]).collect()
}

/// The solution of A x = b, A positive definite, by Gauss's elimination.
fn solved(a: &[f64], b: &[f64]) -> Vec<f64> {
    let n = b.len();
    let (mut a, mut x) = (a.to_vec(), b.to_vec());
    for k in 0..n {
        for i in k + 1..n {
            let share = a[i * n + k] / a[k * n + k];
            (k..n).for_each(|j| a[i * n + j] -= share * a[k * n + j]);
            x[i] -= share * x[k];
        }
    }
    for k in (0..n).rev() {
        let rest: f64 = (k + 1..n).map(|j| a[k * n + j] * x[j]).sum();
        x[k] = (x[k] - rest) / a[k * n + k];
    }
    x
}

/// Largest by smallest eigenvalue of a Gram matrix; infinite where there is none above zero.
fn extent(gram: &[f64], n: usize) -> f64 {
    let [low, high] = extreme_eigenvalues(Backend::named("portable").expect("is everywhere"), gram, n).expect("shapes");
    if low > 0.0 { high / low } else { f64::INFINITY }
}

/// An end effector of some link.
fn end_effector(parts: &Parts, link: prop::sample::Index, point: &[f64]) -> EndEffector {
    EndEffector { link: link.index(parts.joints.len()), point: [point[0], point[1], point[2]] }
}

proptest! {
    #![proptest_config(few())]

    /// J'J of the linear rows is the mass matrix of a unit mass at the point, and of the angular rows that of a body
    /// without mass whose inertia is one about every axis.
    #[test]
    fn the_jacobian_is_that_of_a_point_mass(
        (parts, channels) in moving(true), link: prop::sample::Index, point in vec(-0.5..0.5, 3),
    ) {
        let (end, na) = (end_effector(&parts, link, &point), parts.coordinates());
        let [x, y, z] = end.point;
        let point_mass = [y * y + z * z, -x * y, -x * z, x * x + z * z, -y * z, x * x + y * y, x, y, z, 1.0];
        let bodies = [point_mass, [1., 0., 0., 1., 0., 1., 0., 0., 0., 0.]];
        for backend in Backend::available() {
            let mechanism = parts.made(backend);
            for (half, body) in bodies.iter().enumerate() {
                let mut chi = vec![0.0; parts.chi.len()];
                chi[10 * end.link..][..10].copy_from_slice(body);
                let wanted = mass(&mechanism, &channels, &chi);
                for ((jacobian, _), wanted) in dynamics(&mechanism, &channels, &end, &chi).iter().zip(wanted.chunks(na * na)) {
                    let rows = &jacobian[half * 3 * na..][..3 * na];
                    let got = times(&transposed(rows, na), rows, 3);
                    let error = if wanted.iter().all(|&x| x == 0.0) { got.iter().map(|x| x.abs()).sum() } else { apart(&got, wanted) };
                    prop_assert!(error < 1e-12, "{:?}: {}", backend, error);
                }
            }
        }
    }

    /// Rates w = m A^-1 J' v move the end effector at unit speed along v, a mass's direction, with twice the energy of
    /// that mass; masses descend; they vary with parameters as the energy does.
    #[test]
    fn apparent_masses_are_felt_at_unit_speed(
        (parts, channels) in moving(true),
        link: prop::sample::Index,
        point in vec(-0.5..0.5, 3),
        rows in prop::sample::subsequence(vec![0_usize, 1, 2, 3, 4, 5], 1..=6),
        doubt in vec(-0.1..0.1, 60),
    ) {
        let (end, na, n) = (end_effector(&parts, link, &point), parts.coordinates(), channels.samples);
        let free: Vec<usize> = (0..na).collect();
        let (m, columns) = (rows.len(), parts.chi.len());
        let spread: Vec<f64> = (0..2 * columns).map(|k| doubt[k % doubt.len()]).collect();
        let query = ApparentMassQuery {
            rows: &rows, free: &free, max_condition: WORST, covariance_factor: &spread, factor_columns: 2,
        };
        for backend in Backend::available() {
            let mechanism = parts.made(backend);
            let poses = dynamics(&mechanism, &channels, &end, &parts.chi);
            let varied = transposed(&spread, 2);
            let changes: Vec<Vec<f64>> = varied.chunks_exact(columns).map(|chi| mass(&mechanism, &channels, chi)).collect();
            let found = apparent_mass(&mechanism, &channels.motion(false), &end, &parts.chi, &query).expect("shapes");
            let (r, pairs) = (query.masses(), query.pairs());
            for k in 0..n {
                let (jacobian, a) = &poses[k];
                let jacobian: Vec<f64> = rows.iter().flat_map(|&row| jacobian[row * na..][..na].to_vec()).collect();
                let across = transposed(&jacobian, na);
                let wanted = if m <= na { extent(&times(&jacobian, &across, na), m) } else { extent(&times(&across, &jacobian, m), na) };
                if found.condition[k] < WORST {
                    prop_assert!((found.condition[k].powi(2) / wanted - 1.0).abs() < NEAR, "{:?}: {} and {}", backend, found.condition[k], wanted);
                } else {
                    prop_assert!(wanted.sqrt() > 0.9 * WORST && found.masses[k * r].is_nan(), "{:?}", backend);
                    continue;
                }
                if found.masses[k * r].is_nan() || extent(a, na) > WORST {
                    continue;
                }
                let (masses, directions) = (&found.masses[k * r..][..r], &found.directions[k * r * m..][..r * m]);
                prop_assert!(masses.is_sorted_by(|a, b| a >= b), "{:?}: {:?}", backend, masses);
                let mut derivatives = Vec::new();
                for (mass, v) in masses.iter().zip(directions.chunks_exact(m)) {
                    let w: Vec<f64> = solved(a, &times(&across, v, m)).iter().map(|x| mass * x).collect();
                    let error = apart(&times(&jacobian, &w, na), v);
                    prop_assert!(error < NEAR, "{:?}: speed by {}", backend, error);
                    let energy = |matrix: &[f64]| times(&w, &times(matrix, &w, na), na)[0];
                    prop_assert!((energy(a) / mass - 1.0).abs() < NEAR, "{:?}: {} and {}", backend, energy(a), mass);
                    derivatives.push(changes.iter().map(|change| energy(&change[k * na * na..][..na * na])).collect::<Vec<f64>>());
                }
                let all = (0..r).flat_map(|i| (i..r).map(move |j| (i, j)));
                let inner = |(i, j): (usize, usize)| derivatives[i].iter().zip(&derivatives[j]).map(|(x, y)| x * y).sum::<f64>();
                let error = apart(&found.covariance[k * pairs..][..pairs], &all.map(inner).collect::<Vec<f64>>());
                prop_assert!(error < NEAR, "{:?}: covariance by {}", backend, error);
            }
        }
    }
}
