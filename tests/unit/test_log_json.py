"""JSON logs in their three layouts, and text tables with a channel in each row, give the samples that were written."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from haptid.errors import LogError
from haptid.log import Channels, Signal
from haptid.log.file_format import format_of
from haptid.log.read import read_log

T = np.arange(400) * 0.002
Q, TAU = np.sin([3 * T, 2 * T + 1]), np.cos([5 * T, T])


def records() -> list[dict[str, object]]:
    """Joints change their order from record to record, and one value is missing."""
    made = []
    for k in range(T.size):
        order = [0, 1] if k % 3 else [1, 0]
        state = {"name": ["ab"[i] for i in order], "position": [Q[i, k] for i in order]}
        joints = [{"name": "ab"[i], "torque": TAU[i, k]} for i in reversed(order)]
        made.append({"stamp": 1_700_000_000_000_000_001 + 2_000_000 * k, "state": state, "joints": joints, "note": "x"})
    return made


def read(path: Path, names: list[str]) -> list[np.ndarray]:
    kind = format_of(path)
    assert set(names) <= set(kind.names(path))
    found = kind.columns(path, names)
    return [found[name] for name in names]


@pytest.mark.parametrize("layout", ["lines", "array", "inside"])
def test_records(tmp_path: Path, layout: str) -> None:
    """Joints are found by name in every record; stamps keep all digits."""
    path = tmp_path / ("run.jsonl" if layout == "lines" else "run.json")
    text = "\n".join(map(json.dumps, records())) + '\n{"stamp": 17'  # a recorder that was stopped
    whole = records() if layout == "array" else {"rate": 500, "samples": records()}
    path.write_text(text if layout == "lines" else json.dumps(whole))
    inside = "samples." if layout == "inside" else ""
    names = [
        f"{inside}{name}"
        for name in ("stamp", "state.position[a]", "state.position[b]", "joints[a].torque", "joints[b].torque")
    ]
    stamp, *others = read(path, names)
    assert stamp.tolist() == [record["stamp"] for record in records()]
    np.testing.assert_array_equal(others, [*Q, *TAU])


def test_objects_of_arrays_are_logs_without_more_ado(tmp_path: Path) -> None:
    path = tmp_path / "run.json"
    path.write_text(json.dumps({"rec": {"t": T.tolist(), "q": Q.T.tolist(), "tau": TAU.tolist()}, "who": "me"}))
    log = read_log(path)
    np.testing.assert_array_equal(log.position.T, Q)
    np.testing.assert_array_equal(log.torque.T, TAU)


@pytest.mark.parametrize("layout", ["arrays", "entries", "inside"])
def test_trials_with_arrays_of_their_own_are_segments_of_one_log(tmp_path: Path, layout: str) -> None:
    """Each trial has times from its own start, and settings beside its samples."""
    trials = []
    for part in (slice(0, 250), slice(100, 400)):
        t, q, tau = T[part] - T[part.start], Q[:, part].T, TAU[:, part].T
        if layout == "entries":
            samples = [{"t": a, "q": b, "tau": c} for a, b, c in zip(t.tolist(), q.tolist(), tau.tolist(), strict=True)]
            trials.append({"mass": 0.5, "motor": "mx106", "entries": samples})
        else:
            arrays = {"t": t.tolist(), "q": q.tolist(), "tau": tau.tolist(), "gains": [4, 0, 1]}
            trials.append({"type": "chirp", "data": arrays} if layout == "inside" else arrays)
    path = tmp_path / "trials.json"
    path.write_text(json.dumps({"runs": trials, "rate": 500} if layout == "inside" else trials))
    before = {"arrays": "", "entries": "entries.", "inside": "runs.data."}[layout]
    names = [[f"{before}{array}[{k}]" for k in (1, 2)] for array in ("q", "tau")]
    log = read_log(path, Channels(Signal(names[0], "rad"), Signal(names[1], "N m"), f"{before}t"))
    assert log.segments == ((0, 250), (250, 550))
    np.testing.assert_allclose(log.position.T, np.concatenate([Q[:, :250], Q[:, 100:]], axis=1), atol=1e-9)
    np.testing.assert_allclose(log.torque.T, np.concatenate([TAU[:, :250], TAU[:, 100:]], axis=1), atol=1e-9)


def test_missing_values_are_nan_and_texts_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "run.ndjson"
    path.write_text('{"a": 1.5, "b": 2}\n{"a": null}\n{"a": 3, "b": "off"}\n')
    (a,) = read(path, ["a"])
    np.testing.assert_array_equal(a, [1.5, np.nan, 3.0])
    with pytest.raises(LogError, match="off"):
        read(path, ["b"])


@pytest.mark.parametrize("content", ["[" * 100_000, '{"a": [1, 2', "{}", "[1, 2]", '{"a": 1}\nx\n{"a": 2}\n', "nul"])
def test_damaged_files_are_one_error(tmp_path: Path, content: str) -> None:
    for name in ("run.json", "run.jsonl"):
        path = tmp_path / name
        path.write_text(content)
        with pytest.raises(LogError):
            read_log(path)


@pytest.mark.parametrize(("separator", "decimal"), [(",", "."), (";", ","), ("\t", "."), (" ", ".")])
@pytest.mark.parametrize("named", [True, False])
def test_a_channel_in_each_row(tmp_path: Path, separator: str, decimal: str, named: bool) -> None:
    rows = [("t", T), ("q1", Q[0]), ("q2", Q[1]), ("tau1", TAU[0]), ("tau2", TAU[1])]
    lines = ["# recorded by hand"] if named else []
    for name, values in rows:
        lines.append(separator.join([name] * named + [repr(float(x)).replace(".", decimal) for x in values]))
    path = tmp_path / "run.txt"
    path.write_text("\n".join(lines) + "\n")
    if named:
        log = read_log(path)
        np.testing.assert_array_equal([log.position.T, log.torque.T], [Q, TAU])
    else:
        np.testing.assert_array_equal(read(path, [f"column[{k}]" for k in range(1, 6)]), [T, *Q, *TAU])


def test_other_tables_keep_their_columns(tmp_path: Path) -> None:
    """Also wide ones, and ones of few rows."""
    for width, length in ((3, 40), (150, 60), (150, 12), (40, 2000)):
        path = tmp_path / f"{width}-{length}.csv"
        head = ",".join(f"c{k}" for k in range(width))
        np.savetxt(path, np.random.default_rng(0).normal(size=(length, width)), delimiter=",", header=head, comments="")
        assert format_of(path).name == "CSV"
