"""Regressor and reduction against peers that do the same work, as ratios in one run.

A 7-joint arm with 43 base columns. Agreement of the numbers is checked before any time is taken.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
import pinocchio as pin

import haptid
from haptid import _core

SAMPLES = 50_000
# Pinocchio's order of the ten parameters, m mx my mz Ixx Ixy Iyy Ixz Iyz Izz, from ours.
FROM_PINOCCHIO = [4, 5, 7, 6, 8, 9, 1, 2, 3, 0]


def pinocchio_model(device: haptid.Device) -> pin.Model:
    """The same tree, without inertia: only its regressor is asked for."""
    model = pin.Model()
    model.gravity.linear = np.array(device.gravity)
    for k, joint in enumerate(device.joints):
        placement = pin.SE3(np.array(joint.rotation), np.array(joint.translation))
        model.addJoint(joint.parent + 1, pin.JointModelRZ(), placement, f"joint{k}")
    return model


def best_of(work: Callable[[], object], times: int = 5) -> float:
    """Seconds of the fastest of a few runs."""
    taken = []
    for _ in range(times):
        begin = time.perf_counter()
        work()
        taken.append(time.perf_counter() - begin)
    return min(taken)


def run() -> dict[str, float]:
    """Microseconds per sample."""
    device = haptid.read_device("arm7")
    rng = np.random.default_rng(0)
    n = len(device.joints)
    q, qd, qdd = rng.uniform(-2, 2, (n, SAMPLES)), *rng.normal(size=(2, n, SAMPLES))
    none, tau = np.zeros((0, SAMPLES)), rng.normal(size=(n, SAMPLES))
    inertial = [c for c in base_columns(device) if c < 10 * n]
    model = pinocchio_model(device)
    data = model.createData()
    some = 2000

    def peer(count: int) -> np.ndarray:
        columns = (np.array(inertial) // 10) * 10 + np.array(FROM_PINOCCHIO)[np.array(inertial) % 10]
        rows = [
            pin.computeJointTorqueRegressor(model, data, q[:, k], qd[:, k], qdd[:, k])[:, columns] for k in range(count)
        ]
        return np.array(rows)

    few = [np.ascontiguousarray(x[:, :some]) for x in (q, qd, qdd, none)]
    ours = device.mechanism.regressor(*few, inertial)
    agreement = np.abs(peer(some).transpose(1, 2, 0) - ours).max() / np.abs(ours).max()
    assert agreement < 1e-12, agreement

    core = _core.Mechanism(*haptid.device.mechanism_arguments(device))
    weights = np.ones((n, SAMPLES))

    def reduce() -> object:
        return core.reduce(q, qd, qdd, none, tau, inertial, np.ones(1), 1, 0, SAMPLES, SAMPLES, weights)

    def numpy_road() -> np.ndarray:
        Y = core.regressor(q, qd, qdd, none, inertial)
        W = np.concatenate([*Y.transpose(0, 2, 1)])
        return np.linalg.qr(np.column_stack([W, tau.ravel()]), mode="r")

    whole = sum(R[0][:-1, :-1].T @ R[0][:-1, :-1] for _, R in [embed(made, len(inertial)) for made in reduce()])
    R = numpy_road()[:-1, :-1]
    assert np.allclose(whole, R.T @ R, rtol=0, atol=1e-9 * np.abs(whole).max())
    return {
        "base columns": float(len(inertial)),
        "regressor, haptid": best_of(lambda: core.regressor(*few, inertial), 20) / some * 1e6,
        "regressor, Pinocchio from Python": best_of(lambda: peer(some), 3) / some * 1e6,
        "regressor + reduction, haptid fused": best_of(reduce) / SAMPLES * 1e6,
        "regressor + reduction, haptid W and numpy QR": best_of(numpy_road, 2) / SAMPLES * 1e6,
    }


def embed(made: tuple[list[int], np.ndarray], columns: int) -> tuple[list[int], np.ndarray]:
    """A motor's triangle over all columns."""
    reached, triangles = made
    wide = np.zeros((len(triangles), len(reached) + 1, columns + 1))
    wide[:, :, [*reached, columns]] = triangles
    return reached, wide


def base_columns(device: haptid.Device) -> list[int]:
    """The core's columns that the base parameters need."""
    S = device.parameters.S[:, list(device.base.kept)]
    return [int(c) for c in np.flatnonzero(S.any(axis=1))]
