"""Exports keep the joints' names of the robot description, sums of positions with springs, and ball joints of loops."""

from __future__ import annotations

import json
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

import haptid
from deltas import delta_device
from haptid.experiment.bench.mjcf import depth_first, mjcf
from haptid.export import export_json, export_mjcf, export_urdf
from true_parameters import true_parameters

mujoco = pytest.importorskip("mujoco")

BELT = """
name = "belt"
gravity = [0, -9.81, 0]
[[joints]]
name = "shoulder_1"
alias = "shoulder/1"
[[joints]]
name = "elbow"
d = 0.3
[[joints]]
name = "wrist_2"
alias = "wrist 2"
d = 0.2
[[loops]]
relations = ["qwrist_2 = -0.5*qelbow + 0.2"]
[[coordinates]]
name = "belt"
joints = { shoulder_1 = 0.8, elbow = -0.5, wrist_2 = 0.4 }
[[terms]]
kind = "spring"
coordinates = ["belt"]
rest = 0.1
[[terms]]
kind = "viscous"
coordinates = ["belt"]
[[terms]]
kind = "rotor-inertia"
coordinates = ["belt"]
"""


def belt(folder: Path) -> haptid.DynamicModel:
    (folder / "belt.toml").write_text(BELT)
    return haptid.DynamicModel(haptid.read_device(folder / "belt.toml"))


def test_names_of_the_description_are_kept(tmp_path: Path) -> None:
    model = belt(tmp_path)
    beta = model.base.of(true_parameters(model))
    wanted = ["shoulder/1", "elbow", "wrist 2"]
    built = mujoco.MjModel.from_xml_path(str(tmp_path / "m" / export_mjcf((model, beta), tmp_path / "m").files[0]))
    assert [built.joint(k).name for k in range(3)] == wanted
    made = export_urdf((model, beta), tmp_path / "u")
    root = ElementTree.parse(tmp_path / "u" / made.files[0]).getroot()
    assert [x.get("name") for x in root.findall("joint") if x.get("type") == "continuous"] == [
        "shoulder_1",
        "elbow",
        "wrist_2",
    ]
    assert root.find("joint/mimic").get("joint") == "elbow"
    made = export_json((model, beta), tmp_path / "j")
    data = json.loads((tmp_path / "j" / next(x for x in made.files if x.endswith(".json"))).read_text())
    assert [joint["alias"] for joint in data["joints"]] == wanted
    assert "wrist 2" in haptid.device.summary_lines(model.device)[-1] or any(
        "wrist 2" in line for line in haptid.device.summary_lines(model.device)
    )


def test_forces_on_a_sum_of_positions_are_those_of_a_tendon_of_mujoco(tmp_path: Path) -> None:
    """Spring, damping and inertia of a belt over an active, another active, and a passive joint with an offset."""
    model = belt(tmp_path)
    chi = true_parameters(model)
    chi[[model.device.parameters.names.index(name) for name in ("Kbelt", "FVbelt", "IAbelt")]] = 30.0, 0.4, 0.02
    built = mujoco.MjModel.from_xml_string(mjcf(model, chi))
    built.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_EQUALITY)
    data, rng = mujoco.MjData(built), np.random.default_rng(2)
    qa, qda, qdda = rng.uniform(-1, 1, (3, 2, 5))
    q, qd, qdd = model.tree(qa, qda, qdda)
    order = list(depth_first(model))
    tau = haptid.inverse_dynamics(model, model.base.of(chi), qa, qda, qdda)
    for k in range(5):
        data.qpos[:], data.qvel[:], data.qacc[:] = q[order, k], qd[order, k], qdd[order, k]
        mujoco.mj_inverse(built, data)
        np.testing.assert_allclose(model.device.rates[order].T @ data.qfrc_inverse, tau[:, k], rtol=1e-8)


def test_ball_joints_of_loops_are_pins_of_the_simulator(tmp_path: Path) -> None:
    """A delta with six ball rods: each spherical cut is one pin, whose ends meet wherever the loops close."""
    (tmp_path / "delta.toml").write_text(delta_device())
    model = haptid.DynamicModel(haptid.read_device(tmp_path / "delta.toml"))
    built = mujoco.MjModel.from_xml_string(mjcf(model, np.nan_to_num(model.device.chi_prior)))
    assert built.neq == 5
    q = model.device.closure.positions(np.array([[0.2], [-0.1], [0.3]]))[:, 0]
    data = mujoco.MjData(built)
    data.qpos[:] = q[list(depth_first(model))]
    mujoco.mj_forward(built, data)
    assert np.abs(data.efc_pos[: data.ne]).max() < 1e-10
