"""Names of joints in lists, and the rate as one number, beside matrices of samples."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from scipy import io
from typer.testing import CliRunner

from haptid.cli import app
from haptid.log import read_log
from haptid.log.survey import survey
from haptid.log.survey.beside import stated_rate

DT = 0.004
NAMES = ("elbow", "shoulder", "wrist")
T = np.arange(0.0, 8.0, DT)
Q = np.column_stack([np.sin((1.0 + 0.3 * k) * T + k) for k in range(3)])
TAU = np.column_stack([3 * np.cos((1.0 + 0.3 * k) * T) + k for k in range(3)])
DEVICE = """
name = "arm"
gravity = [0, 0, -9.81]
convention = "placement"
joints = [
    { name = "shoulder", axis = [0, 0, 1] }, { name = "elbow", axis = [0, 1, 0] }, { name = "wrist", axis = [0, 1, 0] },
]
"""


def npz(path: Path) -> None:
    np.savez(path, q=Q.T, tau=TAU.T, joint_names=np.array(NAMES), dt=DT)


def mat(path: Path) -> None:
    io.savemat(path, {"log": {"q": Q, "tau": TAU, "names": np.array(NAMES, dtype=object), "fs": 1 / DT}})


def mat_of_letters(path: Path) -> None:
    io.savemat(path, {"q": Q, "tau": TAU, "jointNames": np.char.ljust(NAMES, 8), "sampleTime": DT})


def mat_of_level_4(path: Path) -> None:
    names = np.char.ljust(NAMES, 8)
    io.savemat(path, {"q": Q, "tau": TAU, "joint_names": names, "fs": 1 / DT, "note": "by hand"}, format="4")


def hdf5(path: Path) -> None:
    with h5py.File(path, "w") as file:
        file["q"], file["tau"] = Q, TAU
        file["joint_names"] = [name.encode() for name in NAMES]
        file["sampling_rate"] = 1 / DT


def attributes(path: Path) -> None:
    with h5py.File(path, "w") as file:
        group = file.create_group("run/arm")
        group["q"], group["tau"] = Q, TAU
        group.attrs["joint_names"], file.attrs["dt_ms"] = list(NAMES), 1e3 * DT


def drafted(tmp_path: Path, log: Path) -> dict[str, Any]:
    """The `[channels]` of the drafted study."""
    (tmp_path / "device.toml").write_text(DEVICE)
    out = tmp_path / "study.toml"
    made = CliRunner().invoke(app, ["channels", str(log), "--device", str(tmp_path / "device.toml"), "--out", str(out)])
    assert made.exit_code == 0, made.output
    channels: dict[str, Any] = tomllib.loads(out.read_text())["channels"]
    return channels


@pytest.mark.parametrize(
    ("write", "suffix"),
    [
        (npz, "npz"),
        (mat, "mat"),
        (mat_of_letters, "mat"),
        (mat_of_level_4, "mat"),
        (hdf5, "h5"),
        (attributes, "hdf5"),
    ],
)
def test_joints_are_those_of_the_list_beside_the_arrays(tmp_path: Path, write: Any, suffix: str) -> None:
    """They stood in the order of the columns, which is another one than the device's, without a word."""
    log = tmp_path / f"log.{suffix}"
    write(log)
    found = drafted(tmp_path, log)
    assert found["position"]["joints"] == found["torque"]["joints"] == [2, 1, 3]
    assert found["rate_hz"] == pytest.approx(1 / DT)


def test_columns_of_one_matrix_are_what_a_list_calls_them(tmp_path: Path) -> None:
    columns = ["t [ms]", *(f"q_{name} [deg]" for name in NAMES), *(f"tau_{name}" for name in NAMES)]
    np.savez(tmp_path / "log.npz", data=np.column_stack([1e3 * T, np.rad2deg(Q), TAU]), columns=np.array(columns))
    found = drafted(tmp_path, tmp_path / "log.npz")
    assert (found["time"], found["time_unit"]) == ("data[1]", "ms")
    assert (found["position"]["joints"], found["position"]["unit"]) == ([3, 2, 4], "deg")
    assert found["torque"]["joints"] == [6, 5, 7]


def test_torques_are_those_of_the_list_of_motors(tmp_path: Path) -> None:
    lists = {"joint_names": np.array(NAMES), "motor_names": np.array(["wrist", "elbow", "shoulder"])}
    np.savez(tmp_path / "log.npz", t=T, q=Q, tau=TAU, **lists)
    found = drafted(tmp_path, tmp_path / "log.npz")
    assert (found["position"]["joints"], found["torque"]["joints"]) == ([2, 1, 3], [3, 2, 1])


def test_lists_of_something_else_name_no_joints(tmp_path: Path) -> None:
    np.savez(tmp_path / "log.npz", t=T, q=Q, tau=TAU, operators=np.array(["ann", "bob", "eve"]), joint_names=["a", "b"])
    assert {channel.joint for channel in survey(tmp_path / "log.npz").topics[0].channels} == {""}


def test_a_rate_that_velocities_contradict_is_said(tmp_path: Path) -> None:
    rates = np.gradient(Q, DT, axis=0)
    np.savez(tmp_path / "log.npz", q=Q, qd=rates, tau=TAU, dt=0.001)
    table = survey(tmp_path / "log.npz").table
    assert tomllib.loads(table)["channels"]["rate_hz"] == pytest.approx(1 / DT)
    assert "the file states dt = 0.001, which is another one" in table


