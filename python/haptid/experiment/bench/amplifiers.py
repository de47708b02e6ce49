"""From commanded to actual torque: delay and its jitter, resolution, gain, bandwidth and noise of the amplifiers."""

from __future__ import annotations

import numpy as np

from haptid._internal.arrays import Array
from haptid.experiment.bench.setup import Setup
from haptid.experiment.bench.trajectories import per_coordinate


class AppliedTorque:
    """Torque on the motors within one control period after another.

    Args:
        setup: whose amplifiers.
        commanded: torque of each period, (periods, motors), N m or N; filled in period by period.
        rng: for noise and jitter.

    Attributes:
        now: at the beginning of the period of the last call of `pieces`, (motors,), N m or N.
    """

    def __init__(self, setup: Setup, commanded: Array, rng: np.random.Generator) -> None:
        given, h, (n, many) = setup.amplifiers, setup.physics.step, commanded.shape
        motors = [drive.name for drive in setup.model.device.motors]
        self._commanded, self.now = commanded, np.zeros(many)
        self._gain = per_coordinate("gain", given.gain, motors)
        self._noise = per_coordinate("noise", given.noise, motors) * rng.standard_normal((n, many))
        step = per_coordinate("step", given.step, motors)
        self._step = np.where(step > 0, step, 1.0), step > 0
        self._coarse = bool((step > 0).any())
        self._per, late, jitter = (round(x / h) for x in (setup.dt, given.delay, given.jitter))
        self._late = np.full(n, late) + (rng.integers(0, jitter + 1, n) if jitter else 0)
        self._before = -(-(late + jitter) // self._per)
        self._keep = None if given.bandwidth_hz is None else float(np.exp(-np.pi * given.bandwidth_hz * h))
        self._lagging: Array | None = None

    def pieces(self, k: int) -> list[tuple[int, Array]]:
        """Consecutive numbers of simulator steps of period k, and the torque during each, (motors,), N m or N."""
        if self._before == 0 and self._keep is None:  # one piece
            self.now = self._delivered(k) + self._noise[k]
            return [(self._per, self.now)]
        whole: list[tuple[int, Array]] = []
        for j in range(max(k - self._before, 0), k + 1):
            begin = 0 if j == max(k - self._before, 0) else self._arrival(j, k)
            end = self._per if j == k else self._arrival(j + 1, k)
            if (steps := min(max(end, 0), self._per) - min(max(begin, 0), self._per)) > 0:
                whole.append((steps, self._delivered(j)))
        if self._keep is not None:
            whole = self._lagged(whole)
        else:
            self.now = whole[0][1]
        self.now = self.now + self._noise[k]
        return [(steps, torque + self._noise[k]) for steps, torque in whole]

    def _arrival(self, j: int, k: int) -> int:
        """Step of period k at which the command of period j arrives."""
        return int((j - k) * self._per + self._late[j])

    def _delivered(self, j: int) -> Array:
        """Torque that is commanded in period j."""
        step, rounded = self._step
        command = self._commanded[j]
        if self._coarse:
            command = np.where(rounded, step * np.rint(command / step), command)
        return np.asarray(self._gain * command)

    def _lagged(self, pieces: list[tuple[int, Array]]) -> list[tuple[int, Array]]:
        """The first-order lag of a torque, one simulator step after another; each has the torque of its middle."""
        assert self._keep is not None
        torque = pieces[0][1] if self._lagging is None else self._lagging
        made, self.now = [], torque
        for steps, target in pieces:
            for _ in range(steps):
                middle = target + self._keep * (torque - target)
                torque = target + self._keep * (middle - target)
                made.append((1, middle))
        self._lagging = torque
        return made
