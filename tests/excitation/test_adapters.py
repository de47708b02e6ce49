"""The adapters of examples/adapters, compiled against stub headers with a device behind them, play a whole motion."""

import csv
from pathlib import Path

import numpy as np
import pytest

import haptid
from compiled import compiler, run
from haptid.experiment import bench
from haptid.experiment.excitation import MotionSamples, write_player

TESTS = Path(__file__).resolve().parents[1]
ADAPTERS, STUBS = TESTS.parent / "examples" / "adapters", TESTS / "stubs"
RATE, JOINTS = 250.0, 3


@pytest.fixture(scope="module")
def campaign(tmp_path_factory):
    """A folder with a player of one motion of three joints, and its samples."""
    folder = tmp_path_factory.mktemp("campaign")
    kind = bench.Multisine(4.0, (0.1, 0.2, 0.3), (0.4, 0.3, 0.3), speed=(2.0,))
    made = bench.plan(
        kind, haptid.DynamicModel(haptid.read_device("phantom_premium_15")), 1 / RATE, np.random.default_rng(0)
    )
    names = ("a", "b", "c")
    samples = MotionSamples("dev", names, names, (False,) * JOINTS, RATE, made.q, made.qd, made.qdd)
    write_player(folder / "swing.c", [samples])
    return folder, samples


@pytest.mark.parametrize("adapter", ["openhaptics.c", "force_dimension.cpp", "dvrk.cpp", "ros2_control.cpp"])
def test_an_adapter_plays_and_records(adapter, campaign):
    folder, samples = campaign
    plain = adapter.endswith(".c")
    command = [
        compiler("gcc" if plain else "g++"),
        "-std=c99" if plain else "-std=c++17",
        "-Wall",
        "-Wextra",
        "-Werror",
    ]
    main = STUBS / "ros2_control_main.cpp" if adapter == "ros2_control.cpp" else ADAPTERS / adapter
    run([*command, f"-I{folder}", f"-I{ADAPTERS}", "-isystem", str(STUBS), str(main), "-lm", "-o", "campaign"], folder)
    rows = list(csv.DictReader(run(["./campaign", "1.0"], folder).stdout.splitlines()))
    number, status, plan = (np.array([float(row[key]) for row in rows]) for key in ("number", "status", "plan"))
    q, ref, tau = (
        np.array([[float(row[f"{key}{j + 1}"]) for j in range(JOINTS)] for row in rows]) for key in ("q", "ref", "tau")
    )
    np.testing.assert_array_equal(number, np.arange(len(rows)))  # no row is lost
    assert sorted(set(status[plan >= 0])) == [2, 3]
    assert plan[-1] == pytest.approx(samples.t[-1])
    wanted = np.column_stack([np.interp(plan[plan >= 0], samples.t, x) for x in samples.q.T])
    np.testing.assert_allclose(ref[plan >= 0], wanted, atol=1e-3)  # references are cubics between samples, these lines
    assert np.abs(q - ref).max() < 0.05  # of a motion of 0.4 rad: the gains are those of the example
    assert np.ptp(q, axis=0).min() > 0.3
    assert np.isfinite(tau).all()
    assert np.abs(tau).max() > 0
