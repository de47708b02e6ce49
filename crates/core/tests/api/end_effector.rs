//! Apparent mass of a two-link arm, whose principal values are known.

use haptid_core::{
    ApparentMassQuery, ApparentMasses, Backend, Closure, EndEffector, Error, Joint, Mechanism, Motion, apparent_mass,
};

/// Two bars of length 1 m in a plane, each a point mass at its end; the end effector is the end of the second.
fn arm(backend: Backend) -> Mechanism {
    let eye = [1., 0., 0., 0., 1., 0., 0., 0., 1.];
    let bar = |parent, x| Joint { parent, rotation: eye, translation: [x, 0., 0.], prismatic: false };
    let joints = [bar(None, 0.0), bar(Some(0), 1.0)];
    Mechanism::new(&joints, &Closure::open(2), [0.; 3], &[], backend).unwrap()
}

fn masses(backend: Backend, q: &[f64], max_condition: f64) -> ApparentMasses {
    let mechanism = arm(backend);
    let (first, second): ([f64; 10], [f64; 10]) = (point(2.0), point(3.0));
    let chi: Vec<f64> = first.into_iter().chain(second).collect();
    // Standard deviation of 0.1 kg, of the second mass alone.
    let mut spread = vec![0.0; 20];
    for (k, share) in point(0.1).into_iter().enumerate() {
        spread[10 + k] = share;
    }
    let poses =
        Motion { samples: q.len() / 2, position: q, velocity: &[], acceleration: None, external: &[], loops: &[] };
    let query = ApparentMassQuery {
        rows: &[0, 1],
        free: &[0, 1],
        max_condition,
        covariance_factor: &spread,
        factor_columns: 1,
    };
    let end_effector = EndEffector { link: 1, point: [1., 0., 0.] };
    apparent_mass(&mechanism, &poses, &end_effector, &chi, &query).unwrap()
}

/// A point mass at the end of a bar of length 1 m.
fn point(m: f64) -> [f64; 10] {
    [0., 0., 0., m, 0., m, m, 0., 0., m]
}

#[test]
fn at_a_right_angle_the_principal_masses_are_along_the_second_bar_and_perpendicular_to_it() {
    for backend in Backend::available() {
        // Along the second bar both masses move; perpendicular to it only the second.
        let found = masses(backend, &[0.3, std::f64::consts::FRAC_PI_2], 100.0);
        for (got, wanted) in found.masses.iter().zip([5.0, 3.0]) {
            assert!((got - wanted).abs() < 1e-12, "{backend:?}: {found:?}");
        }
        // Both change with the second mass alone, one to one.
        assert!(found.covariance.iter().all(|v| (v - 0.01).abs() < 1e-12), "{backend:?}: {found:?}");
    }
}

#[test]
fn a_stretched_arm_has_no_masses() {
    let found = masses(Backend::best(), &[0.3, 0.0], 100.0);
    let rest = [found.masses, found.directions, found.covariance].concat();
    assert!(found.condition[0] > 1e10 && rest.iter().all(|x| x.is_nan()), "{rest:?}");
}

#[test]
fn a_pose_that_is_no_number_has_neither_a_condition_nor_masses() {
    for backend in Backend::available() {
        let found = masses(backend, &[0.3, f64::NAN], 100.0);
        let rest = [found.masses, found.directions, found.covariance].concat();
        assert!(found.condition == [f64::INFINITY] && rest.iter().all(|x| x.is_nan()), "{backend:?}: {rest:?}");
    }
}

#[test]
fn masses_without_rows_or_free_coordinates_are_refused() {
    let mechanism = arm(Backend::best());
    let poses =
        Motion { samples: 1, position: &[0.3, 0.4], velocity: &[], acceleration: None, external: &[], loops: &[] };
    let end_effector = EndEffector { link: 1, point: [1., 0., 0.] };
    let all =
        ApparentMassQuery { rows: &[0], free: &[0], max_condition: 9.0, covariance_factor: &[], factor_columns: 0 };
    for (name, query) in
        [("rows", ApparentMassQuery { rows: &[], ..all }), ("free", ApparentMassQuery { free: &[], ..all })]
    {
        let refused = apparent_mass(&mechanism, &poses, &end_effector, &[0.0; 20], &query);
        assert_eq!(refused, Err(Error::Length { name, got: 0, wanted: 1 }));
    }
}

#[test]
fn many_poses_on_several_threads_equal_single_poses() {
    let n = 5003;
    let q: Vec<f64> = (0..2 * n).map(|k| 0.4 + 1e-4 * k as f64).collect();
    let all = masses(Backend::best(), &q, 100.0);
    for k in [0, 7, 8, 15, 16, 511, 512, 4999, n - 1] {
        let one = masses(Backend::best(), &[q[k], q[n + k]], 100.0);
        assert_eq!(one.condition, all.condition[k..][..1]);
        assert_eq!(one.masses, all.masses[2 * k..][..2]);
        assert_eq!(one.directions, all.directions[4 * k..][..4]);
        assert_eq!(one.covariance, all.covariance[3 * k..][..3]);
    }
}
