//! The choice of a back end, and the agreement of all of them with the portable one.

use crate::mechanisms::{Channels, SAMPLES, assert_close, closed_chain, parameters};
use haptid_core::{ApparentMassQuery, Backend, EndEffector, Error, apparent_mass, end_effector_dynamics, regressor};
use std::process::Command;

#[test]
fn the_environment_selects_the_back_end() {
    match std::env::var("HAPTID_BACKEND") {
        Ok(name) => assert_eq!(Backend::selected(), Backend::named(&name)),
        Err(_) => assert_eq!(Backend::selected(), Ok(Backend::best())),
    }
    assert_eq!(Backend::named("abacus"), Err(Error::Backend { name: "abacus".to_owned() }));
}

/// The environment is read once: every name takes a process of its own.
#[test]
fn every_back_end_can_be_forced() {
    let program = std::env::current_exe().expect("the test's own program");
    let names = Backend::available().into_iter().map(Backend::name).chain(["abacus"]);
    for name in names {
        let mut command = Command::new(&program);
        command.args(["--exact", "backends::the_environment_selects_the_back_end"]).env("HAPTID_BACKEND", name);
        let output = command.output().expect("the program runs");
        assert!(output.status.success(), "{name}: {}", String::from_utf8_lossy(&output.stdout));
    }
}

#[test]
fn all_back_ends_agree_on_the_regressor() {
    let columns: Vec<usize> = (0..parameters().len()).collect();
    for (varying, accelerations) in [(false, true), (false, false), (true, true), (true, false)] {
        let channels = Channels::new(SAMPLES, varying);
        let made = |backend| {
            let motion = channels.motion(accelerations);
            let mut y = vec![f64::NAN; motion.sets() * 3 * columns.len() * SAMPLES];
            regressor(&closed_chain(backend, varying), &motion, &columns, &mut y).expect("shapes");
            y
        };
        let wanted = made(Backend::named("portable").expect("is everywhere"));
        for backend in Backend::available() {
            assert_close(&made(backend), &wanted, 1e-13, &format!("{backend:?}"));
        }
    }
}

#[test]
fn all_back_ends_agree_at_the_end_effector() {
    for varying in [false, true] {
        let (channels, chi) = (Channels::new(SAMPLES, varying), parameters());
        let spread: Vec<f64> = (0..chi.len() * 3).map(|k| 0.01 * (k as f64).sin()).collect();
        let end_effector = EndEffector { link: 3, point: [0.1, 0.2, 0.3] };
        let query = |rows: &'static [usize], free: &'static [usize]| ApparentMassQuery {
            rows,
            free,
            max_condition: 1e6,
            covariance_factor: &spread,
            factor_columns: 3,
        };
        let made = |backend| {
            let (mechanism, motion) = (closed_chain(backend, varying), channels.motion(false));
            let mut numbers = vec![0.0; SAMPLES * 27];
            end_effector_dynamics(&mechanism, &motion, &end_effector, &chi, &[0, 1, 2, 3, 4, 5], &mut numbers)
                .expect("shapes");
            // As many coordinates as rows; fewer; more.
            for query in [query(&[0, 1, 2], &[0, 1, 2]), query(&[0, 1, 2, 4], &[2, 0]), query(&[5, 1], &[1, 2, 0])] {
                let found = apparent_mass(&mechanism, &motion, &end_effector, &chi, &query).expect("shapes");
                numbers.extend(found.condition.into_iter().chain(found.masses));
                numbers.extend(found.directions.into_iter().chain(found.covariance));
            }
            numbers
        };
        let wanted = made(Backend::named("portable").expect("is everywhere"));
        assert!(wanted.iter().filter(|x| x.is_finite()).count() > wanted.len() / 2);
        for backend in Backend::available() {
            for (got, wanted) in made(backend).into_iter().zip(&wanted) {
                let close = (got - wanted).abs() < 1e-9 * (1.0 + wanted.abs()) || got.is_nan() && wanted.is_nan();
                assert!(close, "{backend:?}: {got} in place of {wanted}");
            }
        }
    }
}
