"""Tables without a header that have the errors of a controller beside joints: planned minus measured positions."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

from haptid.log.by_content import Content
from haptid.log.survey import survey

DT, STEP = 0.002, 1e-5
T = np.arange(0.0, 12.0, DT)


@cache
def signals(joints: int, counted: bool) -> dict[str, np.ndarray]:
    """Of joints under PD control, with encoder steps or without noise."""
    rng = np.random.default_rng(joints)
    f, phase, size = (
        rng.uniform(0.2, 0.8, (3, joints)),
        rng.uniform(0, 6, (3, joints)),
        rng.uniform(0.2, 0.5, (3, joints)),
    )
    plan = sum(a * np.sin(2 * np.pi * w * T[:, None] + p) for a, w, p in zip(size, f, phase, strict=True))
    speed = np.gradient(plan, DT, axis=0)
    inertia, kp, weight = rng.uniform(0.1, 1, joints), rng.uniform(100, 400, joints), rng.uniform(1, 10, joints)
    load = inertia * np.gradient(speed, DT, axis=0) + weight * np.sin(plan) + 1.5 * np.tanh(20 * speed) + 0.5 * speed
    q = plan - lfilter([DT / 0.03], [1, DT / 0.03 - 1], load / kp, axis=0)
    q = np.round(q / STEP) * STEP if counted else q
    e = plan - q
    rates = {"qd": np.gradient(q, DT, axis=0), "ed": np.gradient(e, DT, axis=0), "plan_d": speed}
    tau = kp * e + 0.05 * kp * rates["ed"] + rng.normal(0, 0.02, e.shape)
    return {"t": T[:, None], "q": q, "e": e, "plan": plan, "tau": tau, **rates}


@pytest.mark.parametrize("counted", [True, False])
@pytest.mark.parametrize("joints", [1, 3, 6])
@pytest.mark.parametrize(
    "layout",
    [
        "t q qd e tau",
        "t q qd e ed tau",
        "t q e qd ed tau",
        "t q qd tau e ed",
        "t plan q e qd tau",
        "t plan plan_d q qd e ed tau",
        "t e ed q qd tau",
    ],
)
def test_errors_are_no_joints_and_no_torques(layout: str, joints: int, counted: bool) -> None:
    """They were joints more, for which there were no torques, or the torques."""
    parts = signals(joints, counted)
    columns = {f"{name}{k}": x for name in layout.split() for k, x in enumerate(parts[name].T)}
    found = Content.of(columns)
    assert found.positions == tuple(f"q{k}" for k in range(joints))
    assert found.torques == tuple(f"tau{k}" for k in range(joints))


def test_joints_that_move_little_beside_others_stay_joints(tmp_path: Path) -> None:
    parts = signals(6, True)
    q, qd = parts["q"] * [1, 1, 1, 0.1, 0.1, 0.1], parts["qd"] * [1, 1, 1, 0.1, 0.1, 0.1]
    path = tmp_path / "log.txt"
    np.savetxt(path, np.hstack([T[:, None], q, qd, parts["tau"]]))
    table = survey(path).table
    assert "joints = [2, 3, 4, 5, 6, 7]" in table
    assert "joints = [14, 15, 16, 17, 18, 19]" in table


def test_joints_of_small_motion_are_none_of_the_errors_where_one_torque_is_dead() -> None:
    """Too few columns that move for all joints were taken for torques of the larger half alone."""
    parts = signals(6, True)
    small = np.where(np.arange(6) < 3, 1.0, 0.1)
    columns = {
        f"{name}{k}": x
        for name in ("t", "q", "qd", "tau")
        for k, x in enumerate((parts[name] * (small if name in ("q", "qd") else 1.0)).T)
    }
    columns["tau5"] = np.full(len(T), 0.25)
    assert Content.of(columns).positions == tuple(f"q{k}" for k in range(6))


def test_a_torque_that_is_its_error_is_one_of_the_torques() -> None:
    """A proportional controller with a gain of one in the log's units, on one joint of three."""
    parts = signals(3, True)
    rng = np.random.default_rng(0)
    tau = parts["e"] * np.array([1.0, 50.0, 80.0]) + rng.normal(0, 1e-7, parts["e"].shape)
    columns = {f"{name}{k}": x for name in ("t", "q", "qd") for k, x in enumerate(parts[name].T)}
    columns |= {f"tau{k}": x for k, x in enumerate(tau.T)}
    found = Content.of(columns)
    assert (found.positions, found.torques) == (("q0", "q1", "q2"), ("tau0", "tau1", "tau2"))
