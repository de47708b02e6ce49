//! Assembly and continuation of a four-bar linkage.

use haptid_core::{
    ActiveTrajectory, AssemblyMode, Backend, ClosureTolerances, ContinuationStop, CutJoint, CutKind, Frame, Joint,
    JointTrajectory, LinearClosure, LoopClosure,
};

const EYE: [f64; 9] = [1., 0., 0., 0., 1., 0., 0., 0., 1.];

/// A four-bar linkage: two cranks on a base line, the active one shorter than the base, and a coupler from it that
/// ends on the other crank.
fn four_bar(reach: f64) -> AssemblyMode {
    let bar = |parent, x| Joint { parent, rotation: EYE, translation: [x, 0., 0.], prismatic: false };
    let tip = |link, x| Frame { link: Some(link), rotation: EYE, translation: [x, 0., 0.] };
    let cut = CutJoint { kind: CutKind::Revolute, frame_a: tip(1, reach), frame_b: tip(2, 0.3) };
    let loops = LoopClosure::new(&[bar(None, 0.), bar(Some(0), 0.1), bar(None, 0.4)], &[cut], 0.4).expect("four bars");
    let mut start = [1.0, -0.3, 1.5];
    loops.close(&mut start, &[1, 2], 60, 1e-12).expect("shapes");
    let tolerances = ClosureTolerances { gap: 1e-12, singular_value: 1e-3 };
    let linear = LinearClosure { rates: &[1., 0., 0.], offset: &[0.; 3] };
    AssemblyMode::new(&loops, &[0], &[1, 2], &linear, &start, &[true; 3], tolerances).expect("an assembly mode")
}

type Found = (Vec<f64>, Vec<f64>, Vec<f64>, Option<ContinuationStop>);

fn followed(mode: &AssemblyMode, position: &[f64], velocity: &[f64]) -> Found {
    let mut made = (vec![0.0; 3 * position.len()], vec![0.0; 3 * position.len()], vec![0.0; 3 * position.len()]);
    let out = JointTrajectory { position: &mut made.0, rates: &mut made.1, rate_derivatives: &mut made.2 };
    let stop = mode.follow(&ActiveTrajectory { position, velocity }, out).expect("shapes");
    (made.0, made.1, made.2, stop)
}

/// A crank that makes full turns.
fn turns(samples: usize) -> Vec<f64> {
    (0..samples).map(|k| 1.0 + 0.004 * k as f64).collect()
}

#[test]
fn rates_and_their_derivatives_are_those_of_differences() {
    let (mode, h) = (four_bar(0.4), 1e-5);
    for x in [0.2, 1.0, 2.9] {
        let (q, rates, rate_derivatives, stop) = followed(&mode, &[x - h, x, x + h], &[2.0; 3]);
        assert!(stop.is_none());
        for j in 0..3 {
            assert!(((q[6 + j] - q[j]) / (2.0 * h) - rates[3 + j]).abs() < 1e-8);
            assert!(((rates[6 + j] - rates[j]) / h - rate_derivatives[3 + j]).abs() < 1e-8);
        }
    }
}

#[test]
fn all_back_ends_agree_on_a_motion() {
    let (mode, position) = (four_bar(0.4), turns(1009));
    let velocity: Vec<f64> = (0..1009).map(|k| (0.01 * f64::from(k)).sin()).collect();
    let mode = mode.with_backend(Backend::named("portable").expect("is everywhere"));
    let (q, rates, rate_derivatives, _) = followed(&mode, &position, &velocity);
    for backend in Backend::available() {
        let mode = mode.clone().with_backend(backend);
        let (other_q, other_rates, other_change, stop) = followed(&mode, &position, &velocity);
        assert!(stop.is_none());
        for (one, other) in [(&q, other_q), (&rates, other_rates), (&rate_derivatives, other_change)] {
            assert!(one.iter().zip(&other).all(|(x, y)| (x - y).abs() < 1e-12), "{backend:?}");
        }
    }
}

#[test]
fn a_coarse_motion_equals_the_same_samples_of_a_fine_one() {
    let (mode, fine) = (four_bar(0.4), turns(2001));
    let coarse: Vec<f64> = fine.iter().step_by(40).copied().collect();
    let (q, some) = (followed(&mode, &fine, &[1.0; 2001]), followed(&mode, &coarse, &[1.0; 51]));
    for (k, one) in some.1.chunks_exact(3).enumerate() {
        assert!((0..3).all(|j| (q.0[120 * k + j] - some.0[3 * k + j]).abs() < 1e-12));
        assert!((0..3).all(|j| (q.1[120 * k + j] - one[j]).abs() < 1e-12));
        assert!((0..3).all(|j| (q.2[120 * k + j] - some.2[3 * k + j]).abs() < 1e-11));
    }
}

#[test]
fn continuation_stops_at_the_first_sample_that_cannot_be_assembled_in_any_segment() {
    // The coupler reaches the other crank's tip on one side only.
    let (mode, position) = (four_bar(0.15), turns(3000));
    let stop = followed(&mode, &position, &vec![1.0; 3000]).3.expect("out of reach");
    let far = position[stop.sample];
    assert!(far > stop.last_pose[0] && far - stop.last_pose[0] < 0.0041, "{stop:?}");
    let longer: Vec<f64> = (0..600).map(|_| 1.0).chain(position).collect();
    assert_eq!(followed(&mode, &longer, &vec![1.0; 3600]).3.map(|stop| stop.sample), Some(stop.sample + 600));
    let mut reached = [false; 2];
    mode.reach_from_start(&[1.1, far], &mut [0.0; 6], &mut reached).expect("shapes");
    assert_eq!(reached, [true, false]);
}

#[test]
fn a_motion_may_begin_out_of_reach_of_the_start_if_it_leads_there() {
    let mode = four_bar(0.15);
    let back: Vec<f64> = turns(100).into_iter().rev().collect();
    assert!(followed(&mode, &back, &[0.0; 100]).3.is_none());
    let stop = followed(&mode, &[f64::NAN, 1.0], &[0.0; 2]).3.expect("no pose");
    assert_eq!(stop.sample, 0);
}

#[test]
fn two_bars_meet_where_the_law_of_cosines_says() {
    let eye = [1., 0., 0., 0., 1., 0., 0., 0., 1.];
    let bar = |x| Joint { parent: None, rotation: eye, translation: [x, 0., 0.], prismatic: false };
    let tip = |link, x| Frame { link: Some(link), rotation: eye, translation: [x, 0.0, 0.0] };
    let cut = CutJoint { kind: CutKind::Revolute, frame_a: tip(0, 0.5), frame_b: tip(1, 0.4) };
    let loops = LoopClosure::new(&[bar(0.0), bar(0.6)], &[cut], 0.6).expect("two bars");
    let mut q = [0.5, 2.0].repeat(300);
    loops.close(&mut q, &[0, 1], 60, 1e-12).expect("shapes");
    assert!(loops.close(&mut q, &[0, 1], usize::MAX, 1e-12).is_err(), "as many steps would never end");
    let (first, second) = ((0.25 + 0.36 - 0.16_f64) / 0.6, (0.16 + 0.36 - 0.25_f64) / 0.48);
    for q in q.chunks_exact(2) {
        assert!((q[0].cos() - first).abs() < 1e-10 && (-q[1].cos() - second).abs() < 1e-10, "{q:?}");
    }
}
