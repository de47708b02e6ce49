"""Slip and limit cycles as advice: the parts are left out where the other rows are then predicted better."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pytest

import haptid
from elastic_motors import STEP, TERMS, K, recorded
from haptid.advice import advise, apply_advice
from haptid.study.identify import Identification, identify
from haptid.study.read import read_study

VISCOUS = [{"kind": "viscous", "joints": "all"}]


def identified(folder: Path, log: haptid.Log, terms: list[dict[str, str]], names: tuple[str, ...]) -> Identification:
    """A study of one axis about the vertical, whose positions have these names, on a log."""
    made = [f"[[terms]]\n{key_values(term)}" for term in terms]
    device = 'schema = 1\nname = "axis"\ngravity = [0.0, 0.0, -9.81]\n[[joints]]\nname = "1"\n'
    (folder / "device.toml").write_text(device + "".join(made))
    side = "motor" if len(names) == 2 else "joint"
    (folder / "study.toml").write_text(
        'schema = 1\nname = "axis"\ndevice = "device.toml"\n[[logs]]\npath = "log.csv"\n[channels]\ntime = "t"\n'
        f'position = {{ channels = {json.dumps(names)}, unit = "rad" }}\n'
        f'torque = {{ channels = ["u"], unit = "N m", side = "{side}" }}\n'
    )
    columns = {"t": log.t, **dict(zip(names, log.position.T, strict=True)), "u": log.torque[:, 0]}
    pyarrow.csv.write_csv(pa.table(columns), folder / "log.csv")
    return identify(read_study(folder / "study.toml"))


def key_values(term: dict[str, str]) -> str:
    return "".join(f"{key} = {json.dumps(value)}\n" for key, value in term.items())


def slipped(size: float) -> haptid.Log:
    """Both sides of the elastic axis, whose motor's encoder reads more from 7 s of 10 on, by whole steps."""
    log = recorded(seconds=10.0)
    position = np.array(log.position)
    position[log.t >= 7.0, 1] += STEP * round(size / STEP)
    return replace(log, position=position)


def swinging(size: float) -> haptid.Log:
    """A rotor that moves its link for 9 s, and for 4 s is held and swings within the play that the link leaves it."""
    dt, rng = 1e-3, np.random.default_rng(3)
    t = dt * np.arange(13_000)
    f, phase = np.array([0.3, 0.7, 1.1, 1.9]), rng.uniform(0, 2 * np.pi, 4)
    wave = np.exp(2j * np.pi * f[:, None] * t + 1j * phase[:, None]) / f[:, None]
    q = 0.3 * wave.imag.sum(axis=0) * 0.5 * (1 + np.cos(np.pi * np.clip(t - 8.0, 0, 1)))
    q += size * np.sin(2 * np.pi * 7.3 * (t - 9.0)) * (t >= 9.0)
    v = np.gradient(q, dt)
    torque = np.where(t < 9.0, 0.1, 0.03) * np.gradient(v, dt) + 0.2 * v + 0.02 * rng.standard_normal(len(t))
    step = 2 * np.pi / 80_000
    channels = haptid.Channels(haptid.Signal(("q",), "rad"), haptid.Signal(("u",), "N m"), "t")
    return haptid.Log(Path("made"), "", t, (step * np.round(q / step))[:, None], torque[:, None], channels)


def test_what_lies_behind_a_slip_is_left_out(tmp_path: Path) -> None:
    found = identified(tmp_path, slipped(0.02), TERMS, ("q", "theta"))
    made = advise(found)
    (action,) = (one for one in made.actions if one.kind == "slip")
    assert action.places == ("motor 1",)
    assert action.after < 0.5 * action.before
    after = apply_advice(made, found, tmp_path / "out")
    assert after is not None
    (log,) = after.identification.study.logs
    ((start, stop),) = log.exclude
    assert 6.9 < start < 7.0
    assert stop == pytest.approx(9.999)
    assert after.identification.estimate["KE1"].value == pytest.approx(K, rel=0.01)
    assert found.estimate["KE1"].value < 0.9 * K


def test_a_limit_cycle_is_left_out(tmp_path: Path) -> None:
    found = identified(tmp_path, swinging(0.004), VISCOUS, ("q",))
    made = advise(found)
    (action,) = (one for one in made.actions if one.kind == "limit cycle")
    assert action.places == ("joint 1",)
    (edit,) = action.edits
    ((start, stop),) = edit.value
    assert start == pytest.approx(9.0)
    assert stop == pytest.approx(12.999)
    assert action.after < 0.5 * action.before


@pytest.mark.parametrize(("log", "names"), [(slipped(0.0), ("q", "theta")), (swinging(0.0), ("q",))])
def test_nothing_is_left_out_of_right_logs(log: haptid.Log, names: tuple[str, ...], tmp_path: Path) -> None:
    made = advise(identified(tmp_path, log, TERMS if len(names) == 2 else VISCOUS, names))
    assert not {action.kind for action in made.actions} & {"slip", "limit cycle"}
