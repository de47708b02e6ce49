"""Motors of an arm whose torque channels are reversed: which ones, by friction that cannot be negative."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pytest

import haptid
from haptid.advice import advise
from haptid.advice import apply_advice as applied
from motions import multisine
from true_parameters import true_parameters

DEVICE = """
schema = 1
name = "three links"
gravity = [0.0, -9.81, 0.0]
[[joints]]
name = "1"
[[joints]]
name = "2"
d = 0.3
[[joints]]
name = "3"
d = 0.25
[[terms]]
kind = "viscous"
joints = "all"
[[terms]]
kind = "coulomb"
joints = "all"
"""
STUDY = """
schema = 1
name = "three links"
device = "device.toml"
[channels]
time = "t"
position = { channels = ["q1", "q2", "q3"], unit = "rad" }
torque = { channels = ["tau1", "tau2", "tau3"], unit = "N m" }
[[logs]]
path = "log.csv"
"""


def identified(folder: Path, wrong: tuple[int, ...], slowdown: float, noise: float) -> haptid.Identification:
    """A log in slowed motion with these motors' torques reversed, carried out as it is."""
    (folder / "device.toml").write_text(DEVICE)
    (folder / "study.toml").write_text(STUDY)
    model = haptid.DynamicModel(haptid.read_device(folder / "device.toml"))
    q, qd, qdd = multisine(3, 60 / slowdown, 0.01 / slowdown, 1, 1.0)
    beta = model.base.of(true_parameters(model, FV=0.3, FC=0.4))
    tau = haptid.inverse_dynamics(model, beta, q, qd / slowdown, qdd / slowdown**2)
    tau[list(wrong)] *= -1
    tau += noise * np.random.default_rng(1).standard_normal(tau.shape)
    table = {"t": 0.01 * np.arange(q.shape[1])}
    table |= {f"{name}{k + 1}": row for name, rows in (("q", q), ("tau", tau)) for k, row in enumerate(rows)}
    pyarrow.csv.write_csv(pa.table(table), folder / "log.csv")
    return haptid.identify(haptid.read_study(folder / "study.toml"))


@pytest.mark.parametrize(
    ("slowdown", "noise"),
    [
        (5.0, 0.05),  # reversing motor 1 would predict as well, with all bodies negative
        (40.0, 0.5),  # too slow for the inertia, whose sign is then that of its error
    ],
)
def test_coupled_motors_are_reversed_together_and_the_others_are_not(
    tmp_path: Path, slowdown: float, noise: float
) -> None:
    found = identified(tmp_path, (1, 2), slowdown, noise)
    made = advise(found)
    (action,) = made.actions
    assert (action.kind, action.places, action.proof) == ("torque sign", ("motor 2", "motor 3"), "unseen error")
    assert made.before - made.after > 2 * action.se
    after = applied(made, found, tmp_path / "out")
    assert after is not None
    friction = [after.identification.estimate[f"FC{k}"] for k in (2, 3)]
    assert [p.value for p in friction] == pytest.approx([0.4, 0.4], rel=0.1)


def test_right_channels_are_left_alone(tmp_path: Path) -> None:
    made = advise(identified(tmp_path, (), 40.0, 0.5))
    assert not [action for action in made.actions if action.kind == "torque sign"]
