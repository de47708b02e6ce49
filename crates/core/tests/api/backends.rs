//! The choice of a back end, and the agreement of all of them with the portable one.

use crate::mechanisms::{BODY, Channels, SAMPLES, assert_close, closed_chain, parameters, tree};
use haptid_core::{
    ApparentMassQuery, Backend, BodyParameters, EndEffector, Error, Poses, apparent_mass, end_effector_dynamics,
    regressor,
};
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
    let samples = 21;
    let position: Vec<f64> = (0..4 * samples).map(|k| (k as f64 * 0.7).sin()).collect();
    let rates: Vec<f64> = (0..16 * samples).map(|k| (k as f64 * 0.3).cos()).collect();
    let chi = BODY.repeat(4);
    let spread: Vec<f64> = (0..41 * 3).map(|k| 0.01 * (k as f64).sin()).collect();
    let poses = Poses { samples, position: &position, rates: &rates };
    let bodies = BodyParameters { chi: &chi, rotors: &[1.0, 0.0, 0.5, 0.0], inertia: &[0.2] };
    let end_effector = EndEffector { link: 3, point: [0.1, 0.2, 0.3] };
    let query = ApparentMassQuery {
        rows: &[0, 1, 2],
        free: &[0, 1, 3],
        max_condition: 1e6,
        covariance_factor: &spread,
        factor_columns: 3,
    };
    let made = |backend| {
        let (mechanism, width) = (tree(backend), query.width());
        let (mut dynamics, mut masses) = (vec![0.0; samples * 40], vec![0.0; samples * width]);
        end_effector_dynamics(&mechanism, &poses, &end_effector, &bodies, &[0, 1, 2, 3, 4, 5], &mut dynamics)
            .expect("shapes");
        apparent_mass(&mechanism, &poses, &end_effector, &bodies, &query, &mut masses).expect("shapes");
        (dynamics, masses)
    };
    let (dynamics, masses) = made(Backend::named("portable").expect("is everywhere"));
    for backend in Backend::available() {
        let got = made(backend);
        assert_close(&got.0, &dynamics, 1e-13, &format!("{backend:?}"));
        assert_close(&got.1, &masses, 1e-9, &format!("{backend:?}"));
    }
}
