"""A device that bends, described as rigid: the advice names the springs, and following it mends the model."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet

from elastic_motors import DT, IA, J, K, recorded
from haptid.advice import Advice, advise, apply_advice
from haptid.advice.columns import ELASTIC, GIVES_WAY
from haptid.advice.elastic import stiffnesses
from haptid.study import read_study
from haptid.study.identify import Identification, identify

RIGID = """schema = 1
name = "axis"
gravity = [0.0, 0.0, -9.81]

[[joints]]
name = "1"

[[terms]]
kind = "viscous"
motors = "all"
"""
STUDY = """schema = 1
name = "axis that bends"
device = "device.toml"

[channels]
time = "t"
position = { channels = ["q"], unit = "rad" }
torque = { channels = ["u"], unit = "N m", side = "motor" }

[[logs]]
path = "log.parquet"
"""


def advised(folder: Path, t: np.ndarray, q: np.ndarray, u: np.ndarray) -> tuple[Identification, Advice]:
    (folder / "device.toml").write_text(RIGID, encoding="utf-8")
    (folder / "study.toml").write_text(STUDY, encoding="utf-8")
    parquet.write_table(pa.table({"t": t, "q": q, "u": u}), folder / "log.parquet")
    found = identify(read_study(folder / "study.toml"))
    return found, advise(found)


def slow(highest: float, stiffness: float = K, noise: float = 0.01) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Time, motor position and torque of the axis of `elastic_motors` along sines below its resonance, undamped."""
    rng, t = np.random.default_rng(5), DT * np.arange(20_000)
    f = np.geomspace(0.4, highest, 14)
    s = 2j * np.pi * f
    wave = np.exp(s[:, None] * t + 2j * np.pi * rng.uniform(size=(14, 1)))
    motor = 1.5 / np.abs(s)
    torque = motor * (IA * s**2 + 0.15 * s + J * s**2 / (1 + J * s**2 / stiffness))
    q, u = ((x[:, None] * wave).real.sum(axis=0) for x in (motor, torque))
    step = 2 * np.pi / 80_000 / 50
    return t, step * np.round(q / step), u + noise * u.std() * rng.standard_normal(len(t))


def test_springs_are_found_and_the_study_with_them_predicts(tmp_path: Path) -> None:
    log = recorded(3)
    found, made = advised(tmp_path, log.t, np.asarray(log.position[:, 1]), np.asarray(log.torque[:, 0]))
    assert [action.kind for action in made.actions] == [ELASTIC]
    (action,) = made.actions
    assert action.places == ("motor 1",)
    assert action.before > 10
    assert action.after < 2
    stiffness = float(action.change.split("about ")[1].split()[0])
    assert stiffness == pytest.approx(K, rel=0.05)
    kinds = [edit.value["kind"] for edit in action.edits]
    assert kinds == ["rotor-inertia", "elastic"]
    applied = apply_advice(made, found, tmp_path / "advised", tmp_path)
    assert applied is not None
    assert applied.after < 2 < 10 < applied.before


def test_springs_that_the_log_does_not_show_are_told_without_an_edit(tmp_path: Path) -> None:
    t, q, u = slow(4.0)
    _, made = advised(tmp_path, t, q, u)
    assert [action.kind for action in made.actions] == [GIVES_WAY]
    (action,) = made.actions
    assert not action.edits
    assert action.after < 0.5 * action.before
    at_most = float(action.change.split("about ")[1].split()[0])
    # All inertia counts as the load's: no more is known.
    assert K < at_most < 1.1 * K * ((J + IA) / J) ** 2


@pytest.mark.parametrize("stiffness", [1e9, -2000.0])
def test_a_rigid_axis_has_no_springs_nor_one_whose_torque_falls_with_frequency(
    tmp_path: Path, stiffness: float
) -> None:
    _, made = advised(tmp_path, *slow(4.0, stiffness))
    assert not {ELASTIC, GIVES_WAY} & {action.kind for action in made.actions}


def test_slope_by_a_compliance_is_the_torque_of_a_load_behind(tmp_path: Path) -> None:
    """To first order the torque with a stiff spring less that of a rigid axis is the slope times the compliance."""
    from haptid.observation.augmented import ResidualContext
    from haptid.observation.geometry_slopes import compliance_slope
    from haptid.observation.plan import Plan

    t, q, _ = slow(3.0)
    found, _ = advised(tmp_path, t, q, np.gradient(np.gradient(q, DT), DT) * J)
    motion = found.estimate.observation.motions[0]
    motion = replace(motion, treatment=replace(motion.treatment))
    chi = np.zeros(len(found.model.device.parameters.raw))
    chi[found.model.device.parameters.index["ZZ1"]] = J
    context = ResidualContext(Plan.of(found.model, motion), chi, 2000, 8000)
    cdd = context.motion[2]
    assert cdd is not None
    jerk = np.gradient(np.gradient(cdd[0], DT), DT)
    inner = slice(10, -10)
    assert compliance_slope(found.model, 0)(context)[0][inner] == pytest.approx(
        -(J**2) * jerk[inner], rel=1e-6, abs=1e-9
    )


def test_stiffnesses_have_the_units_of_their_motors() -> None:
    assert stiffnesses([601.2, 12_340.0], "rad") == "600 and 12000 N m/rad"
    assert stiffnesses([601.2], "m") == "600 N/m"
