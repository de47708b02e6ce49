"""What is possible: the error of the true parameters, and of the best of a fixed set of treatments."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

import haptid
from zoo.case import Array
from zoo.plant import Plant
from zoo.recording import Recorded, record, undisturbed, unseen

# The oracle's treatments: cut-off of the parallel filter over the true edge of the motion, that of the positions over
# it, and the speed over its rms below which rows are dropped, with the guard over the filter's reach.
PARALLEL, POSITION, REVERSALS = (1.5, 3.0, 6.0, 12.0), (1.5, 3.0, 8.0), (0.0, 0.03)
GUARD, HIGHEST, ROWS_IN_PERIOD = 0.3, 0.35, 8


@dataclass(frozen=True)
class Unseen:
    """The unseen motion of a plant, on which models are scored."""

    plant: Plant
    states: tuple[Array, Array, Array]
    torque: Array

    @staticmethod
    def of(plant: Plant) -> Unseen:
        return Unseen(plant, *unseen(plant))

    def error(self, beta: Array) -> float:
        """Error of the torque, all rows, per cent: the rms of the motors' relative errors."""
        missed = haptid.inverse_dynamics(self.plant.model, beta, *self.states) - self.torque
        return 100 * float(
            np.sqrt(np.mean((np.linalg.norm(missed, axis=1) / np.linalg.norm(self.torque, axis=1)) ** 2))
        )


def oracle(plant: Plant) -> dict[str, Any]:
    """The floor (true parameters in the model), and the best treatment's error where delays and time base are known."""
    seen = Unseen.of(plant)
    clean = Plant(undisturbed(plant.case))
    made = record(clean)
    log = _log(clean, made)
    known = float(made.delays[0])  # of a loop; zero without one
    best, setting, tried = np.inf, None, 0
    for treatment, named in _treatments(clean, log, known):
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                observed = haptid.observe(clean.model, haptid.treat(log, treatment))
                error = seen.error(haptid.estimate(observed, haptid.WLS()).beta)
        except haptid.errors.HaptidError:
            continue
        tried += 1
        if error < best:
            best, setting = error, named
    return {"floor": seen.error(plant.beta), "oracle": best if tried else None, "oracle_setting": setting}


def _log(plant: Plant, made: Recorded) -> haptid.Log:
    """A log without a file."""
    names = [f"q{k + 1}" for k in range(len(made.q))], [f"u{k + 1}" for k in range(len(made.command))]
    side = "joint" if plant.case.gear == 1.0 else "motor"
    channels = haptid.Channels(
        haptid.Signal(tuple(names[0]), "rad", side=side), haptid.Signal(tuple(names[1]), "N m", side="motor"), time="t"
    )
    t = np.arange(len(made.t)) / plant.case.rate
    return haptid.Log(Path("zoo"), "", t, made.q.T, made.command.T, channels)


def _treatments(plant: Plant, log: haptid.Log, delay: float) -> list[tuple[haptid.Treatment, str]]:
    """The oracle's set."""
    edge, most, made = plant.motion.edge_hz, HIGHEST / log.dt, {}
    for parallel, position, slow in product(PARALLEL, POSITION, REVERSALS):
        shared, cutoff = min(parallel * edge, most / 2), min(position * edge, most)
        decimation = max(1, int(1 / (ROWS_IN_PERIOD * shared * log.dt)))
        treatment = haptid.Treatment(
            cutoff_hz=cutoff,
            parallel_cutoff_hz=shared,
            decimation=decimation,
            reversal_speed=tuple(float(slow * v) for v in plant.speed),
            reversal_guard_s=GUARD * 0.4 / shared,
            torque_delay_s=delay,
        )
        made[treatment] = f"parallel {parallel:g}, position {position:g}, reversals {slow:g}"
    return list(made.items())
