"""Passive joints that follow by polynomials: rates, torques, simulators and written code."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import haptid
from closed_devices import CAM, RELATIONS
from compiled import named, relative
from haptid.device import FormulaClosure
from haptid.errors import DeviceFileError, ExportError, RegroupingError
from haptid.export import export_model
from haptid.export.expressions.rewriting import values_of
from haptid.export.model.functions import code_of
from haptid.export.selftest import ReferenceValues
from haptid.robot_files import import_robot
from true_parameters import true_parameters

PRODUCT, POWER = "q4 = q2 - q3 + 0.2*q1*q3", "q4 = -q3/2 + k*q3**4"
LENGTHS = "[lengths]\nk = 0.1\n"


def device(folder: Path, more: str) -> haptid.DynamicModel:
    (folder / "cam.toml").write_text(CAM + more)
    return haptid.DynamicModel(haptid.read_device(folder / "cam.toml"))


@pytest.fixture
def cam(tmp_path: Path) -> haptid.DynamicModel:
    return device(tmp_path, RELATIONS.format(PRODUCT))


def test_torques_are_those_of_the_open_tree_by_virtual_work(tmp_path: Path, cam: haptid.DynamicModel) -> None:
    """The relations are written out once more here; velocities and accelerations of all joints are differences."""

    def all_joints(t: np.ndarray) -> np.ndarray:
        q1, q3 = 0.3 * np.sin(2 * t) + 0.2, 0.5 * np.cos(3 * t)
        q2 = 0.1 + 0.8 * q1 - 0.3 * q1**2 + 0.05 * q1**3
        return np.array([q1, q2, q3, q2 - q3 + 0.2 * q1 * q3])

    t, h = np.linspace(0, 2, 40), 1e-4
    before, q, after = (all_joints(t + s) for s in (-h, 0, h))
    qd, qdd = (after - before) / (2 * h), (after - 2 * q + before) / h**2
    slope = 0.8 - 0.6 * q[0] + 0.15 * q[0] ** 2
    one, zero = np.ones_like(t), np.zeros_like(t)
    G = np.array([[one, zero], [slope, zero], [zero, one], [slope + 0.2 * q[2], -1 + 0.2 * q[0]]])
    tree = device(tmp_path, "")
    chi = true_parameters(tree)
    wanted = np.einsum("jas,js->as", G, haptid.inverse_dynamics(tree, tree.base.of(chi), q, qd, qdd))
    found = haptid.inverse_dynamics(cam, cam.base.of(chi), q[[0, 2]], qd[[0, 2]], qdd[[0, 2]])
    np.testing.assert_allclose(found, wanted, atol=3e-7 * np.abs(wanted).max())
    assert isinstance(cam.device.closure, FormulaClosure)
    assert cam.device.closure.relations[1] == "q4 = 0.1 + 0.8*q1 - 1*q3 - 0.3*q1**2 + 0.2*q1*q3 + 0.05*q1**3"
    with pytest.raises(RegroupingError, match="polynomials"):
        _ = cam.regroupings


def test_written_code_is_the_model(cam: haptid.DynamicModel) -> None:
    beta, code = cam.base.of(true_parameters(cam)), code_of(cam, 0.05)
    reference = ReferenceValues.at_random(cam, beta, 0.05, 30)
    for function in code.functions:
        kept = reference.at(np.flatnonzero(reference.sound(function.name)))
        assert kept.q.shape[1] > 15
        values = named(beta, **kept.inputs)
        wanted = kept.functions[function.name]()
        for output, entries in function.outputs:
            made = [np.broadcast_to(x, kept.q.shape[1]) for x in values_of(code.graph, list(entries), values)]
            if output in wanted:
                assert relative(np.array(made).T, wanted[output]) < 1e-9, (function.name, output)


def test_mujoco_has_the_same_relations_there_and_back(tmp_path: Path, cam: haptid.DynamicModel) -> None:
    """Equalities of MuJoCo vanish on the device's motion, also about a start that is not zero; read again it is the
    device."""
    mujoco = pytest.importorskip("mujoco")
    model = device(tmp_path, LENGTHS + RELATIONS.format(POWER))
    chi = true_parameters(model)
    export_model((model, model.base.of(chi)), tmp_path / "out", ["mjcf"], anyway=True)
    (path,) = (tmp_path / "out").rglob("*.xml")
    there = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(there)
    qa = np.random.default_rng(0).uniform(-0.9, 0.9, (2, 20))
    for q in model.device.closure.positions(qa).T:
        data.qpos[:] = q
        mujoco.mj_forward(there, data)
        rows = data.efc_type == int(mujoco.mjtConstraint.mjCNSTR_EQUALITY)
        assert rows.sum() == 2
        assert np.abs(data.efc_pos[rows]).max() < 1e-12
    back = import_robot(path, ask=True)
    np.testing.assert_allclose(back.device.closure.positions(qa), model.device.closure.positions(qa), atol=1e-12)
    with pytest.raises(ExportError, match="follows 2 joints by a polynomial"):
        export_model((cam, cam.base.of(chi)), tmp_path / "product", ["mjcf"], anyway=True)


@pytest.mark.parametrize(
    ("relation", "said"),
    [
        ("q4 = q3**0.5", "a power other than"),
        ("q4 = 1/q3", "divides by an unknown"),
        ("q4 = q3**13", "a power other than"),
        ("q4 = (q1 + q3)**9 * q3**9", "degree is above 12"),
        ("q4 = sin(q3)", "is not allowed here"),
        ("q4 = q4**2", "uses q4, which has none, or they are circular"),
        ("q4 = q2**11", "relations put into each other"),
        ("q4 = 1e300*q3*1e300", "beyond"),
    ],
)
def test_relations_that_are_no_polynomials(tmp_path: Path, relation: str, said: str) -> None:
    with pytest.raises(DeviceFileError, match=said):
        device(tmp_path, RELATIONS.format(relation))
