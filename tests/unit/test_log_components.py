"""Drafts from logs beside whose torques stand parts of a model, inputs of a controller, and rates of other angles."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path

import numpy as np
import pytest

import recorders
from haptid.log.survey import survey

T = 0.002 * np.arange(1500)


def _table(folder: Path, **columns: np.ndarray) -> str:
    names = ("t", *columns)
    path = folder / "run.csv"
    np.savetxt(path, np.column_stack([T, *columns.values()]), delimiter=",", header=",".join(names), comments="")
    return survey(path).table


def _swing(rate: float, size: float = 1.0) -> np.ndarray:
    return np.asarray(size * np.sin(rate * T) + 0.1 * size * np.cos(7.3 * rate * T))


@pytest.mark.parametrize("part", ["passive", "constraint", "rigid", "feedforward"])
def test_the_whole_torque_is_taken_and_not_a_part_of_a_model(tmp_path: Path, part: str) -> None:
    own = {f"tau_{part}_{k}": _swing(2.0 + k) for k in (1, 2)}
    text = _table(tmp_path, q_1=_swing(2.0), q_2=_swing(3.0), **own, tau_1=_swing(2.5, 4.0), tau_2=_swing(3.5, 3.0))
    assert tomllib.loads(text)["channels"]["torque"]["channels"] == ["tau_1", "tau_2"]


@pytest.mark.parametrize(("name", "taken"), [("u", "I_mot"), ("u [Nm]", "u [Nm]"), ("tau", "tau")])
def test_a_measured_current_is_taken_before_an_input_that_may_be_a_voltage(
    tmp_path: Path, name: str, taken: str
) -> None:
    text = _table(tmp_path, theta=_swing(2.0), **{name: _swing(2.2, 0.5)}, I_mot=_swing(2.2, 1.3))
    assert tomllib.loads(text)["channels"]["torque"]["channels"] == [taken]
    assert f"# also there: {({name, 'I_mot'} - {taken}).pop()}" in text


def test_an_input_alone_is_taken(tmp_path: Path) -> None:
    text = _table(tmp_path, theta=_swing(2.0), u=_swing(2.2, 0.5))
    assert tomllib.loads(text)["channels"]["torque"]["channels"] == ["u"]


@pytest.mark.parametrize(
    ("rate", "drafted"), [("phidot", False), ("thetadot", True), ("dtheta", True), ("omega", True)]
)
def test_the_rate_of_another_angle_is_none_of_the_position(tmp_path: Path, rate: str, drafted: bool) -> None:
    text = _table(tmp_path, theta=_swing(2.0), **{rate: _swing(2.0, 2.0)}, tau=_swing(2.2))
    assert ("velocity" in tomllib.loads(text)["channels"]) is drafted


def test_torques_of_another_topic_are_named_with_it(tmp_path: Path) -> None:
    said = []
    for k, (t, q) in enumerate(zip(T, _swing(2.0), strict=True)):
        stamp = recorders.START + round(1e9 * t)
        said += [
            ("/joints", stamp, json.dumps({"position": [q], "torque": [2 * q + 0.01 * (k % 2)]}).encode()),
            ("/estimate", stamp, json.dumps({"torque": [1.9 * q]}).encode()),
        ]
    schemas = {topic: (topic[1:], "jsonschema", b"{}", "json") for topic in ("/joints", "/estimate")}
    text = survey(recorders.mcap(tmp_path / "run.mcap", said, schemas)).table
    assert "# also there: /estimate.torque[1]" in text
