"""Intervals along the optimal motion, against a hand-made one and the best of twenty random ones: six devices.

Predicted: standard errors with white noise. Identified: those of the proposed treatment and weighted least squares, by
eight logs of the bench that differ in the draw of their noise, with 20 000 counts a turn and torque noise of 1 % of the
largest torque of the optimal motion; root mean squares, since the median ratio of single logs scatters by a third.
Errors: deviations of the same estimates from the truth, root mean squares. All motions have the same length and
limits. Hand-made: two sines of its own frequencies for each joint, from the middle of its range. Random: Fourier series
of random amplitudes about random centres, each scaled up to its first binding limit, the best by condition number.
Hand-made ones are scaled likewise.
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

import haptid
from haptid._internal.arrays import Array
from haptid.experiment import bench
from haptid.experiment.bench.trajectories import Fourier, TrajectoryKind
from haptid.experiment.excitation import (
    FourierSeries,
    Information,
    Limits,
    MotionBounds,
    PlannedMotion,
    Search,
    design_excitation,
    observed_motion,
    quality,
)
from haptid.experiment.excitation.writing import OMEGA, controlled_inertia

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from true_parameters import true_parameters

# Positions, speed, acceleration of each device; made up where its file has none.
DEVICES = {
    "phantom_premium_15": Limits(((-0.8, 0.8), (-0.4, 0.8), (-0.3, 0.9)), (3.0,), (30.0,)),
    "cea_medical_branch": Limits(((-1.42, 0.67), (-2.64, -0.55), (2.08, 4.18)), (4.5,), (60.0,)),
    "arm3": Limits(((-1.5, 1.5), (-0.78, 1.5), (-2.5, 0.5)), (3.0,), (20.0,)),
    "arm7": Limits(((-2.0, 2.0),) * 7, (2.0,), (10.0,)),
    "staubli_tx40": Limits(((-1.5, 1.5),) * 6, (2.0,), (15.0,)),
    "kuka_kr300": Limits(((-1.2, 1.2), (-0.87, 1.2), (-1.2, 1.0), *((-1.2, 1.2),) * 3), (1.0,), (5.0,)),
}
FAMILY = FourierSeries(seconds=13.0, fundamental_hz=0.1, count=10)
TRIES, RANDOM, NOISE, STEP, LOGS = 800, 20, 0.01, 0.02, 8
# Damping ratio of the controller, counts of an encoder turn; ends of a log that are left out, samples.
DAMPING, COUNTS, ENDS = 0.8, 20_000.0, 500


def scaled(kind: Fourier, bounds: MotionBounds) -> Fourier | None:
    """The series with the largest amplitudes about its centre that keep all limits; None where the centre does not."""

    def at(size: float) -> Fourier:
        times = lambda rows: tuple(tuple(size * x for x in row) for row in rows)  # noqa: E731
        return replace(kind, sine=times(kind.sine), cosine=times(kind.cosine))

    def kept(size: float) -> bool:
        try:
            made = bench.plan(at(size), bounds.model, STEP, np.random.default_rng(0))
            states = np.array([made.q.T, made.qd.T, made.qdd.T])
            worst = max(float(excess.max()) for excess, _ in bounds.by_sample(states))
            return max(worst, float(bounds.flatness(states[0]).max())) <= 0
        except haptid.errors.HaptidError:  # the loops do not close there
            return False

    low, high = 0.0, 10.0
    if not kept(1e-3):
        return None
    for _ in range(16):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if kept(middle) else (low, middle)
    return at(low)


def errors_of(kind: Fourier, bounds: MotionBounds) -> tuple[Array, float]:
    """Standard error of each base parameter, (p,), and condition number with unit columns."""
    made = bench.plan(kind, bounds.model, STEP, np.random.default_rng(0))
    p = len(bounds.beta)
    motors = sum(bounds.model.device.measured)
    found = quality(observed_motion(bounds.model, made), tuple(range(p)), np.ones(p), np.full(motors, NOISE))
    return found.relative_se, found.scaled


def by_hand(bounds: MotionBounds) -> Fourier:
    """Two sines of its own frequencies for each joint, from the middle of its range."""
    joints, half = len(bounds.names), np.ptp(bounds.position, axis=1) / 2
    sine = np.zeros((joints, FAMILY.count))
    for j in range(joints):
        sine[j, 1 + j % 4] = 0.7 * half[j]
        sine[j, 5 + (2 * j) % 5] = 0.15 * half[j]
    rows = tuple(map(tuple, sine.tolist()))
    none = tuple(map(tuple, np.zeros_like(sine).tolist()))
    centre = tuple(bounds.position.mean(axis=1).tolist())
    return Fourier(FAMILY.seconds, centre, FAMILY.fundamental_hz, rows, none, FAMILY.ramp)


@dataclass(frozen=True, eq=False)
class Rig:
    """A device on the bench, under the controller that suits its optimal motion.

    Attributes:
        bounds: of its motions, with the true base parameters.
        chi: true standard parameters, SI.
        inertia: of the motors' coordinates, for the gains.
        noise: of the torque of each motor, N m.
    """

    bounds: MotionBounds
    chi: Array
    inertia: Array
    noise: Array

    @staticmethod
    def of(bounds: MotionBounds, chi: Array, optimal: PlannedMotion) -> Rig:
        made = optimal.trajectory(STEP)
        tau = haptid.inverse_dynamics(bounds.model, bounds.beta, made.q.T, made.qd.T, made.qdd.T)
        return Rig(bounds, chi, controlled_inertia(optimal), NOISE * np.abs(tau).max(axis=1))

    @property
    def setup(self) -> bench.Setup:
        """Controller and instruments."""
        gains = (tuple(OMEGA**2 * self.inertia), tuple(2 * DAMPING * OMEGA * self.inertia))
        return bench.Setup(
            self.bounds.model,
            self.chi,
            bench.Controller(*gains, dynamics=True),
            encoders=bench.Encoders((COUNTS,)),
            amplifiers=bench.Amplifiers(noise=tuple(self.noise)),
        )

    def identified(self, kind: TrajectoryKind) -> tuple[Array, Array, float]:
        """Standard errors of the base parameters and deviations from the truth, (p,) each, rms over logs.

        Third, the share of true values within two standard errors, per cent.
        """
        made = [self._one(kind, seed) for seed in range(1, LOGS + 1)]
        se, error = (np.array(x) for x in zip(*made, strict=True))
        inside = 100 * float((np.abs(error) < 2 * se).mean())
        return np.sqrt((se**2).mean(axis=0)), np.sqrt((error**2).mean(axis=0)), inside

    def _one(self, kind: TrajectoryKind, seed: int) -> tuple[Array, Array]:
        """The same of one log, whose noise has this seed."""
        estimate = self.estimated(kind, seed)
        return estimate.se, estimate.beta - self.bounds.beta

    def estimated(self, kind: TrajectoryKind, seed: int) -> haptid.Estimate:
        """The estimate from one log, whose noise has this seed."""
        model, setup = self.bounds.model, self.setup
        planned = bench.plan(kind, model, setup.dt, np.random.default_rng(0))
        made, inner = bench.simulate(setup, planned, np.random.default_rng(seed)), slice(ENDS, -ENDS)
        columns = (("q", made.position), ("command", made.command))
        position, command = (tuple(f"{name}{k}" for k in range(x.shape[1])) for name, x in columns)
        channels = haptid.Channels(
            haptid.Signal(position, "rad"), haptid.Signal(command, "N m", side="motor"), time="t"
        )
        log = haptid.Log(Path("bench"), "", made.t[inner], made.position[inner], made.command[inner], channels)
        motion = haptid.treat(log, haptid.propose(model, log).treatment)
        return haptid.estimate(haptid.observe(model, motion), haptid.WLS())


def study(name: str) -> dict[str, float]:
    """Ratios of standard errors over the parameters, other motion over the optimal one; of one device."""
    model, limits, figures = haptid.DynamicModel(haptid.read_device(name)), DEVICES[name], dict[str, float]()
    chi = true_parameters(model)
    bounds = MotionBounds.of(model, limits, model.base.of(chi))
    begun = time.process_time()
    found = design_excitation(
        model, FAMILY, limits, criterion=Information(), beta=bounds.beta, search=Search(tries=TRIES)
    )
    figures[f"{name}, processor time of the search, s"] = time.process_time() - begun
    assert isinstance(found.kind, Fourier)
    best, condition = errors_of(found.kind, bounds)
    figures[f"{name}, optimal, condition with unit columns"] = condition
    rng = np.random.default_rng(1)
    drawn = [scaled(FAMILY.kind(FAMILY.start(bounds, rng), bounds), bounds) for _ in range(RANDOM)]
    random = min((kind for kind in drawn if kind is not None), key=lambda kind: errors_of(kind, bounds)[1])
    hand = scaled(by_hand(bounds), bounds)
    rig = Rig.of(bounds, chi, found)
    measured, off, inside = rig.identified(found.kind)
    figures[f"{name}, optimal, true values inside two standard errors, %"] = inside
    for what, kind in {"random": random, "hand-made": hand}.items():
        if kind is None:
            continue
        predicted, value = errors_of(kind, bounds)
        figures[f"{name}, {what}, condition with unit columns"] = value
        se, error, _ = rig.identified(kind)
        ratios = {"predicted": predicted / best, "identified": se / measured, "errors": error / off}
        for sort, ratio in ratios.items():
            figures[f"{name}, {what} over optimal, {sort}, median standard error"] = float(np.median(ratio))
            figures[f"{name}, {what} over optimal, {sort}, least"] = float(np.min(ratio))
    return figures


def run() -> dict[str, float]:
    """All devices."""
    return {what: figure for name in DEVICES for what, figure in study(name).items()}


if __name__ == "__main__":
    for key, value in run().items():
        print(f"{key}: {value:.4g}")
