"""Whatever is wrong with a study, a device or a log: one clear error, nothing half-written, no earlier result lost."""

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet as pq
import pytest
from typer.testing import CliRunner

from haptid import cli
from haptid.cli import app
from small_study import DEVICE, columns, write_study


def write(path, table):
    pyarrow.csv.write_csv(pa.table(table), path)


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    """A folder in which everything is right."""
    folder = tmp_path_factory.mktemp("good")
    write_study(folder)
    return folder


@pytest.fixture
def folder(good, tmp_path):
    """A copy of it, to be spoilt."""
    return Path(shutil.copytree(good, tmp_path / "run"))


def identify(folder, *options):
    arguments = ["identify", str(folder / "study.toml"), "--out", str(folder / "out"), "--quiet", *options]
    return CliRunner().invoke(app, arguments)


def test_the_good_one_is_good(folder):
    done = identify(folder)
    assert (done.exit_code, done.stdout) == (0, ""), done.output
    assert sorted(p.name for p in (folder / "out").iterdir()) == [
        "clusters.npz",
        "correlation.csv",
        "haptid-files.json",
        "parameters.csv",
        "report-data.json.gz",
        "report.html",
        "result.json",
        "torque-1-log.svg",
        "torque-2-check.svg",
    ]
    assert all(picture.stat().st_size > 10_000 for picture in (folder / "out").glob("*.svg"))
    found = json.loads((folder / "out" / "result.json").read_text())
    unseen = [v for v in found["validation"] if v["rows"] == "unseen" and v["motor"] == "all"]
    assert unseen[0]["relative_error_percent"] < 5


def change(**parts):
    """Spoil columns of the log."""

    def spoil(folder):
        table = columns(1)
        for name, how in parts.items():
            table[name] = how(table[name].copy(), table)
        write(folder / "log.csv", table)

    return spoil


def text(name, old, new):
    """Spoil a file's text."""

    def spoil(folder):
        path = folder / name
        before = path.read_text()
        assert old in before
        path.write_text(before.replace(old, new, 1))

    return spoil


def put(name, data):
    return lambda folder: (folder / name).write_bytes(data)


def at(index, value):
    def how(x, _table):
        x[index] = value
        return x

    return how


def only(rows):
    return lambda folder: write(folder / "log.csv", {k: v[rows] for k, v in columns(1).items()})


def log_named(name):
    """The same log under another name, and the study pointing at it."""

    def point(folder):
        text("study.toml", "log.csv", name)(folder)

    return point


def entry(line):
    """Add a line to the first log's entry in the study."""
    return text("study.toml", 'path = "log.csv"', f'path = "log.csv"\n{line}')


def both(*spoils):
    def spoil(folder):
        for one in spoils:
            one(folder)

    return spoil


def truncated_parquet(folder):
    path = folder / "log.parquet"
    pq.write_table(pa.table(columns(1)), path)
    path.write_bytes(path.read_bytes()[:-100])


def pickled(folder):
    np.savez(folder / "log.npz", t=np.array([{"a": 1}], dtype=object), q1=[1.0], q2=[1.0], tau1=[1.0], tau2=[1.0])


