//! Laws of links in the play of their transmissions.

use crate::{below, few};
use haptid_core::{Error, Play, PlayMotion, torque_of_play};
use proptest::collection::vec;
use proptest::prelude::*;

const DT: f64 = 1e-2;

/// A motor's motion, and plays behind it.
#[derive(Debug, Clone)]
struct Case {
    position: Vec<f64>,
    velocity: Vec<f64>,
    acceleration: Vec<f64>,
    inertia: Vec<f64>,
    rest: Vec<f64>,
    friction: (f64, f64),
    plays: Vec<Play>,
}

impl Case {
    fn motion(&self) -> PlayMotion<'_> {
        let (dry, viscous) = self.friction;
        let (position, velocity, acceleration) = (&self.position, &self.velocity, &self.acceleration);
        PlayMotion { dt: DT, position, velocity, acceleration, inertia: &self.inertia, rest: &self.rest, dry, viscous }
    }

    /// Of some plays, (plays, samples).
    fn torque(&self, plays: &[Play]) -> Vec<f64> {
        let mut out = vec![f64::NAN; plays.len() * self.position.len()];
        torque_of_play(&self.motion(), plays, &mut out).expect("shapes");
        out
    }

    /// Positions, velocities, accelerations and torques with the other sign.
    fn mirrored(&self) -> Case {
        let negative = |numbers: &[f64]| numbers.iter().map(|x| -x).collect();
        Case {
            position: negative(&self.position),
            velocity: negative(&self.velocity),
            acceleration: negative(&self.acceleration),
            rest: negative(&self.rest),
            ..self.clone()
        }
    }
}

prop_compose! {
    /// Motions that turn back and forth, so that links leave their flanks.
    fn cases()(velocity in vec(-1.0..1.0, 2..below(200, 20)))(
        inertia in vec(0.5..2.0, velocity.len()),
        rest in vec(-50.0..50.0, velocity.len()),
        acceleration in vec(-100.0..100.0, velocity.len()),
        friction in (0.0..5.0, 0.0..5.0),
        plays in vec((1e-4..2e-2, 0.1..1.0, 0.0..1.0), 1..6),
        velocity in Just(velocity),
    ) -> Case {
        let position = velocity.iter().scan(0.0, |at, v| { *at += DT * v; Some(*at) }).collect();
        let plays = plays.into_iter().map(|(size, share, friction)| Play { size, share, friction }).collect();
        Case { position, velocity, acceleration, inertia, rest, friction, plays }
    }
}

proptest! {
    #![proptest_config(few())]

    /// To the last bit.
    #[test]
    fn both_flanks_are_alike(case in cases()) {
        let mirrored: Vec<f64> = case.mirrored().torque(&case.plays).iter().map(|x| -x).collect();
        prop_assert_eq!(case.torque(&case.plays), mirrored);
    }

    #[test]
    fn plays_do_not_disturb_each_other(case in cases()) {
        let each: Vec<f64> = case.plays.iter().flat_map(|&play| case.torque(&[play])).collect();
        prop_assert_eq!(case.torque(&case.plays), each);
    }

    /// In a play as wide as twice the way that motor and link can go, the motor is without the link.
    #[test]
    fn a_link_that_reaches_no_flank_takes_no_torque(case in cases()) {
        let n = case.velocity.len();
        let case = Case { rest: vec![0.0; n], friction: (0.0, 0.0), ..case };
        for play in &case.plays {
            let made = case.torque(&[Play { size: 4.0 * DT * n as f64, ..*play }]);
            for (k, torque) in made[..n - 1].iter().enumerate() {
                let without = play.share * (case.inertia[k] * case.acceleration[k]);
                prop_assert_eq!(*torque, -without);
            }
            prop_assert_eq!(made[n - 1], 0.0);
        }
    }

    /// Numbers that are no inertia, no play and no share give numbers that are none, if any.
    #[test]
    fn numbers_of_no_play_are_computed_with(
        case in cases(), strange in prop::sample::select(vec![f64::NAN, f64::INFINITY, -1.0, 0.0])
    ) {
        let (mut other, play) = (case.clone(), case.plays[0]);
        other.inertia[0] = strange;
        other.friction = (strange, strange);
        let plays = [Play { size: strange, ..play }, Play { share: strange, ..play }];
        prop_assert_eq!(other.torque(&plays).len(), 2 * case.position.len());
    }

    #[test]
    fn signals_of_other_lengths_are_refused(case in cases()) {
        let (short, n, motion) = (&case.velocity[1..], case.velocity.len(), case.motion());
        let made = |motion: PlayMotion<'_>| torque_of_play(&motion, &case.plays, &mut vec![0.0; case.plays.len() * n]);
        for (name, motion) in [
            ("velocity", PlayMotion { velocity: short, ..motion }),
            ("acceleration", PlayMotion { acceleration: short, ..motion }),
            ("inertia", PlayMotion { inertia: short, ..motion }),
            ("rest", PlayMotion { rest: short, ..motion }),
        ] {
            prop_assert_eq!(made(motion), Err(Error::Length { name, got: n - 1, wanted: n }));
        }
        prop_assert!(torque_of_play(&motion, &case.plays, &mut []).is_err());
    }
}
