"""Joint tests of two estimates: size where nothing changes, with white and coloured noise and with errors of the model,
and a payload that no single test finds. Then logs as recorders make them (encoders, a command that is late by half a
period, torque noise with memory), treated as proposed: how often anything differs between two logs of one device.

    python benchmarks/joint_tests.py [--repetitions 200]
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest import mock

for threads in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(threads, "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

import numpy as np  # noqa: E402
from scipy.signal import lfilter  # noqa: E402

import haptid  # noqa: E402
from haptid.estimation.intervals.clusters import Clusters  # noqa: E402
from haptid.inference.comparison import Comparison, compare  # noqa: E402
from haptid.motion.streaming import delayed  # noqa: E402
from haptid.treatment_choice import with_treatment_uncertainty  # noqa: E402
from motions import motion, multisine  # noqa: E402
from small_study import two_links  # noqa: E402
from true_parameters import true_parameters  # noqa: E402
from zoo.study import commit  # noqa: E402

RESULTS = Path(__file__).resolve().parent / "results" / "joint-tests.json"
DEVICE = "arm3"
# Sampling period and duration of a log, rms of the torque noise, and its correlation from sample to sample.
DT, SECONDS, NOISE, COLOURED = 1e-2, 30.0, 0.5, 0.8
# Unmodelled Stribeck friction over the rms torque, and its speed over the rms speed.
EXCESS, SLOW = 0.2, 0.3
# Mass on the last link, kg, its place there, m, and the noise at which single parameters do not show it.
PAYLOAD, PLACE = 0.205, 0.15
# Sampling period and duration of recorders' logs, s; bits of the encoders, correlation of the torque noise, slowdown.
RATE, RECORDED = 2e-3, 20.0
RECORDERS = {
    "14 bits, white noise": (14, 0.0, 1.0),
    "16 bits, coloured noise": (16, 0.95, 1.0),
    "16 bits, slow motion": (16, 0.9, 2.0),
}


def pair(
    model: haptid.DynamicModel,
    betas: list[np.ndarray],
    seed: int,
    phi: float,
    excess: float = 0.0,
    widened: bool = True,
) -> Comparison:
    """Two estimates along different motions.

    Args:
        model: of both.
        betas: base parameters of each.
        seed: of motions and noise.
        phi: correlation of the noise from sample to sample.
        excess: unmodelled Stribeck friction, over the rms torque; the noise is then a fifth of its usual size.
        widened: whether the errors of the model widen the comparison, as they do by default.
    """
    made = []
    for k, beta in enumerate(betas):
        noise = NOISE / 5 if excess else NOISE
        log = motion(model, beta, seconds=SECONDS, dt=DT, seed=2 * seed + k, noise=noise, phi=phi)
        if excess:
            speed = log.rates[0] @ model.device.row_map.T
            size = excess * np.sqrt((log.tau**2).mean(axis=0))
            extra = size * np.sign(speed) * np.exp(-((speed / (SLOW * np.sqrt((speed**2).mean(axis=0)))) ** 2))
            log = replace(log, tau=log.tau + extra)
        made.append(haptid.estimate(haptid.observe(model, log), haptid.WLS()))
    if widened:
        return compare(*made)
    with mock.patch("haptid.inference.comparison.clusters_with_misfit", _without_misfit):
        return compare(*made)


def _without_misfit(estimate: haptid.Estimate) -> Clusters:
    made = replace(estimate.clusters)
    made.__dict__["misfit"] = 1.0
    return made


def recorded(model: haptid.DynamicModel, beta: np.ndarray, seed: int, bits: int, phi: float, slow: float) -> haptid.Log:
    """A log of one motion: joint encoders of so many bits, torque noise of a twentieth, and the command's hold."""
    rng, joints = np.random.default_rng(seed), len(model.device.active)
    q, qd, qdd = multisine(joints, RECORDED / slow, RATE / slow, seed)
    tau = haptid.inverse_dynamics(model, beta, q, qd / slow, qdd / slow**2).T
    white = np.sqrt(1 - phi**2) * rng.standard_normal((len(tau) + 500, joints))
    tau = np.asarray(delayed(tau, -0.5)) + 0.05 * tau.std(axis=0) * lfilter([1.0], [1.0, -phi], white, axis=0)[500:]
    step = 2 * np.pi / 2**bits
    names = [f"{kind}{k}" for kind in "qu" for k in range(joints)]
    channels = haptid.Channels(
        haptid.Signal(tuple(names[:joints]), "rad"), haptid.Signal(tuple(names[joints:]), "N m", side="motor"), time="t"
    )
    gains = [motor.gear_ratio * motor.torque_constant for motor in model.device.motors]
    position = step * np.round(q.T / step + rng.uniform(size=joints))
    return haptid.Log(Path("made"), f"log {seed}", RATE * np.arange(len(tau)), position, tau / gains, channels)


