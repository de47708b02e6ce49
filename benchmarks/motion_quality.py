"""Standard errors along the optimal motion, against a hand-made one and the best of twenty random ones: six devices.

All have the same length, the same limits and the same white noise. Hand-made: two sines of its own frequencies for each
joint, from the middle of its range. Random: Fourier series of random amplitudes about random centres, each scaled up to
its first binding limit, the best by condition number. Hand-made ones are scaled likewise.
"""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np

import haptid
from haptid.experiment import bench
from haptid.experiment.bench.trajectories import Fourier
from haptid.experiment.excitation import (
    FourierSeries,
    Information,
    Limits,
    MotionBounds,
    Search,
    design_excitation,
    observed_motion,
    quality,
)

# Positions, speed, acceleration of each device; made up where its file has none.
DEVICES = {
    "phantom_premium_15": Limits(((-0.8, 0.8), (-0.4, 0.8), (-0.3, 0.9)), (3.0,), (30.0,)),
    "cea_medical_branch": Limits(((-1.42, 0.67), (-2.64, -0.55), (2.08, 4.18)), (4.5,), (60.0,)),
    "arm3": Limits(((-1.5, 1.5),) * 3, (3.0,), (20.0,)),
    "arm7": Limits(((-2.0, 2.0),) * 7, (2.0,), (10.0,)),
    "staubli_tx40": Limits(((-1.5, 1.5),) * 6, (2.0,), (15.0,)),
    "kuka_kr300": Limits(((-1.2, 1.2),) * 6, (1.0,), (5.0,)),
}
FAMILY = FourierSeries(seconds=13.0, fundamental_hz=0.1, count=10)
TRIES, RANDOM, NOISE, STEP = 1600, 20, 0.01, 0.02


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


def errors_of(kind: Fourier, bounds: MotionBounds) -> tuple[np.ndarray, float]:
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


def run() -> dict[str, float]:
    """Median and least ratio of standard errors over the parameters, other motion over the optimal one."""
    figures: dict[str, float] = {}
    for name, limits in DEVICES.items():
        model = haptid.DynamicModel(haptid.read_device(name))
        bounds = MotionBounds.of(model, limits, np.ones(len(model.base)))
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
        random = min((errors_of(kind, bounds) for kind in drawn if kind is not None), key=lambda one: one[1])
        hand = scaled(by_hand(bounds), bounds)
        others = {"random": random} | ({} if hand is None else {"hand-made": errors_of(hand, bounds)})
        for what, (se, value) in others.items():
            figures[f"{name}, {what}, condition with unit columns"] = value
            figures[f"{name}, {what} over optimal, median standard error"] = float(np.median(se / best))
            figures[f"{name}, {what} over optimal, least"] = float(np.min(se / best))
    return figures


if __name__ == "__main__":
    for key, value in run().items():
        print(f"{key}: {value:.4g}")