WAVE = np.minimum(np.arange(3000), 1500)
LOOP = '[[joints]]\nname = "3"\nd = 0.3\n[[loops]]\npassive = ["3"]\n'
CUT = 'cut = { type = "revolute", body_a = "3", frame_a = { d = 9.0 }, body_b = "1", frame_b = { d = 0.1 } }\n'
BAD = {
    # the log's samples
    "nan": (change(q1=at(700, np.nan)), r"q1.*not finite|q1.*missing"),
    "infinity": (change(tau2=at(slice(5, 9), np.inf)), r"tau2"),
    "time backwards": (change(t=at(900, 0.5)), r"time decreases"),
    "too short": (only(slice(0, 20)), r"20 samples"),
    "shorter than its filter": (both(only(slice(0, 120)), text("study.toml", "= 30", "= 2")), r"lasts"),
    "no rows": (only(slice(0, 0)), r"no rows|empty"),
    "dead position": (change(q2=lambda q, _: 0 * q + 0.5), r"q2.*(never changes|constant)"),
    "dead torque": (change(tau1=lambda q, _: 0 * q), r"tau1.*(never changes|constant)"),
    "saturated torque": (change(tau1=lambda y, _: np.clip(y, -0.3, 0.3)), r"tau1.*(limit|held)"),
    "degrees for radians": (change(q1=lambda q, _: np.degrees(q), q2=lambda q, _: np.degrees(q)), r"unit = .deg"),
    "radians for degrees": (text("study.toml", 'unit = "rad"', 'unit = "deg"'), r"radians"),
    "one column twice": (change(q2=lambda _, table: table["q1"].copy()), r"equal in every sample"),
    "wrapped angle": (change(q2=lambda q, _: q - 2 * np.pi * (q > 0.2)), r"wrap"),
    "lost counts": (change(q1=lambda q, _: q + 0.9 * (np.arange(len(q)) == 1500)), r"jump"),
    "text in a cell": (lambda f: put("log.csv", b"t,q1,q2,tau1,tau2\n0,1,2,3,4\n0.1,one,2,3,4\n")(f), r"one"),
    "ragged rows": (lambda f: put("log.csv", b"t,q1,q2,tau1,tau2\n0,1,2,3,4\n0.1,2,3\n1,1,2,3,4\n")(f), r"line 3|row"),
    # the log's file
    "no such file": (log_named("other.csv"), r"other\.csv.*(not|no)"),
    "a folder": (both(lambda f: (f / "logs.csv").mkdir(), log_named("logs.csv")), r"folder"),
    "empty file": (put("log.csv", b""), r"empty|0 bytes"),
    "unknown format": (both(put("log.xlsx", b"PK"), log_named("log.xlsx")), r"xlsx.*CSV"),
    "not what it says": (both(put("log.parquet", b"t,q1\n1,2\n"), log_named("log.parquet")), r"text"),
    "truncated parquet": (both(truncated_parquet, log_named("log.parquet")), r"damaged|corrupt|cannot be read"),
    "pickles": (both(pickled, log_named("log.npz")), r"(pickle|object)"),
    "binary in a csv": (put("log.csv", bytes(range(256)) * 9), r"binary"),
    # channels and units
    "missing channel": (text("study.toml", '"q2"', '"q3"'), r"'q3'.*q2"),
    "channel mapped twice": (text("study.toml", '"q1", "q2"', '"q1", "q1"'), r"'?q1'?.*(twice|position 1)"),
    "unknown unit": (text("study.toml", '"rad"', '"gon"'), r"gon.*rad"),
    "torque unit of another kind": (text("study.toml", '"N m"', '"rad"'), r"rad"),
    "unit the device is not driven in": (text("study.toml", '"N m"', '"V"'), r"'V'"),
    "too few channels": (
        both(text("study.toml", '["q1", "q2"]', '["q1"]')),
        r"1 position channels.*requires 2",
    ),
    "counts without gain": (text("study.toml", 'unit = "rad"', 'unit = "counts"'), r"counts.*gain"),
    # the study
    "study that is no TOML": (put("study.toml", b"schema = = 1"), r"study\.toml"),
    "study key misspelt": (text("study.toml", "cutoff_hz", "cut_off"), r"treatment\.cut_off.*no such.*cutoff_hz"),
    "study key missing": (text("study.toml", 'device = "device.toml"\n', ""), r"`device`.*missing"),
    "nothing to identify from": (entry('role = "validate"'), r"identify"),
    "a log both fitted and unseen": (text("study.toml", "check.csv", "log.csv"), r"named twice"),
    "the same log by another name": (lambda f: shutil.copy(f / "log.csv", f / "check.csv"), r"were fitted"),
    "cut-off above the rate": (text("study.toml", "cutoff_hz = 30", "cutoff_hz = 400"), r"400 Hz"),
    "no decimation": (text("study.toml", "decimation = 5", "decimation = 0"), r"decimation"),
    "time given twice": (text("study.toml", 'time = "t"', 'time = "t"\nrate_hz = 500'), r"one of the two"),
    "time range upside down": (entry("time_range = [3, 1]"), r"before it begins"),
    "every row too slow": (text("study.toml", "decimation = 5", "decimation = 5\nreversal_speed = 90"), r"slower"),
    # the device
    "reversal_speed of the wrong length": (
        text("study.toml", "decimation = 5", "reversal_speed = [1, 1, 1]"),
        r"each row",
    ),
    "cut-off that is no number": (text("study.toml", "= 30", "= 'off'"), r"treatment\.cutoff_hz`.*'none'"),
    "order of a filter that has none": (text("study.toml", "decimation = 5", "parallel_order = 2"), r"only.*causal"),
    "differentiator with accelerations": (
        text("study.toml", "cutoff_hz = 30", "velocity_cutoff_hz = 30"), r"acceleration"
    ),
    "fewer rows than parameters": (
        text("study.toml", "decimation = 5", "decimation = 420\nreversal_speed = 0"), r"rows are not enough"
    ),
    "device path with a zero byte": (text("study.toml", '"device.toml"', '"d\\u0000.toml"'), r"zero byte"),
    "no such device": (text("study.toml", "device.toml", "device2.toml"), r"device2\.toml"),
    "unknown shipped device": (text("study.toml", '"device.toml"', '"phantom"'), r"phantom_premium_15"),
    "device that is no TOML": (put("device.toml", b"[[joints"), r"device\.toml"),
    "device key misspelt": (text("device.toml", "d = 0.3", "dd = 0.3"), r"dd.*did you mean|dd.*d"),
    "parent that is not there": (text("device.toml", 'name = "2"', 'name = "2"\nparent = "9"'), r"9"),
    "joint named twice": (text("device.toml", 'name = "2"', 'name = "1"'), r"1"),
    "degrees in the geometry": (text("device.toml", "d = 0.3", "d = 0.3\nalpha = 90"), r"pi/2|radian"),
    "term on no joint": (text("device.toml", 'joints = "all"', 'joints = ["7"]'), r"7"),
    "loop that does not close": (lambda f: (f / "device.toml").write_text(DEVICE + LOOP + CUT), r"(close|open).* m"),
}  # fmt: skip


