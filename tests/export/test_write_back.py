"""Identified parameters in a user's own URDF or MJCF: the same torques, and every other byte as it was."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

import haptid
from haptid._internal.arrays import Array
from haptid.errors import ExportError, SettingError
from haptid.export import export_into, export_model
from haptid.export.formats.bodies import standard_parameters_of
from haptid.robot_files import import_robot
from oracle.test_robot_files_against_peers import HARD
from unit.test_robot_files import ARM


def identified(path: Path, form: str) -> tuple[haptid.DynamicModel, Array]:
    """The device of a description, and base parameters other than those of the description."""
    device = import_robot(path).device
    model = haptid.DynamicModel(device)
    chi = np.array(device.chi_prior)
    rng = np.random.default_rng(1)
    friction = [name.startswith(("FV", "FC")) for name in device.parameters.names]
    if form == "urdf":
        assert np.isnan(chi).sum() == 2  # friction of the elbow, of which the file says nothing
    chi = np.where(np.isnan(chi), 0.3, chi)
    for j in range(len(device.joints)):  # every body lighter or heavier, of the same shape
        names = [kind + device.joints[j].name for kind in ("XX", "XY", "XZ", "YY", "YZ", "ZZ", "MX", "MY", "MZ", "M")]
        columns = [device.parameters.names.index(name) for name in names if name in device.parameters.names]
        chi[columns] *= rng.uniform(0.8, 1.3)
    chi[friction] *= 1.5
    return model, model.base.of(chi)


def torque(model: haptid.DynamicModel, beta: Array, states: Array) -> Array:
    return haptid.inverse_dynamics(model, beta, *states)


@pytest.mark.parametrize(("form", "text"), [("urdf", ARM), ("mjcf", HARD)])
def test_a_copy_has_the_torques_of_the_model(tmp_path: Path, form: str, text: str) -> None:
    path = tmp_path / "robot.xml"
    path.write_text(text)
    model, beta = identified(path, form)
    export_into((model, beta), tmp_path / "out", path, form)
    again = import_robot(tmp_path / "out" / "robot.xml", ask=True)
    other = haptid.DynamicModel(again.device)
    chi, written = standard_parameters_of(model, beta), np.nan_to_num(again.device.chi_prior)
    if form == "urdf":  # it has no rotors: the file's own transmission keeps its own
        for values, names in ((chi, model.device.parameters.names), (written, again.device.parameters.names)):
            values[[name.startswith("IA") for name in names]] = 0.0
    states = np.random.default_rng(2).uniform(-1, 1, (3, len(model.device.active), 25))
    wanted = torque(model, model.base.of(chi), states)
    found = torque(other, other.base.of(written), states)
    assert np.abs(found - wanted).max() < 1e-9 * np.abs(wanted).max()
    assert np.abs(found - torque(model, model.prior_beta, states)).max() > 0.1


def test_everything_else_stays_byte_for_byte(tmp_path: Path) -> None:
    path = tmp_path / "arm.urdf"
    path.write_text(ARM)
    model, beta = identified(path, "urdf")
    export_into((model, beta), tmp_path / "out", path, "urdf")
    made = (tmp_path / "out" / "arm.urdf").read_text()
    assert "Not in this file: rotor inertia" in made
    kinds = (r"<inertial>.*?</inertial>", r"<dynamics[^>]*/>", r"<!--\n.*?-->\n")
    stripped = [re.sub("|".join(kinds), "", x, flags=re.DOTALL) for x in (ARM, made)]
    stripped[0] = stripped[0].replace('<link name="fore"/>', '<link name="fore"></link>')  # it had no inertia
    assert "".join(stripped[0].split()) == "".join(stripped[1].split())
    assert "<!-- kept -->" in made


def test_a_urdf_that_xacro_has_written_is_edited_and_friction_of_zero_stays_zero(tmp_path: Path) -> None:
    """Its name space alone, and macros in comments, make it no xacro file."""
    path = tmp_path / "arm.urdf"
    start = '<robot xmlns:xacro="http://www.ros.org/wiki/xacro" '
    path.write_text(ARM.replace("<robot ", start).replace("<!-- kept -->", "<!-- ${kept} <xacro:x/> -->"))
    model, _ = identified(path, "urdf")
    chi = np.nan_to_num(model.device.chi_prior)
    friction = np.array([name.startswith(("FV", "FC")) for name in model.device.parameters.names])
    export_into((model, model.base.of(np.where(friction, 0.0, chi))), tmp_path / "out", path, "urdf")
    made = (tmp_path / "out" / "arm.urdf").read_text()
    assert start in made
    assert set(re.findall(r'(?:damping|friction)="([^"]*)"', made)) <= {"0", "0.0"}


def test_a_file_of_another_robot_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "arm.urdf"
    path.write_text(ARM)
    given = identified(path, "urdf")
    for old, new, said in (
        ('name="rail"', 'name="slide"', "rail"),
        ("0.4 0 0", "0.5 0 0", "placements differ by 1.0e-01|placements differ from the device's by 1.0e-01"),
    ):
        path.write_text(ARM.replace(old, new))
        with pytest.raises(ExportError, match=said):
            export_into(given, tmp_path / "out", path, "urdf")
    path.write_text(ARM)
    with pytest.raises(ExportError, match="MJCF"):
        export_into(given, tmp_path / "out", path, "mjcf")
    with pytest.raises(SettingError, match="urdf and mjcf"):
        export_model(given, tmp_path / "out", ["c"], into=path)
    assert not (tmp_path / "out").exists()
