"""Gravity along another axis than the device file says: found by unseen errors, and not where the file is right."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import haptid
from haptid.advice import advise
from haptid.advice.sides import compared, other_mounting
from haptid.advice.trial import Gain, Trial
from motions import multisine

ARM = """
schema = 1
name = "arm"
gravity = {gravity}
convention = "placement"
[[joints]]
name = "1"
axis = [0.0, 0.0, 1.0]
[[joints]]
name = "2"
parent = "1"
xyz = [0.1, 0.0, 0.2]
axis = [0.0, 1.0, 0.0]
[[terms]]
kind = "viscous"
joints = "all"
[[terms]]
kind = "coulomb"
joints = "all"
"""
UP, WALL, CEILING = [0.0, 0.0, -9.81], [-9.81, 0.0, 0.0], [9.81, 0.0, 0.0]


BODIES = {"M1": 2.0, "MX1": 0.3, "ZZ1": 0.08, "M2": 1.0, "MX2": 0.2, "XX2": 0.02, "YY2": 0.06, "ZZ2": 0.06}


def _study(
    folder: Path, written: list[float], true: Sequence[float] = WALL, slow: float = 1.0, prior: str = ""
) -> haptid.Study:
    """A log of the arm on a wall, and a study whose device file says `written`; `slow` stretches the time."""
    (folder / "true.toml").write_text(ARM.format(gravity=true))
    (folder / "device.toml").write_text(ARM.format(gravity=written) + prior)
    model = haptid.DynamicModel(haptid.read_device(folder / "true.toml"))
    values = BODIES | {"FV1": 0.1, "FV2": 0.1, "FC1": 0.1, "FC2": 0.1}
    beta = model.base.of(np.array([values.get(name, 0.0) for name in model.device.parameters.names]))
    q, qd, qdd = multisine(2, 20.0, 2e-3, 3)
    tau = haptid.inverse_dynamics(model, beta, q, qd / slow, qdd / slow**2)
    tau = tau + 0.02 * tau.std(axis=1, keepdims=True) * np.random.default_rng(2).standard_normal(tau.shape)
    columns = np.array([2e-3 * slow * np.arange(q.shape[1]), *q, *tau])
    np.savetxt(folder / "log.csv", columns.T, delimiter=",", header="t,q1,q2,tau1,tau2", comments="")
    (folder / "study.toml").write_text(
        'schema = 1\ndevice = "device.toml"\n[channels]\ntime = "t"\n'
        'position = { channels = ["q1", "q2"], unit = "rad" }\n'
        'torque = { channels = ["tau1", "tau2"], unit = "N m" }\n[[logs]]\npath = "log.csv"\n'
    )
    return haptid.read_study(folder / "study.toml")


@pytest.mark.parametrize("written", [UP, WALL, CEILING])
def test_gravity_along_another_axis(tmp_path: Path, written: list[float]) -> None:
    advice = advise(haptid.identify(_study(tmp_path, written)))
    told = [action for action in advice.actions if action.kind == "mounting"]
    if written == WALL:
        assert not told
        return
    (action,) = told
    assert advice.actions[0] is action
    if written == CEILING:  # the free fit predicts as well, with first moments of the opposite sign
        assert action.proof == "consistent fit"
        assert action.after < 0.5 * action.before
    else:
        assert action.proof == "unseen error"
        assert action.after < 5 < action.before
    np.testing.assert_allclose(action.edits[0].value, WALL)


@pytest.mark.parametrize("true", [WALL, CEILING])
def test_slow_motion_leaves_the_sign_of_gravity_to_the_bodies_of_the_device_file(
    tmp_path: Path, true: list[float]
) -> None:
    prior = "\n[prior]\n" + "".join(f"{name} = {1.2 * value}\n" for name, value in BODIES.items())
    advice = advise(haptid.identify(_study(tmp_path, UP, true, 8.0, prior)))
    (action,) = (action for action in advice.actions if action.kind == "mounting")
    np.testing.assert_allclose(action.edits[0].value, true)
    assert "bodies agree less" in action.sentence


def test_an_error_that_every_other_direction_lowers_is_not_that_of_the_mounting(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    part = haptid.identify(_study(tmp_path, UP)).estimate
    motions = part.observation.motions
    assert other_mounting(part.model, motions, part.beta, ()) is not None

    def alike(*arguments: object) -> tuple[Trial, tuple[Gain, float, float, float, int]]:
        trial, (gain, *_) = compared(*arguments)  # type: ignore[arg-type]
        return replace(trial, errors=np.ones_like(trial.errors)), (Gain(0.9, 0.01, gain.dof), 50.0, 5.0, 1.0, 24)

    monkeypatch.setattr("haptid.advice.sides.compared", alike)
    assert other_mounting(part.model, motions, part.beta, ()) is None