@pytest.fixture(scope="module")
def said(good, tmp_path_factory):
    """Of each bad input: its folder, the files that were there before, and what the command did."""
    made = {}
    for name, (spoil, _) in BAD.items():
        folder = Path(shutil.copytree(good, tmp_path_factory.mktemp("bad") / "run"))
        spoil(folder)
        before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
        made[name] = folder, before, identify(folder)
    return made


@pytest.mark.parametrize("name", BAD)
def test_one_clear_error_and_nothing_left_behind(name, said):
    message, (folder, before, done) = BAD[name][1], said[name]
    shown = " ".join(done.stderr.split())
    assert done.exit_code == 2, done.output
    assert shown.startswith("error: ")
    assert len(shown) > 60  # it says more than that something is wrong
    assert re.search(message, shown, re.IGNORECASE), shown
    assert "Traceback" not in done.output
    assert not (folder / "out").exists()
    assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == before


def test_there_are_at_least_thirty_and_no_two_say_the_same(said):
    assert len(BAD) >= 30
    assert len({done.stderr.replace(str(folder), "") for folder, _, done in said.values()}) == len(BAD)


def test_a_gap_splits_the_log_and_is_said(folder):
    """A second without samples: the two stretches are used, and the summary says so."""
    change(t=lambda t, _: t + 1.0 * (np.arange(len(t)) > 1500))(folder)
    done = CliRunner().invoke(app, ["identify", str(folder / "study.toml"), "--out", str(folder / "out")])
    assert done.exit_code == 0, done.output
    shown = " ".join(done.output.split())
    assert re.search(r"1 gap of more than .* the longest 1\.002 s at t = 3 s: 2 segments", shown), done.output


