"""`iddata` objects in MAT files: signals by their own names, times of each experiment."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from scipy import io
from scipy.io.matlab import MatlabObject

from haptid.log.formats import mat
from haptid.log.survey import survey


def _cells(values: Sequence[object]) -> np.ndarray:
    made = np.empty((1, len(values)), object)
    made[0, :] = list(values)
    return made


def _object(outputs: list[np.ndarray], inputs: list[np.ndarray], **changed: object) -> MatlabObject:
    fields: dict[str, object] = {
        "Domain": "Time",
        "OutputData": _cells(outputs),
        "OutputName": _cells(["q1", "q2"]).T,
        "OutputUnit": _cells(["rad", "rad"]).T,
        "InputData": _cells(inputs),
        "InputName": _cells(["tau1", "tau2"]).T,
        "InputUnit": _cells(["N m", ""]).T,
        "Ts": _cells([np.array([[0.002]])] * len(outputs)),
        "Tstart": _cells([np.zeros((0, 0))] * len(outputs)),
        "SamplingInstants": _cells([np.zeros((len(output), 0)) for output in outputs]),
        "TimeUnit": "seconds",
    } | changed
    record = np.empty((1, 1), [(name, object) for name in fields])
    for name, value in fields.items():
        record[name][0, 0] = value
    return MatlabObject(record, "iddata")


def _saved(folder: Path, value: MatlabObject) -> Path:
    io.savemat(folder / "run.mat", {"z": value})
    return folder / "run.mat"


def _signals(rows: int, phase: float = 0.0) -> np.ndarray:
    t = 0.002 * np.arange(rows)
    return np.column_stack([np.sin(3 * t + phase), np.cos(2 * t + phase)])


def test_signals_have_their_names_and_units(tmp_path: Path) -> None:
    path = _saved(tmp_path, _object([_signals(500)], [5 * _signals(500, 1.0)]))
    found = mat.columns(path, mat.names(path))
    assert list(found) == ["z.Time [s]", "z.q1 [rad]", "z.q2 [rad]", "z.tau1 [N m]", "z.tau2"]
    np.testing.assert_array_equal(found["z.q2 [rad]"], _signals(500)[:, 1])
    np.testing.assert_array_equal(found["z.tau2"], 5 * _signals(500, 1.0)[:, 1])
    np.testing.assert_allclose(np.diff(found["z.Time [s]"]), 0.002, rtol=1e-9)
    draft = survey(path).table
    assert 'position = { channels = ["z.q1 [rad]", "z.q2 [rad]"], unit = "rad" }' in draft
    assert 'torque = { channels = ["z.tau1 [N m]", "z.tau2"], unit = "N m" }' in draft


def test_each_experiment_has_its_own_times(tmp_path: Path) -> None:
    starts = _cells([np.array([[1.5]]), np.zeros((0, 0))])
    instants = _cells([np.zeros((300, 0)), np.cumsum(np.full((200, 1), 0.25), axis=0)])
    value = _object([_signals(300), _signals(200)], [_signals(300), _signals(200)])
    value["Tstart"][0, 0], value["SamplingInstants"][0, 0], value["TimeUnit"][0, 0] = starts, instants, "milliseconds"
    found = mat.columns(path := _saved(tmp_path, value), mat.names(path))
    assert found["z[1].Time [ms]"][:2].tolist() == [1.5, 1.502]
    assert found["z[2].Time [ms]"][:2].tolist() == [0.25, 0.5]
    assert {name: len(array) for name, array in found.items() if name.endswith("q1 [rad]")} == {
        "z[1].q1 [rad]": 300,
        "z[2].q1 [rad]": 200,
    }


@pytest.mark.parametrize("side", ["Output", "Input"])
def test_data_of_one_side_only_are_read(tmp_path: Path, side: str) -> None:
    value = _object([_signals(40)], [_signals(40)])
    value[f"{side}Data"][0, 0] = _cells([np.zeros((40, 0))])
    names = mat.names(_saved(tmp_path, value))
    assert len(names) == 3
    assert ("z.q1 [rad]" in names) is (side == "Input")


def test_an_experiment_without_samples_is_left_out(tmp_path: Path) -> None:
    value = _object([_signals(300), np.zeros((0, 0))], [_signals(300), np.zeros((0, 0))])
    assert {name.partition(".")[0] for name in mat.names(_saved(tmp_path, value))} == {"z[1]"}
