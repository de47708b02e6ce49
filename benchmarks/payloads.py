"""Payloads and drive gains: errors and coverage of the 95 % intervals, on the bench and from held poses.

On the bench: the open arm with three joints under its PD, encoders of 4000 counts behind a gear of 10, torque noise of
0.02 N m; multisines without payload and with 1 kg beside the handle, cut into pieces of 8 s. Each piece without payload
and one with it make a pair. The payload is unknown in one fit; in the other its mass is known, its centre of mass is
not, and the gains in the device file are wrong by up to 25 %.

From poses: the same arm with encoders of 4096 counts at 50 Hz and dry friction of 0.2 N m with a scatter of 10 %, 27
configurations, each reached from both sides, without and with 0.5 kg.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import haptid
from bench_identification import CASES, ENDS, truth_of
from haptid.device.priors import PriorBody
from haptid.experiment import bench
from haptid.inference.payloads import AttachedBody, PayloadIdentification, identify_payloads

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from held_poses import held_log, rigid_beta

CASE = CASES["open arm, 3 joints"]
SEEDS, PIECES, PIECE = 20, 15, 8.0
POSE_RUNS = 300
MASS, BESIDE, POSE_MASS = 1.0, (0.03, 0.02, 0.01), 0.5
# True gains over those of the file.
GAINS = np.array([1.0, 0.8, 1.15])
NOISE = 0.02


def logs(
    arm: haptid.DynamicModel, seed: int, payload: bench.SimulatedPayload | None, pieces: int = PIECES
) -> list[haptid.Log]:
    """Pieces of one recording."""
    encoders, physics = bench.Encoders((4000.0,), CASE.gear), bench.Physics(step=2e-4)
    setup = bench.Setup(
        arm,
        truth_of(CASE),
        bench.Controller(CASE.kp, CASE.kd),
        encoders=encoders,
        amplifiers=bench.Amplifiers(noise=(NOISE,)),
        physics=physics,
        payload=payload,
    )
    seconds = pieces * PIECE + 2 * ENDS * setup.dt
    kind = bench.Multisine(seconds, CASE.centre, CASE.amplitude, speed=CASE.speed)
    planned = bench.plan(kind, arm, setup.dt, np.random.default_rng(seed))
    made = bench.simulate(setup, planned, np.random.default_rng(10_000 + seed))
    names = tuple(tuple(f"{what}{k}" for k in "123") for what in ("q", "command"))
    channels = haptid.Channels(haptid.Signal(names[0], "rad"), haptid.Signal(names[1], "N m", side="motor"), "t")
    many = round(PIECE / setup.dt)
    parts = [slice(ENDS + k * many, ENDS + (k + 1) * many) for k in range(pieces)]
    return [
        haptid.Log(Path("bench"), f"{seed} {payload} {k}", made.t[p], made.position[p], made.command[p], channels)
        for k, p in enumerate(parts)
    ]


def scaled(log: haptid.Log) -> haptid.Log:
    """The log as motors of other gains would have had to be commanded."""
    return haptid.Log(log.path, log.sha256, log.t, log.position, np.asarray(log.torque) / GAINS, log.channels)


def pairs(
    arm: haptid.DynamicModel, seeds: int, pieces: int
) -> Iterator[tuple[PayloadIdentification, PayloadIdentification]]:
    """With an unknown payload, and with a known mass and unknown gains."""
    for seed in range(seeds):
        bare = logs(arm, 2 * seed, None, pieces)
        loaded = logs(arm, 2 * seed + 1, bench.SimulatedPayload(MASS, BESIDE), pieces)
        treatment = haptid.propose(arm, bare[0]).treatment
        for one, other in zip(bare, loaded, strict=True):
            a, b = (haptid.treat(log, treatment) for log in (one, other))
            c, d = (haptid.treat(scaled(log), treatment) for log in (one, other))
            unknown = identify_payloads(arm, a, [(AttachedBody("weight", "3"), b)])
            known = identify_payloads(arm, c, [(AttachedBody("weight", "3", mass=MASS), d)], gains=True)
            yield unknown, known


def covered(conf_int: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Whether each interval contains the truth."""
    return np.asarray((conf_int[:, 0] <= truth) & (truth <= conf_int[:, 1]))


def on_the_bench(seeds: int, pieces: int = PIECES) -> dict[str, float]:
    """Errors and coverage over all pairs."""
    arm = haptid.DynamicModel(haptid.read_device("arm3"))
    truth = np.array([MASS, arm.device.lengths["L2"] + BESIDE[0], *BESIDE[1:]])
    inside, error, gains, gain_error = [], [], [], []
    for unknown, known in pairs(arm, seeds, pieces):
        body = unknown["weight"].body.pick(range(4))
        inside.append(covered(body.conf_int(), truth))
        error.append(abs(body.values[0] / MASS - 1))
        assert known.gains is not None
        own = GAINS[[int(label[-1]) - 1 for label in known.gains.quantities.names]]
        hits = covered(known.gains.quantities.conf_int(), own)
        row = np.full(3, np.nan)
        row[[int(label[-1]) - 1 for label in known.gains.quantities.names]] = hits
        gains.append(row)
        gain_error.append(np.abs(known.gains.values / own - 1).max())
    shares = 100 * np.mean(inside, axis=0)
    figures = {"bench: pairs": float(len(inside)), "bench: mass, largest error, per cent": 100 * float(max(error))}
    for name, share in zip(("mass", "com x", "com y", "com z"), shares, strict=True):
        figures[f"bench: {name} in its interval, per cent"] = float(share)
    for k, share in enumerate(100 * np.nanmean(gains, axis=0)):
        figures[f"bench: gain of motor {k + 1} in its interval, per cent"] = float(share)
    figures["bench: gains, largest error, per cent"] = 100 * float(max(gain_error))
    return figures


def from_poses(runs: int) -> dict[str, float]:
    """Errors and coverage of poses."""
    arm = haptid.DynamicModel(haptid.read_device("arm3"))
    beta, com = rigid_beta(arm, truth_of(CASE)), np.array([0.2, 0.03, 0.0])
    heavy = beta + haptid.observation.payload_torque(arm, "3", PriorBody(POSE_MASS, com, None))
    truth, inside, error, gravity = np.array([POSE_MASS, *com[:2]]), [], [], []
    for seed in range(runs):
        bare, loaded = (
            haptid.motion.find_poses(arm.device, held_log(arm, b, s))
            for b, s in ((beta, 2 * seed), (heavy, 2 * seed + 1))
        )
        body = identify_payloads(arm, bare, [(AttachedBody("weight", "3"), loaded)])["weight"].body
        inside.append(covered(body.conf_int(), truth))
        error.append(abs(body.values[0] / POSE_MASS - 1))
        found = haptid.identify_poses(arm, bare)
        bodies = [k for k, name in enumerate(found.estimate.names) if name.startswith("M")]
        gravity.append(covered(found.estimate.conf_int()[bodies], found.model.base.of(truth_of(CASE))[bodies]).mean())
    shares = 100 * np.mean(inside, axis=0)
    figures = {"poses: runs": float(runs)}
    figures["poses: mass, 95th percentile of error, per cent"] = 100 * float(np.quantile(error, 0.95))
    for name, share in zip(("mass", "com x", "com y"), shares, strict=True):
        figures[f"poses: {name} in its interval, per cent"] = float(share)
    figures["poses: gravity parameters in their intervals, per cent"] = 100 * float(np.mean(gravity))
    return figures


def run() -> dict[str, float]:
    """All figures."""
    return {**on_the_bench(SEEDS), **from_poses(POSE_RUNS)}
