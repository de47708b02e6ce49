"""Samples of a motion in the formats of controllers: read back, each is the planned motion."""

import csv
import json
import re
import subprocess

import numpy as np
import pytest
from mcap.reader import make_reader

import haptid
from compiled import STRICT
from haptid import errors
from haptid.experiment.excitation import FourierSeries, Limits, MotionSamples, Search, design_excitation, write_motion
from motions import truth
from recorders import STORE

PHANTOM = haptid.DynamicModel(haptid.read_device("phantom_premium_15"))
WITHIN = Limits(((-0.8, 0.8), (-0.4, 0.8), (-0.3, 0.9)), (3.0,))
RATE = 50.0


@pytest.fixture(scope="module")
def found():
    family = FourierSeries(4.0, 0.5, 2, ramp=1.0, start_pose=(0.0, 0.1, 0.2))
    return design_excitation(PHANTOM, family, WITHIN, beta=truth(PHANTOM), search=Search(tries=20))


@pytest.fixture(scope="module")
def samples(found):
    return MotionSamples.of(found, RATE)


def test_samples_are_the_plan(found, samples):
    made = found.trajectory(1 / RATE)
    for name in ("q", "qd", "qdd"):
        np.testing.assert_array_equal(getattr(samples, name), getattr(made, name))
    np.testing.assert_allclose(samples.q[[0, -1]], [[0.0, 0.1, 0.2]] * 2, atol=1e-15)


def test_a_rehearsal_passes_the_same_points_slowly(found, samples):
    slow = MotionSamples.of(found, RATE, speed=0.2)
    np.testing.assert_allclose(slow.q[::5], samples.q, atol=1e-12)
    np.testing.assert_allclose(slow.qd[::5], 0.2 * samples.qd, atol=1e-12)
    np.testing.assert_allclose(slow.qdd[::5], 0.04 * samples.qdd, atol=1e-12)
    assert slow.t[-1] == pytest.approx(5 * samples.t[-1])
    # its own derivative: (f(t+h) - f(t-h)) / 2h, to second order in h
    np.testing.assert_allclose(np.gradient(slow.q, slow.t, axis=0)[2:-2], slow.qd[2:-2], atol=1e-3)


def test_a_table_is_read_back(samples, tmp_path):
    with write_motion(tmp_path / "m.csv", samples).open() as file:
        rows = list(csv.reader(file))
    assert rows[0] == ["t", *(f"{kind}{name}" for kind in ("q", "qd", "qdd") for name in ("ba", "be", "df"))]
    values = np.array(rows[1:], dtype=float)
    np.testing.assert_array_equal(values, np.column_stack([samples.t, samples.q, samples.qd, samples.qdd]))


def test_ros_reads_a_joint_trajectory(samples, tmp_path):
    yaml = pytest.importorskip("yaml")
    read = yaml.safe_load(write_motion(tmp_path / "m.yaml", samples).read_text())
    assert read["joint_names"] == ["ba", "be", "df"]
    for key, wanted in (("positions", samples.q), ("velocities", samples.qd), ("accelerations", samples.qdd)):
        np.testing.assert_allclose([point[key] for point in read["points"]], wanted, rtol=1e-12, atol=1e-15)
    times = [point["time_from_start"] for point in read["points"]]
    np.testing.assert_allclose([x["sec"] + 1e-9 * x["nanosec"] for x in times], samples.t, atol=1e-9)
    assert all(
        set(point) == {"positions", "velocities", "accelerations", "time_from_start"} for point in read["points"]
    )