def test_numbers_that_disagree_state_no_rate() -> None:
    assert stated_rate({"dt": np.array([DT]), "fs": np.array([1 / DT])})[0] == pytest.approx(1 / DT)
    assert stated_rate({"dt": np.array([DT]), "control_rate": np.array([1000.0])}) == (0.0, "")
    assert stated_rate({"mass": np.array([2.0]), "fs": np.array([0.0]), "name": np.array(["x"])}) == (0.0, "")


@pytest.mark.parametrize(("name", "value"), [("freq", 2.0), ("Fs", 5.2), ("rate", 3.0), ("period", 0.5)])
def test_a_frequency_of_the_motion_or_static_friction_is_no_rate(name: str, value: float) -> None:
    assert stated_rate({name: np.array([value])}) == (0.0, "")


def test_names_of_trials_are_none_of_joints(tmp_path: Path) -> None:
    np.savez(tmp_path / "log.npz", t=T, q=Q, tau=TAU, trial_names=np.array(["slow", "mid", "fast"]))
    assert {channel.joint for channel in survey(tmp_path / "log.npz").topics[0].channels} == {""}


def test_titles_of_columns_are_no_joints(tmp_path: Path) -> None:
    columns = ["t", *(f"q_{name} [deg]" for name in NAMES), *(f"tau_{name}" for name in NAMES)]
    np.savez(tmp_path / "log.npz", data=np.column_stack([T, np.rad2deg(Q), TAU]), columns=np.array(columns))
    assert survey(tmp_path / "log.npz").topics[0].joints == ()


def test_bytes_that_are_no_text_do_not_spoil_a_file(tmp_path: Path) -> None:
    note = np.array("Ger\xe4t".encode("latin-1"))
    np.savez(tmp_path / "log.npz", t=T, q=Q, tau=TAU, note=note, joint_names=np.array([n.encode() for n in NAMES]))
    found = survey(tmp_path / "log.npz").topics[0].channels
    assert [c.joint for c in found if c.quantity == "position"] == list(NAMES)


def test_channels_that_are_taken_say_what_a_list_calls_them(tmp_path: Path) -> None:
    """A study without `[channels]` has them in the order of the columns, whatever the device's is."""
    np.savez(tmp_path / "log.npz", t=T, q=Q, tau=TAU, joint_names=np.array(NAMES))
    assert any("calls the positions elbow, shoulder, wrist" in note for note in read_log(tmp_path / "log.npz").notes)
    np.savez(tmp_path / "plain.npz", t=T, q=Q, tau=TAU)
    assert not any("calls the positions" in note for note in read_log(tmp_path / "plain.npz").notes)


def test_what_is_neither_text_nor_number_beside_the_samples_is_passed_over(tmp_path: Path) -> None:
    path = tmp_path / "log.h5"
    with h5py.File(path, "w") as file:
        file["t"], file["q"], file["tau"] = T, Q, TAU
        file["records"] = np.zeros(3, dtype=[("a", float), ("b", int)])
        file["whole"] = h5py.SoftLink("/nowhere")
        file.create_dataset("none", data=h5py.Empty("f"))
        file["q"].attrs["owner"] = file["t"].ref
        file.attrs["empty"] = h5py.Empty("f")
        file.attrs["joint_names"] = list(NAMES)
    assert [c.joint for c in survey(path).topics[0].channels if c.quantity == "position"] == list(NAMES)


def test_a_damaged_list_of_texts_does_not_spoil_the_samples(tmp_path: Path) -> None:
    path = tmp_path / "log.h5"
    with h5py.File(path, "w") as file:
        file["t"], file["q"], file["tau"] = T, Q, TAU
        file.create_dataset("labels", data=np.array([b"ANVIL", b"BASIL", b"CIVIL"]), chunks=(3,), fletcher32=True)
    whole = path.read_bytes()
    assert whole.count(b"ANVIL") == 1
    path.write_bytes(whole.replace(b"ANVIL", b"ANVIX"))
    assert sum(c.quantity == "position" for c in survey(path).topics[0].channels) == 3


def test_current_and_torque_of_one_motor_are_no_two_motors(tmp_path: Path) -> None:
    """A matrix with names of its columns: a pendubot's motor has both, and its elbow none."""
    t = np.arange(0, 8, 0.004)
    q = np.stack([np.sin(2 * t), np.sin(2.7 * t + 1)], axis=1)
    current = 3 * np.sin(q[:, 0]) + np.tanh(9 * np.gradient(q[:, 0], t))
    data = np.column_stack([t, q, np.gradient(q, t, axis=0), current, 0.12 * current])
    names = ["time", "hip_position", "knee_position", "hip_velocity", "knee_velocity", "current", "torque"]
    np.savez(tmp_path / "log.npz", data=data, column_name=np.array(names))
    made = tomllib.loads(survey(tmp_path / "log.npz").table)["channels"]
    assert made["position"]["joints"] == [2, 3]
    assert (made["torque"]["joints"], made["torque"]["unit"]) == ([7], "N m")
    beside = survey(tmp_path / "log.npz", [("hip",), ("knee",)], command_unit="A")
    assert tomllib.loads(beside.table)["channels"]["torque"]["joints"] == [6]
