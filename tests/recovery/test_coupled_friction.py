"""Coupled motors: friction of the joints between them is found, and channels that are of the motors."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import haptid
from haptid.advice import advise
from haptid.inference.diagnosis.lack_of_fit import coupled_coordinates, friction_coordinates
from motions import multisine

ARM = """
schema = 1
name = "coupled arm"
gravity = [0.0, -9.81, 0.0]
[[joints]]
name = "1"
[[joints]]
name = "2"
d = 0.3
[[motors]]
name = "1"
[[motors]]
name = "2"
drives = { 1 = 1, 2 = 1 }
[[terms]]
kind = "viscous"
motors = "all"
[[terms]]
kind = "coulomb"
motors = "all"
"""
JOINT = '[[terms]]\nkind = "coulomb"\njoints = ["2"]\n'


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A log of the arm with friction in joint 2, and a study whose device file lacks it."""
    folder = tmp_path_factory.mktemp("arm")
    (folder / "device.toml").write_text(ARM)
    (folder / "true.toml").write_text(ARM + JOINT)
    model = haptid.DynamicModel(haptid.read_device(folder / "true.toml"))
    values = {"ZZ1R": 0.15, "ZZ2": 0.04, "MX1R": 0.6, "MX2": 0.15, "FCM1": 0.1, "FCM2": 0.05, "FC2": 0.15}
    beta = np.array([values.get(name, 0.01 if name.startswith("FV") else 0.0) for name in model.base.names])
    rng = np.random.default_rng(2)
    q, qd, qdd = multisine(2, 20.0, 2e-3, 3)
    tau = haptid.inverse_dynamics(model, beta, q, qd, qdd)
    tau = tau + 0.02 * tau.std(axis=1, keepdims=True) * rng.standard_normal(tau.shape)
    columns = [2e-3 * np.arange(q.shape[1]), *1e-4 * np.round(q / 1e-4), *tau]
    np.savetxt(folder / "log.csv", np.array(columns).T, delimiter=",", header="t,q1,q2,tau1,tau2", comments="")
    (folder / "study.toml").write_text(
        'schema = 1\ndevice = "device.toml"\n[channels]\ntime = "t"\n'
        'position = { channels = ["q1", "q2"], unit = "rad" }\n'
        'torque = { channels = ["tau1", "tau2"], unit = "N m", side = "motor" }\n[[logs]]\npath = "log.csv"\n'
    )
    return folder


def test_joints_of_coupled_motors_are_places_of_friction(recorded: Path) -> None:
    model = haptid.DynamicModel(haptid.read_device(recorded / "device.toml"))
    known = friction_coordinates(model, [0, 1])
    (joint,) = coupled_coordinates(model, [0, 1], known)
    assert joint.label == "joint 2"
    np.testing.assert_allclose(joint.weights, [-1.0, 1.0])
    plain = haptid.DynamicModel(haptid.read_device("arm3"))
    assert coupled_coordinates(plain, [0, 1, 2], friction_coordinates(plain, [0, 1, 2])) == ()


def test_friction_of_a_joint_is_advised_and_its_study_is_better(recorded: Path) -> None:
    study = haptid.read_study(recorded / "study.toml")
    found = haptid.identify(study)
    made = advise(found)
    first = made.actions[0]
    assert (first.kind, first.places) == ("coulomb", ("joint 2",)), made.sentences
    assert first.edits[0].value == {"kind": "coulomb", "joints": ["2"]}
    assert first.after < 0.6 * first.before


def test_channels_of_the_motors_that_a_study_takes_for_those_of_the_joints_are_named(
    recorded: Path, tmp_path: Path
) -> None:
    (tmp_path / "device.toml").write_text((recorded / "true.toml").read_text())
    table = np.loadtxt(recorded / "log.csv", delimiter=",", skiprows=1)
    table[:, 2] += table[:, 1]  # the second motor turns with the first joint
    np.savetxt(tmp_path / "log.csv", table, delimiter=",", header="t,q1,q2,tau1,tau2", comments="")
    text = (recorded / "study.toml").read_text().replace(', side = "motor"', "")
    (tmp_path / "study.toml").write_text(text)
    found = haptid.identify(haptid.read_study(tmp_path / "study.toml"))
    (side,) = advise(found).actions
    assert (side.kind, [edit.value for edit in side.edits]) == ("side", ["motor", "motor"])
    assert "take the positions and torques as those of the motors" in side.change
    study = tmp_path / "study.toml"
    study.write_text(text.replace('unit = "rad"', 'unit = "rad", side = "motor"').replace("N m", 'N m", side = "motor'))
    right = haptid.identify(haptid.read_study(study))
    assert right.unseen[0].comparable.relative < 0.5 * found.unseen[0].comparable.relative
    assert all(action.kind != "side" for action in advise(right).actions)


def test_a_motion_that_does_not_determine_the_model_for_another_log_is_named(recorded: Path, tmp_path: Path) -> None:
    """One tone for both joints: columns are alike in the fit, and other motion is predicted badly."""
    model = haptid.DynamicModel(haptid.read_device(recorded / "true.toml"))
    values = {"ZZ1R": 0.15, "ZZ2": 0.04, "MX1R": 0.6, "MX2": 0.15, "FCM1": 0.1, "FCM2": 0.05, "FC2": 0.15}
    beta = np.array([values.get(name, 0.01 if name.startswith("FV") else 0.0) for name in model.base.names])
    t, w, size = 2e-3 * np.arange(10_000), 2 * np.pi * 0.8, 0.02
    x = w * t + np.array([[0.0], [1.2]])
    q, qd, qdd = size * np.sin(x), w * size * np.cos(x), -w * w * size * np.sin(x)
    tau = haptid.inverse_dynamics(model, beta, q, qd, qdd)
    tau = tau + 0.05 * tau.std(axis=1, keepdims=True) * np.random.default_rng(4).standard_normal(tau.shape)
    columns = np.array([t, *1e-5 * np.round(q / 1e-5), *tau]).T
    np.savetxt(tmp_path / "tone.csv", columns, delimiter=",", header="t,q1,q2,tau1,tau2", comments="")
    (tmp_path / "log.csv").write_bytes((recorded / "log.csv").read_bytes())
    (tmp_path / "device.toml").write_text((recorded / "true.toml").read_text())
    text = (recorded / "study.toml").read_text()
    study = text.replace('"log.csv"', '"tone.csv"') + '[[logs]]\npath = "log.csv"\nrole = "validate"\n'
    (tmp_path / "study.toml").write_text(study)
    made = advise(haptid.identify(haptid.read_study(tmp_path / "study.toml")))
    assert any("does not determine the model" in sentence for sentence in made.sentences), made.sentences
    (tmp_path / "study.toml").write_text(text + '[[logs]]\npath = "tone.csv"\nrole = "validate"\n')
    made = advise(haptid.identify(haptid.read_study(tmp_path / "study.toml")))
    assert not any("does not determine the model" in sentence for sentence in made.sentences)