def default_path(model: haptid.DynamicModel, beta: np.ndarray, seed: int, *how: Any) -> Comparison:
    """Two logs, each with the treatment that is proposed for it."""
    made = []
    for k in (0, 1):
        log = recorded(model, beta, 2 * seed + k, *how)
        proposal = haptid.propose(model, log)
        found = haptid.estimate(haptid.observe(model, haptid.treat(log, proposal.treatment)), haptid.WLS())
        made.append(with_treatment_uncertainty(found, proposal.delays, proposal.effects))
    return compare(*made)


def shares(found: list[Comparison]) -> dict[str, float]:
    """Share of comparisons in which each test rejects at 5 %, without a correction for their number."""
    made = {"any single parameter, corrected": float(np.mean([bool(one.differs) for one in found]))}
    names = [test.name for test in found[0].joint.tests]
    for k, name in enumerate(names):
        made[name] = float(np.mean([one.joint.tests[k].p < 0.05 for one in found]))
    made["any group, corrected"] = float(np.mean([bool(one.joint.differs) for one in found]))
    made["all parameters"] = float(np.mean([one.joint.equality < 0.05 for one in found]))
    return made


def study(repetitions: int) -> dict[str, Any]:
    """All of it."""
    model = haptid.DynamicModel(haptid.read_device(DEVICE))
    chi = true_parameters(model)
    beta = model.base.of(chi)
    loaded = chi.copy()
    names, link = list(model.device.parameters.names), model.device.joint_names[-1]
    body = {"M": 1.0, "MX": PLACE, "YY": PLACE**2, "ZZ": PLACE**2}
    for kind, amount in body.items():
        if kind + link in names:
            loaded[names.index(kind + link)] += PAYLOAD * amount
    heavy = model.base.of(loaded)
    made: dict[str, Any] = {"commit": commit()[:10], "repetitions": repetitions}
    for name, phi in (("white", 0.0), ("coloured", COLOURED)):
        made[f"size, {name} noise"] = shares([pair(model, [beta, beta], k, phi) for k in range(repetitions)])
    for wide in (False, True):
        name = "widened" if wide else "not widened"
        found = [pair(model, [beta, beta], 20_000 + k, COLOURED, EXCESS, wide) for k in range(repetitions // 2)]
        made[f"Stribeck friction that the model lacks, {name}"] = shares(found) | {
            "mean number of single parameters": float(np.mean([len(one.differs) for one in found]))
        }
    two = two_links()
    friction = two.base.of(true_parameters(two, FV=0.05, FC=0.2))
    for name, how in RECORDERS.items():
        made[f"size, {name}, as proposed"] = shares([default_path(two, friction, k, *how) for k in range(repetitions)])
    many = max(20, repetitions // 10)
    found = [pair(model, [beta, heavy], 10_000 + k, COLOURED) for k in range(many)]
    made["payload of 205 g"] = shares(found)
    made["payload of 205 g"]["distance of the payload"] = float(
        np.median([next(t.distance for t in one.joint.tests if t.name == f"payload on link {link}") for one in found])
    )
    return made


def main() -> None:
    """Run, print, store."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repetitions", type=int, default=200)
    parser.add_argument("--out", type=Path, default=RESULTS)
    given = parser.parse_args()
    made = study(given.repetitions)
    given.out.write_text(json.dumps(made, indent=1) + "\n", encoding="utf-8")
    print(json.dumps(made, indent=1))


if __name__ == "__main__":
    main()
