"""Logs of one device on several days: friction, temperature of the motors and zeros of the encoders are each day's."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import lfilter

import haptid
from motions import motion
from true_parameters import true_parameters

# Standard deviations from day to day: of every friction parameter and torque constant, relative, and of a zero, rad.
FRICTION, GAIN, HOME = 0.2, 0.01, 0.01


@dataclass(frozen=True, eq=False)
class Days:
    """What stays from day to day.

    Attributes:
        model: of the device.
        size: of what changes, over its usual one.
        seconds, dt: of a log.
        noise: of the torque, over each motor's own rms; `phi` its correlation from sample to sample.
        friction: viscous and Coulomb friction of the mean day, SI.
    """

    model: haptid.DynamicModel
    size: float = 1.0
    seconds: float = 6.0
    dt: float = 1e-2
    noise: float = 0.03
    phi: float = 0.0
    friction: tuple[float, float] = (0.05, 0.2)

    @property
    def chi(self) -> np.ndarray:
        """Standard parameters of the mean day."""
        return true_parameters(self.model, FV=self.friction[0], FC=self.friction[1])

    @property
    def beta(self) -> np.ndarray:
        """Base parameters of the mean day."""
        return self.model.base.of(self.chi)

    def log(self, rng: np.random.Generator, seed: int) -> haptid.Motion:
        """One day: a motion by its seed, and everything else drawn."""
        chi, kinds = self.chi, self.model.device.parameters.kinds
        rough = [kind in ("FV", "FC") for kind in kinds]
        chi[rough] *= 1 + self.size * FRICTION * rng.standard_normal(np.sum(rough))
        made = motion(self.model, self.model.base.of(chi), seconds=self.seconds, dt=self.dt, seed=seed)
        motors, joints = made.tau.shape[1], made.q.shape[1]
        tau = made.tau * (1 + self.size * GAIN * rng.standard_normal(motors))
        white = np.sqrt(1 - self.phi**2) * rng.standard_normal((len(tau) + 200, motors))
        tau = (
            tau
            + self.noise * np.sqrt((made.tau**2).mean(axis=0)) * lfilter([1.0], [1.0, -self.phi], white, axis=0)[200:]
        )
        return replace(made, q=made.q + self.size * HOME * rng.standard_normal(joints), tau=tau)
