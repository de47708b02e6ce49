"""Standard errors that are predicted of a planned motion after a first log, over those that logs along it give.

The first log is along the hand-made motion of `motion_quality.py`, the planned motion the D-optimal one; devices and
instruments are those of that study. Before: white noise at 25 rows a second, times the factor of each parameter, robust
over classical standard error of the first log. Treated: behind the treatment of the first log, under noise with the
spectrum of its residuals (`haptid.experiment.excitation.treated`). Instruments: without a log, from the encoders, the
torque noise and the rate alone (`haptid.experiment.excitation.expected`), by as many draws of the noise.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

import haptid
from haptid._internal.arrays import Array
from haptid.experiment.excitation import Excitation, MotionBounds, Search, design_excitation
from haptid.experiment.excitation.expected import expected_noise
from haptid.experiment.excitation.treated import TreatedNoise
from motion_quality import DEVICES, FAMILY, TRIES, Rig, by_hand, scaled, true_parameters

WHICH, FIRST_LOGS, LATER_LOGS = ("arm3", "phantom_premium_15", "staubli_tx40"), range(96, 100), range(1, 7)


def predicted(first: haptid.Estimate, planned: Excitation) -> dict[str, Array]:
    """Standard errors of the base parameters along a motion, predicted from a first log in both ways, (p,)."""
    motion, noise = first.observation.motions[0], TreatedNoise.of(first)
    variances = np.array(noise.variances)
    step, rows_hz = motion.dt * motion.treatment.decimation, planned.after.rows / len(variances) / planned.seconds
    R = planned.after.observation.stack(1 / np.sqrt(variances * step * rows_hz))[:-1, :-1]
    factor = first.se / np.array([p.classical_se for p in first.parameters])
    information = {"before": R.T @ R, "treated": noise.information(first.model, planned.trajectory)}
    se = {what: np.sqrt(np.diag(np.linalg.inv(matrix))) for what, matrix in information.items()}
    return se | {"before": factor * se["before"]}


def expected(rig: Rig, planned: Excitation, seed: int) -> Array:
    """Standard errors along a motion, predicted without a log, (p,); by noise alone, as those found."""
    noise = expected_noise(rig.setup, planned, seed=seed)
    assert noise is not None  # as the encoders have a step
    noise = replace(noise, shifts=None)
    return np.sqrt(np.diag(np.linalg.inv(noise.information(rig.bounds.model, planned.trajectory))))


def study(name: str) -> dict[str, float]:
    """Ratio of predicted to found standard errors over parameters and first logs, of one device."""
    model = haptid.DynamicModel(haptid.read_device(name))
    chi = true_parameters(model)
    bounds = MotionBounds.of(model, DEVICES[name], model.base.of(chi))
    planned = design_excitation(model, FAMILY, DEVICES[name], beta=bounds.beta, search=Search(tries=TRIES))
    rig, hand = Rig.of(bounds, chi, planned), scaled(by_hand(bounds), bounds)
    assert hand is not None  # as the middle of the range is within all limits
    found = np.sqrt(np.mean([rig.estimated(planned.kind, seed).se ** 2 for seed in LATER_LOGS], axis=0))
    made = [
        predicted(rig.estimated(hand, seed), planned) | {"instruments": expected(rig, planned, seed)}
        for seed in FIRST_LOGS
    ]
    figures = {}
    for what in made[0]:
        ratio = np.log([one[what] / found for one in made])
        figures[f"{name}, predicted over found, {what}, median"] = float(np.exp(np.median(ratio)))
        figures[f"{name}, predicted over found, {what}, rms of the logarithm"] = float(np.sqrt((ratio**2).mean()))
    return figures


def run() -> dict[str, float]:
    """All devices."""
    return {what: figure for name in WHICH for what, figure in study(name).items()}


if __name__ == "__main__":
    for key, value in run().items():
        print(f"{key}: {value:.4g}")
