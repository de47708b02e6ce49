"""Torque that a motor lacks while its link is loose in the play of the transmission, along the motor's motion.

Where the torque that the link needs changes its sign, the link leaves the flank that it leaned on and moves by itself:
its motor turns the rotor alone. When it has crossed the play, it lands on the other flank, and the motor gives it back
the momentum that it lacked. Flanks only push, and landing is plastic: Moreau's time stepping of unilateral contact.

Sources: Nordin and Gutman (2002), Automatica 38(10), section 3, of models of backlash; Moreau (1988), in Nonsmooth
Mechanics and Applications, CISM 302, for the steps.
"""

from __future__ import annotations

import numpy as np

from haptid import _core
from haptid._internal.arrays import Array
from haptid._internal.late import dataclass

# Least inertia at a motor over its median: that of an estimate need not be positive in every pose.
_LEAST = 0.1


@dataclass(frozen=True, eq=False)
class LooseLinks:
    """Motion of motors, and what it takes where links follow them.

    Attributes:
        dt: sampling period, s.
        x, v, a: of each motor, (motors, samples), SI.
        inertia: that it turns, (motors, samples).
        rest: torque without that of inertia and friction: gravity, coupling, (motors, samples), N m or N.
        dry, viscous: friction of motor and link, (motors,).
    """

    dt: float
    x: Array
    v: Array
    a: Array
    inertia: Array
    rest: Array
    dry: Array
    viscous: Array

    @staticmethod
    def of(dt: float, motion: tuple[Array, Array, Array], torque: Array, friction: Array, inertia: Array) -> LooseLinks:
        """From the torque of a rigid model, and its part that is friction, (motors, samples)."""
        x, v, a = motion
        least = _LEAST * np.abs(np.median(inertia, axis=1, keepdims=True))
        M, laws = np.maximum(inertia, np.maximum(least, np.finfo(float).tiny)), []
        for speed, own in zip(v, friction, strict=True):
            laws.append(np.linalg.lstsq(np.array([np.sign(speed), speed]).T, own, rcond=None)[0])
        dry, viscous = np.maximum(np.array(laws).T, 0.0)
        return LooseLinks(dt, x, v, a, M, torque - friction - M * a, dry, viscous)

    def alone(self, motor: int) -> LooseLinks:
        """One motor."""
        own = slice(motor, motor + 1)
        signals = (y[own] for y in (self.x, self.v, self.a, self.inertia, self.rest, self.dry, self.viscous))
        return LooseLinks(self.dt, *signals)

    def change(self, size: Array, share: Array, friction: Array) -> Array:
        """Torque with play less torque without, (motors, cases, samples), N m or N.

        Args:
            size: the play from flank to flank, of each case, (motors, cases), rad or m.
            share: of the inertia that is the link's, (motors, cases).
            friction: share of the friction that acts on the link, (motors, cases).
        """
        plays = np.stack([size, share, friction], axis=2)
        signals = (self.x, self.v, self.a, self.inertia, self.rest)

        def of_motor(motor: int) -> Array:
            x, v, a, inertia, rest = (np.ascontiguousarray(y[motor]) for y in signals)
            dry, viscous = float(self.dry[motor]), float(self.viscous[motor])
            return _core.torque_of_play(self.dt, x, v, a, inertia, rest, dry, viscous, plays[motor])

        return np.array([of_motor(motor) for motor in range(len(plays))])
