//! Motion of links in the play of their transmissions, along a known motion of the motors.
//!
//! A link moves by itself between two flanks, each of which only pushes, and landing is plastic: Moreau's time stepping
//! of unilateral contact (Moreau 1988, in Nonsmooth Mechanics and Applications, CISM 302; Nordin and Gutman 2002,
//! Automatica 38(10), section 3).

use crate::error::{Error, expect_length};

/// A motor along its motion, and the torques that it takes without play.
#[derive(Debug, Clone, Copy)]
pub struct PlayMotion<'a> {
    /// Sampling period, s.
    pub dt: f64,
    /// Positions, rad or m.
    pub position: &'a [f64],
    /// Velocities, SI.
    pub velocity: &'a [f64],
    /// Accelerations, SI.
    pub acceleration: &'a [f64],
    /// Inertia that the motor turns with the link on a flank, kg m^2 or kg.
    pub inertia: &'a [f64],
    /// Torque without that of inertia and friction, N m or N.
    pub rest: &'a [f64],
    /// Dry friction of motor and link, N m or N.
    pub dry: f64,
    /// Viscous friction of both, SI.
    pub viscous: f64,
}

/// A play to try.
#[derive(Debug, Clone, Copy)]
pub struct Play {
    /// From flank to flank, rad or m.
    pub size: f64,
    /// Share of the inertia that is the link's.
    pub share: f64,
    /// Share of the friction that acts on the link.
    pub friction: f64,
}

/// Torque of a motor with a loose link less that without play, N m or N: a row of samples for each play.
///
/// The link begins in the middle of its play, with the motor's velocity. The last sample has no next one: zero.
///
/// # Example
///
/// ```
/// # use haptid_core::*;
/// // A motor stops within a step. Its link goes on at 1 m/s to the flank, 1.5 m ahead, which stops it.
/// let motion = PlayMotion {
///     dt: 1.,
///     position: &[0., 1., 1., 1., 1.],
///     velocity: &[1., 0., 0., 0., 0.],
///     acceleration: &[-1., 0., 0., 0., 0.],
///     inertia: &[2.; 5],
///     rest: &[0.; 5],
///     dry: 0.,
///     viscous: 0.,
/// };
/// let mut torque = [f64::NAN; 5];
/// torque_of_play(&motion, &[Play { size: 3., share: 0.5, friction: 0. }], &mut torque)?;
/// // The motor brakes its own half of 2 kg; that of the link stops two steps later.
/// assert_eq!(torque, [1., 0., -1., 0., 0.]);
/// # Ok::<(), haptid_core::Error>(())
/// ```
pub fn torque_of_play(motion: &PlayMotion, plays: &[Play], out: &mut [f64]) -> Result<(), Error> {
    let samples = motion.position.len();
    expect_length("velocity", motion.velocity.len(), samples)?;
    expect_length("acceleration", motion.acceleration.len(), samples)?;
    expect_length("inertia", motion.inertia.len(), samples)?;
    expect_length("rest", motion.rest.len(), samples)?;
    expect_length("out", out.len(), plays.len() * samples)?;
    let Some(last) = samples.checked_sub(1) else { return Ok(()) };
    let mut links: Vec<LooseLink> = plays.iter().map(|play| LooseLink::of(play, motion)).collect();
    for k in 0..last {
        let step = Step::of(motion, k);
        for (link, out) in links.iter_mut().zip(out.chunks_exact_mut(samples)) {
            out[k] = link.pushed(&step) - link.without(&step);
        }
    }
    for row in out.chunks_exact_mut(samples) {
        row[last] = 0.0;
    }
    Ok(())
}

/// A step of a motor.
struct Step {
    /// What it moves, by its positions and by its next velocity, rad or m.
    flank: f64,
    speed: f64,
    /// What a link loses to the torque of the rest, times its share, rad or m.
    pull: f64,
    /// Inverse inertia, and inertia over the square of the period.
    light: f64,
    heavy: f64,
    /// Torques of inertia, of friction, and of the rest, without play, N m or N.
    inertia: f64,
    friction: f64,
    rest: f64,
}

impl Step {
    #[inline(always)]
    fn of(motion: &PlayMotion, k: usize) -> Step {
        let (inertia, rest, square) = (motion.inertia[k], motion.rest[k], motion.dt * motion.dt);
        let v = motion.velocity[k];
        let sign = if v == 0.0 { 0.0 } else { v.signum() };
        Step {
            flank: motion.position[k + 1] - motion.position[k],
            speed: motion.dt * motion.velocity[k + 1],
            pull: square * rest / inertia,
            light: 1.0 / inertia,
            heavy: inertia / square,
            inertia: inertia * motion.acceleration[k],
            friction: motion.dry * sign + motion.viscous * v,
            rest,
        }
    }
}

/// A link in its play.
struct LooseLink {
    half: f64,
    /// Of the inertia that is the link's, its inverse, and of the friction.
    share: f64,
    over_share: f64,
    friction: f64,
    /// Viscous and dry friction in a step over the link's share of the inertia.
    damping: f64,
    stop: f64,
    /// Place in the play, from the middle, and the displacement in the last step, rad or m.
    place: f64,
    moved: f64,
}

impl LooseLink {
    fn of(play: &Play, motion: &PlayMotion) -> LooseLink {
        let over_share = 1.0 / play.share;
        let on_link = motion.dt * play.friction * over_share;
        LooseLink {
            half: 0.5 * play.size,
            share: play.share,
            over_share,
            friction: play.friction,
            damping: on_link * motion.viscous,
            stop: on_link * motion.dt * motion.dry,
            place: 0.0,
            moved: motion.dt * motion.velocity[0],
        }
    }

    /// Torque of the motor that flanks pass on in a step.
    #[inline(always)]
    fn pushed(&mut self, step: &Step) -> f64 {
        let free = (1.0 - step.light * self.damping) * self.moved - step.pull * self.over_share;
        let free = free - within(step.light * self.stop, free);
        let ahead = self.place + free - step.flank;
        self.place = within(self.half, ahead);
        let lands = (self.place - ahead) * (step.speed - free) > 0.0;
        self.moved = if lands { step.speed } else { free };
        self.share * step.heavy * (self.moved - free)
    }

    /// Torque of the motor that the link takes in a step without play.
    #[inline(always)]
    fn without(&self, step: &Step) -> f64 {
        self.share * step.inertia + self.friction * step.friction + step.rest
    }
}

/// The number nearest to x from -limit to limit.
#[inline(always)]
fn within(limit: f64, x: f64) -> f64 {
    let low = if x > -limit { x } else { -limit };
    if low < limit { low } else { limit }
}
