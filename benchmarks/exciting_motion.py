"""Motions of one branch of the CEA interface that tell its 34 base parameters well: what the example has, and a search.

The search is by gradients: the criterion's derivative by the states at every sample, nine differences whatever the
number of harmonics, and from those by the amplitudes. Limits are penalties that grow. Minutes a call:

    python benchmarks/exciting_motion.py OUT.npz 75 13 200
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from scipy import optimize

import haptid
from haptid import bench
from haptid.bench.limits import loop_openness
from haptid.excitation import observed, quality
from haptid.signals import rows

EXAMPLES = Path(__file__).resolve().parents[1] / "examples" / "cea"
CENTRE = np.array([-0.1706, -1.3187, 3.5634])
# The search stays so far from flat loops; the bench insists on 0.05.
OPEN = 0.062
# Rounds of a search: exponent that stands for the largest and least eigenvalue, weight of the limits, steps.
ROUNDS = ((2, 300, 300), (3, 1e3, 300), (2, 1e3, 250), (4, 3e3, 150), (8, 1e4, 150), (8, 1e5, 150))
# Steps of the differences by position, velocity and acceleration.
STEPS = (1e-6, 1e-5, 1e-4)


@dataclass(frozen=True)
class Series:
    """Fourier series of one period, and the limits about a free centre.

    Attributes:
        stroke, speed, acceleration: rad, rad/s, rad/s^2.
        fundamental_hz, count, samples: one over the period, harmonics, and samples of the period.
    """

    stroke: float
    speed: float
    acceleration: float
    fundamental_hz: float = 0.1
    count: int = 20
    samples: int = 300

    @cached_property
    def basis(self) -> np.ndarray:
        """Constant, sines, cosines, and their rates, (3, 1 + 2 count, samples); unit amplitudes fall with frequency."""
        omega = 2 * np.pi * self.fundamental_hz * np.arange(1, self.count + 1)[:, None]
        angle = omega * np.arange(self.samples) / self.samples / self.fundamental_hz
        s, c, none = np.sin(angle), np.cos(angle), np.zeros((1, self.samples))
        made = [np.vstack([none + 1, s, c]), np.vstack([none, omega * c, -omega * s])]
        made.append(np.vstack([none, -(omega**2) * s, -(omega**2) * c]))
        fall = np.vstack([np.ones((1, 1)), *(2 * [4.0 / np.maximum(omega, 4.0)])])
        return np.array(made) * fall

    def states(self, x: np.ndarray) -> np.ndarray:
        """Position, velocity and acceleration, (3, joints, samples)."""
        return np.einsum("ja,san->sjn", x[:-3].reshape(3, -1), self.basis)

    def start(self, rng: np.random.Generator) -> np.ndarray:
        """Random amplitudes that fill stroke or speed, and the centre."""
        shape = rng.normal(size=(3, 1 + 2 * self.count))
        shape[:, 0] = 0.0
        q, qd, _ = self.states(np.append(shape.ravel(), CENTRE))
        scale = np.minimum(self.stroke / np.abs(q).max(axis=1), self.speed / np.abs(qd).max(axis=1))
        shape *= 0.9 * scale[:, None]
        shape[:, 0] = CENTRE
        return np.append(shape.ravel(), CENTRE)


class Cost:
    """Logarithm of the condition number with unit columns, its extreme eigenvalues smoothed, and what limits cost."""

    def __init__(self, series: Series) -> None:
        self.series, self.device = series, haptid.read_device("cea_medical_branch")
        self.kept = np.argmax(self.device.parameters.S[:, list(self.device.base.kept)], axis=0)

    def W(self, states: np.ndarray) -> np.ndarray:
        """(joints, parameters, samples)."""
        return rows(self.device, *(np.ascontiguousarray(x) for x in states))[:, self.kept]

    def openness(self, q: np.ndarray) -> np.ndarray:
        return loop_openness(self.device, self.device.closure.positions(q).T)

    def __call__(self, x: np.ndarray, power: float, weight: float) -> tuple[float, np.ndarray]:
        """Cost and gradient."""
        states = self.series.states(x)
        cost, by_state = self.condition(states, power)
        limits, by_limits, by_centre = self.limits(states, x[-3:], weight)
        gradient = np.einsum("sjn,san->ja", by_state + by_limits, self.series.basis)
        return cost + limits, np.append(gradient.ravel(), by_centre)

    def condition(self, states: np.ndarray, power: float) -> tuple[float, np.ndarray]:
        W = self.W(states)
        length = np.linalg.norm(W, axis=(0, 2))[:, None]
        unit = W / length
        values, vectors = np.linalg.eigh(np.einsum("jan,jbn->ab", unit, unit))
        values = np.maximum(values, 1e-13)
        small, large = (values**-power).sum(), (values**power).sum()
        bend = (values ** (power - 1) / large - values ** (-power - 1) / small) / 2
        by_unit = 2 * np.einsum("ab,jbn->jan", (vectors * bend) @ vectors.T, unit)
        by_W = (by_unit - unit * np.einsum("jan,jan->a", by_unit, unit)[:, None]) / length
        by_state = np.zeros_like(states)
        for s, step in enumerate(STEPS):
            for j in range(3):
                moved = states.copy()
                moved[s, j] += step
                by_state[s, j] = np.einsum("jan,jan->n", by_W, (self.W(moved) - W) / step)
        return float((np.log(small) + np.log(large)) / (2 * power)), by_state

    def limits(self, states: np.ndarray, centre: np.ndarray, weight: float) -> tuple[float, np.ndarray, np.ndarray]:
        series, n = self.series, states.shape[2]
        cost, by_state, by_centre = 0.0, np.zeros_like(states), np.zeros(3)
        sizes = (series.stroke, series.speed, series.acceleration)
        for s, (most, value) in enumerate(zip(sizes, (states[0] - centre[:, None], *states[1:]), strict=True)):
            over = np.sign(value) * np.maximum(np.abs(value) / most - 1, 0)
            cost += weight * float((over**2).sum()) / n
            by_state[s] = 2 * weight * over / most / n
            by_centre -= by_state[0].sum(axis=1) if s == 0 else 0.0
        least = self.openness(states[0])
        short = np.maximum(1 - least / OPEN, 0)
        cost += weight * float((short**2).sum()) / n
        for j in range(3) if short.any() else ():
            moved = states[0].copy()
            moved[j] += 1e-5
            by_state[0, j] -= 2 * weight * short * (self.openness(moved) - least) / 1e-5 / OPEN / n
        return cost, by_state, by_centre


def search(series: Series, seed: int, x: np.ndarray | None = None) -> np.ndarray:
    """Amplitudes and centre, from a random start or from those of another search."""
    cost = Cost(series)
    x = series.start(np.random.default_rng(seed)) if x is None else x
    for power, weight, steps in ROUNDS:
        settings = {"maxiter": steps, "maxcor": 30}
        x = optimize.minimize(cost, x, args=(power, weight), jac=True, method="L-BFGS-B", options=settings).x
    return x


def run() -> dict[str, float]:
    """Condition numbers of the motions of the examples, with all 34 columns, and their strokes and rates."""
    device, figures = haptid.read_device("cea_medical_branch"), {}
    for name in ("experiment", "excite", "excite-wide"):
        experiment = bench.read_experiment(EXAMPLES / f"{name}.toml")
        beta = device.base.of(experiment.setup(device).chi)
        rng = np.random.default_rng(np.random.SeedSequence(experiment.seed).spawn(2)[0])
        made = bench.plan(experiment.kind, device, 1e-3, rng)
        found = quality(observed(device, made), tuple(range(len(beta))), beta, np.full(3, 0.01))
        tau = haptid.inverse_dynamics(device, beta, made.q.T, made.qd.T, made.qdd.T)
        figures[f"{name}, condition raw"] = found.raw
        figures[f"{name}, condition with unit columns"] = found.scaled
        figures[f"{name}, half stroke, deg"] = float(np.degrees(np.ptp(made.q, axis=0) / 2).max())
        figures[f"{name}, speed, rad/s"] = float(np.abs(made.qd).max())
        figures[f"{name}, acceleration, rad/s^2"] = float(np.abs(made.qdd).max())
        figures[f"{name}, torque, N m"] = float(np.abs(tau).max())
        loops = loop_openness(device, device.closure.positions(made.q[::10].T).T)
        figures[f"{name}, least distance of a loop from flat"] = float(loops.min())
    return figures


if __name__ == "__main__":
    out, stroke, speed, acceleration = sys.argv[1], *map(float, sys.argv[2:5])
    np.savez(out, x=search(Series(np.radians(stroke), speed, acceleration), seed=0))