def test_a_failed_run_leaves_an_earlier_result_as_it_was(folder):
    assert identify(folder).exit_code == 0
    kept = {path.name: path.read_bytes() for path in (folder / "out").iterdir()}
    change(q1=at(700, np.nan))(folder)
    assert identify(folder).exit_code == 2
    assert {path.name: path.read_bytes() for path in (folder / "out").iterdir()} == kept
    assert not list(folder.glob(".out-*"))


def test_a_run_that_fails_while_drawing_leaves_nothing(folder, monkeypatch):
    """The last step fails: figures were computed and files written, and none of them may be seen."""

    def broken(*_):
        raise OSError("no space left on device")

    monkeypatch.setattr("haptid.report.run.draw_torque", broken)
    done = identify(folder)
    assert done.exit_code == 2
    assert "no space left" in done.stderr
    assert not (folder / "out").exists()
    assert not list(folder.glob(".out-*"))


def test_an_interrupted_run_leaves_nothing(folder, monkeypatch):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("haptid.report.run.draw_torque", interrupted)
    assert identify(folder).exit_code != 0
    assert not (folder / "out").exists()
    assert not list(folder.glob(".out-*"))


def test_results_cannot_go_where_a_file_is(folder):
    (folder / "out").write_text("mine")
    done = identify(folder)
    assert done.exit_code == 2
    assert "it is a file" in done.stderr
    assert (folder / "out").read_text() == "mine"


def test_other_files_in_the_result_folder_are_left_alone(folder):
    (folder / "out").mkdir()
    (folder / "out" / "notes.txt").write_text("mine")
    assert identify(folder).exit_code == 0
    assert (folder / "out" / "notes.txt").read_text() == "mine"


def test_criteria_decide_the_exit_status(folder):
    text("study.toml", "[treatment]", "[criteria]\nrelative_error_percent = 1e-6\n[treatment]")(folder)
    assert identify(folder).exit_code == 1
    assert json.loads((folder / "out" / "result.json").read_text())["criteria"]["met"] is False


def test_a_folder_where_a_result_must_go_is_found_before_anything_is_replaced(folder):
    assert identify(folder).exit_code == 0
    kept = (folder / "out" / "parameters.csv").read_bytes()
    (folder / "out" / "result.json").unlink()
    (folder / "out" / "result.json").mkdir()
    text("study.toml", "decimation = 5", "decimation = 4")(folder)
    done = identify(folder)
    assert done.exit_code == 2
    assert "result.json" in done.stderr
    assert (folder / "out" / "parameters.csv").read_bytes() == kept
    assert sorted(path.name for path in (folder / "out").iterdir() if path.name.startswith(".")) == []


def test_results_can_go_through_a_link(folder, tmp_path):
    (tmp_path / "real").mkdir()
    (folder / "out").symlink_to(tmp_path / "real")
    assert identify(folder).exit_code == 0
    assert (tmp_path / "real" / "result.json").exists()
    (folder / "out").unlink()
    (folder / "out").symlink_to(tmp_path / "nowhere" / "else")
    assert identify(folder).exit_code == 2


@pytest.mark.parametrize("name", ["[/]", "arm [v2] [red]", "cost $\\\\frac$ x", "\u624b"])
def test_names_with_brackets_dollars_and_foreign_letters_are_only_names(name, folder):
    text("study.toml", 'name = "two links"', f'name = "{name}"')(folder)
    arguments = ["identify", str(folder / "study.toml"), "--out", str(folder / "out")]
    done = CliRunner().invoke(app, arguments)
    assert done.exit_code == 0, done.output
    assert f"{name}: two links".replace("\\\\", "\\") in done.stdout
    missing = folder / "[/nope].toml"
    assert "[/nope].toml" in CliRunner().invoke(app, ["identify", str(missing), "--out", str(folder / "x")]).stderr


def test_a_defect_has_an_exit_status_of_its_own(monkeypatch, capsys):
    def broken(**_):
        raise RuntimeError("surprise")

    monkeypatch.setattr("haptid.cli._register", lambda *_: broken)
    with pytest.raises(SystemExit) as exit_:
        cli.main()
    assert exit_.value.code == 3
    assert "surprise" in capsys.readouterr().err