def test_a_bag_has_the_joint_trajectory(samples, tmp_path):
    with write_motion(tmp_path / "m.mcap", samples).open("rb") as file:
        ((schema, channel, message),) = make_reader(file).iter_messages()
    assert (channel.topic, channel.message_encoding, schema.encoding) == ("/joint_trajectory", "cdr", "ros2msg")
    definition, _ = STORE.generate_msgdef(schema.name, ros_version=2)
    lines = lambda text: [x for x in re.sub("/msg/", "/", text).splitlines() if x and not x.startswith("=")]  # noqa: E731
    assert lines(schema.data.decode()) == lines(definition)
    read = STORE.deserialize_cdr(message.data, schema.name)
    assert list(read.joint_names) == ["ba", "be", "df"]
    for key, wanted in (("positions", samples.q), ("velocities", samples.qd), ("accelerations", samples.qdd)):
        np.testing.assert_array_equal([getattr(point, key) for point in read.points], wanted)
    times = [point.time_from_start.sec + 1e-9 * point.time_from_start.nanosec for point in read.points]
    np.testing.assert_allclose(times, samples.t, atol=1e-9)
    assert bytes(STORE.serialize_cdr(read, schema.name)) == message.data


@pytest.mark.parametrize("compiler", [["cc", *STRICT], ["c++", "-x", "c++", "-Wall", "-Werror"]], ids=["C99", "C++"])
def test_arrays_in_c_are_compiled_and_printed(samples, compiler, tmp_path):
    write_motion(tmp_path / "7 of mine.h", samples)
    (tmp_path / "main.c").write_text("""
        #include <stdio.h>
        #include "7 of mine.h"
        #define M(x) motion_7_of_mine_ ## x
        int main(void) {
          for (int k = 0; k < MOTION_7_OF_MINE_SAMPLES; k++)
            for (int j = 0; j < MOTION_7_OF_MINE_JOINTS; j++)
              printf("%.17g %.17g %.17g\\n", M(q)[k][j], M(qd)[k][j], M(qdd)[k][j]);
          return MOTION_7_OF_MINE_RATE_HZ == 50.0 ? 0 : 1;
        }""")
    subprocess.run([*compiler, "main.c", "-o", "main"], cwd=tmp_path, check=True)
    printed = subprocess.run(["./main"], cwd=tmp_path, check=True, capture_output=True, text=True).stdout
    values = np.array(printed.split(), dtype=float).reshape(len(samples.q), 3, 3)
    wanted = np.stack([samples.q, samples.qd, samples.qdd], axis=2)
    np.testing.assert_allclose(values, wanted, rtol=1e-12, atol=1e-15)


def test_a_script_for_matlab_has_the_matrices(samples, tmp_path):
    text = write_motion(tmp_path / "m.m", samples).read_text()
    assert f"t = (0:{len(samples.q) - 1})' / 50.0;" in text
    for key in ("q", "qd", "qdd"):
        block = re.search(rf"^{key} = \[\n(.*?)^\];", text, re.MULTILINE | re.DOTALL).group(1)
        values = [[float(x) for x in line.rstrip(";").split()] for line in block.splitlines()]
        np.testing.assert_allclose(values, getattr(samples, key), rtol=1e-12, atol=1e-15)
        assert f"{key} = timeseries({key}, t, 'Name', '{key}');" in text


def test_actions_are_in_degrees(samples, tmp_path):
    read = json.loads(write_motion(tmp_path / "m.json", samples).read_text())
    assert read["fps"] == RATE
    positions = [[action[f"{name}.pos"] for name in ("ba", "be", "df")] for action in read["actions"]]
    np.testing.assert_allclose(np.radians(positions), samples.q, atol=1e-15)


def test_what_cannot_be_written(found, samples, tmp_path):
    with pytest.raises(errors.SettingError, match=r"no format of samples has the ending '.xls'"):
        write_motion(tmp_path / "m.xls", samples)
    for rate, speed in ((0.0, 1.0), (50.0, 0.0), (50.0, 1.5), (np.nan, 1.0)):
        with pytest.raises(errors.SettingError, match="write a number above 0"):
            MotionSamples.of(found, rate, speed)
    with pytest.raises(errors.SettingError, match=r"1\.5 samples per second are too few for a motion of up to 1 Hz"):
        MotionSamples.of(found, 1.5)
    with pytest.raises(errors.SettingError, match="4 rows per second are too few for harmonics up to 2 Hz"):
        design_excitation(PHANTOM, FourierSeries(), WITHIN, search=Search(rows_hz=4.0))
    with pytest.raises(errors.OutputFolderError):
        write_motion(tmp_path / "no" / "m.csv", samples)
