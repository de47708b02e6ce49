"""Tables without telling names: what their columns are is told by how they move."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest

import haptid
import small_study
from haptid.device import read_device
from haptid.log.by_content import Content
from haptid.log.survey import survey
from haptid.study.draft import draft_study
from motions import multisine, truth

JOINTS = 3
RNG = np.random.default_rng(5)
DT = 0.004


def signals(seed: int = 2) -> dict[str, np.ndarray]:
    """Measured motion with an encoder's steps and a noisy rate, its plan, and torques, (samples, joints) each."""
    rng = np.random.default_rng([5, seed])
    model = haptid.DynamicModel(haptid.read_device("phantom_premium_15"))
    q, qd, qdd = multisine(JOINTS, 12.0, DT, seed)
    tau = haptid.inverse_dynamics(model, truth(model) + 0.1, q, qd, qdd)
    noisy = qd + 0.05 * np.std(qd) * rng.standard_normal(qd.shape)
    return {
        "q": np.round(q / 1e-3).T * 1e-3,
        "qd": noisy.T,
        "qdd": qdd.T,
        "plan": q.T + 1e-3,
        "tau": tau.T,
        "t": DT * np.arange(q.shape[1])[:, None],
        "row": np.arange(q.shape[1], dtype=float)[:, None],
    }


@pytest.mark.parametrize(
    "layout",
    [
        ("q", "qd", "tau"),
        ("t", "q", "qd", "tau"),
        ("row", "t", "tau", "q", "qd"),
        ("t", "q", "qd", "qdd", "tau"),
        ("q", "qd", "plan", "tau"),
        ("plan", "t", "q", "qd", "tau"),
    ],
)
def test_groups_of_columns_are_recognised(layout: tuple[str, ...]) -> None:
    parts = signals()
    names = [f"{what}{k}" for what in layout for k in range(parts[what].shape[1])]
    table = np.hstack([parts[what] for what in layout])
    found = Content.of(dict(zip(names, table.T, strict=True)))
    assert found.positions == ("q0", "q1", "q2")
    assert found.rates == ("qd0", "qd1", "qd2")
    assert found.torques == ("tau0", "tau1", "tau2")
    assert found.time == ("t0" if "t" in layout else "")
    assert found.dt == pytest.approx(DT, rel=0.01)


def test_several_recordings_in_one_table_whose_joints_move_alike() -> None:
    """Times start again, positions jump there; a second joint that follows the first at another size is no copy."""
    runs = [signals(seed) for seed in (2, 3)]
    table = np.vstack([np.hstack([run["t"][:n], run["q"][:n], run["qd"][:n], run["tau"][:n]])
                       for run, n in zip(runs, (1500, 2500), strict=True)])  # fmt: skip
    table[:, [2, 5]] = 3.0 * table[:, [1, 4]] + 0.1 * table[:, [2, 5]]
    found = Content.of({f"c{k}": x for k, x in enumerate(table.T)})
    assert (found.time, found.positions) == ("c0", ("c1", "c2", "c3"))
    assert found.torques == ("c7", "c8", "c9")


def test_joints_of_one_stroke_are_found_as_a_block_of_columns() -> None:
    """Strokes of 1.5 s look alike, and one that is nearly even like a clock; accelerations follow rates as these do
    positions. Columns of a public arm's collisions were drafted one joint further than they are."""
    t, rng = 0.01 * np.arange(150)[:, None], np.random.default_rng(1)
    w, phase, size = (rng.uniform(*ends, (1, 7)) for ends in ((0.5, 2.5), (0.0, 6.0), (0.2, 1.0)))
    q, qd, qdd = (
        size * np.sin(w * t + phase),
        size * w * np.cos(w * t + phase),
        -size * w**2 * np.sin(w * t + phase),
    )
    q[:, 2:3], qd[:, 2:3], qdd[:, 2:3] = 0.5 * t + 0.05 * t**2, 0.5 + 0.1 * t, np.full_like(t, 0.1)
    tau = rng.standard_normal((1, 7)) * np.cos(q) + 0.3 * qdd + 0.05 * rng.standard_normal(q.shape)
    qdd = qdd + 0.2 * rng.standard_normal(q.shape)
    table = np.hstack([t, tau, q, qd, qdd]) + 1e-4 * rng.standard_normal((150, 29)) * (np.arange(29) > 0)
    found = Content.of({f"c{k}": x for k, x in enumerate(table.T)})
    assert found.positions == tuple(f"c{k}" for k in range(8, 15))
    assert found.rates == tuple(f"c{k}" for k in range(15, 22))
    assert found.torques == tuple(f"c{k}" for k in range(1, 8))


def test_torques_of_the_positions_own_array_come_first() -> None:
    parts = signals()
    columns = {f"I{k}": x for k, x in enumerate(np.random.default_rng(9).standard_normal(parts["tau"].shape).T)}
    columns |= {f"data[{k}]": x for k, x in enumerate(np.hstack([parts[n] for n in ("q", "qd", "tau")]).T)}
    assert Content.of(columns).torques == ("data[6]", "data[7]", "data[8]")


def test_columns_by_joint() -> None:
    parts = signals()
    table = {f"{what}{k}": parts[what][:, k] for k in range(JOINTS) for what in ("q", "qd", "tau")}
    found = Content.of(table)
    assert (found.positions, found.torques) == (("q0", "q1", "q2"), ("tau0", "tau1", "tau2"))


def test_a_joint_that_does_not_move_keeps_its_place() -> None:
    parts = signals()
    for what in ("q", "qd", "tau"):
        parts[what][:, 1] = 0.25
    found = Content.of({f"{what}{k}": parts[what][:, k] for what in ("q", "qd", "tau") for k in range(JOINTS)})
    assert (found.positions, found.torques) == (("q0", "q1", "q2"), ("tau0", "tau1", "tau2"))


def test_a_group_whose_last_columns_stand_still_is_named_beside_the_first_one() -> None:
    """Torque sensors at some joints only, behind the motors' currents, were not mentioned."""
    parts = signals()
    sensed = parts["tau"] * 2.0 + 0.1
    sensed[:, 2] = 0.0
    table = np.hstack([parts["t"], parts["q"], parts["qd"], parts["tau"], sensed])
    found = Content.of({f"c{k}": column for k, column in enumerate(table.T)})
    assert (found.torques, found.others) == (("c7", "c8", "c9"), (("c10", "c11", "c12"),))


def test_a_column_of_a_status_is_no_torque_of_a_joint_without_a_sensor() -> None:
    parts = signals()
    table = np.hstack([parts["t"], parts["q"], parts["qd"], parts["tau"][:, :2], np.ones_like(parts["t"])])
    assert Content.of({f"c{k}": column for k, column in enumerate(table.T)}).torques == ()


def test_nothing_is_recognised_in_noise_and_in_short_tables() -> None:
    noise = {f"c{k}": RNG.standard_normal(2000) for k in range(12)}
    assert Content.of(noise) == Content()
    assert Content.of({"a": np.arange(5.0), "b": np.ones(5)}) == Content()
    assert Content.of({}) == Content()


def test_a_table_without_a_header_becomes_a_study(tmp_path: Path) -> None:
    """Positions, rates and torques of two links: the draft names them and the rate, and is identified as it is."""
    log = small_study.columns(1, seconds=8.0)
    rates = [np.gradient(log[name], 2e-3) for name in ("q1", "q2")]
    table = np.column_stack([log["q1"], log["q2"], *rates, log["tau1"], log["tau2"]])
    np.savetxt(tmp_path / "log.csv", table, delimiter=",")
    (tmp_path / "device.toml").write_text(small_study.DEVICE)
    device = read_device(tmp_path / "device.toml")
    text, _ = draft_study([tmp_path / "log.csv"], device, str(tmp_path / "device.toml"), tmp_path)
    made = tomllib.loads(text)["channels"]
    assert made["rate_hz"] == 500
    (tmp_path / "study.toml").write_text(text + "\n[treatment]\ncutoff_hz = 30\ndecimation = 5\n")
    found = haptid.identify(haptid.read_study(tmp_path / "study.toml"))
    assert found.unseen[0].relative < 3.0
    assert found.estimate["FC1"].value == pytest.approx(0.1, abs=0.05)


def test_torques_that_are_left_are_in_the_unit_of_the_motors_and_too_many_are_said(tmp_path: Path) -> None:
    """Columns of currents and of a sensor beside them, of a device with one motor, as a pendubot's log has."""
    log = small_study.columns(1, seconds=8.0)
    rates = [np.gradient(log[name], 2e-3) for name in ("q1", "q2")]
    table = np.column_stack([log["q1"], log["q2"], *rates, log["tau1"], log["tau2"]])
    np.savetxt(tmp_path / "log.csv", table, delimiter=",")
    joints = [("shoulder",), ("elbow",)]
    drafted = survey(tmp_path / "log.csv", joints, [("shoulder",)], command_unit="A").table
    assert 'unit = "A", side = "motor" }' in drafted
    assert "the device has 1 motor, and these are 2: keep those of shoulder" in drafted
    assert "these are 2" not in survey(tmp_path / "log.csv", joints, joints, command_unit="A").table


def test_measured_torques_are_drafted_before_commands_which_are_named(tmp_path: Path) -> None:
    log = small_study.columns(1)
    columns = {"t": log["t"], "q1": log["q1"], "q2": log["q2"]}
    columns |= {f"tau_con{k}": np.round(log[f"tau{k}"], 1) for k in (1, 2)}
    columns |= {f"tau_meas{k}": log[f"tau{k}"] for k in (1, 2)}
    table = np.column_stack(list(columns.values()))
    np.savetxt(tmp_path / "log.csv", table, delimiter=",", header=",".join(columns), comments="")
    (tmp_path / "device.toml").write_text(small_study.DEVICE)
    text, _ = draft_study([tmp_path / "log.csv"], read_device(tmp_path / "device.toml"), "device.toml", tmp_path)
    assert tomllib.loads(text)["channels"]["torque"]["channels"] == ["tau_meas1", "tau_meas2"]
    assert "# also there: tau_con1, tau_con2" in text


def test_no_rate_is_made_up(tmp_path: Path) -> None:
    """A study with a rate that nobody wrote would be wrong without a word: the key is left to be written."""
    parts = signals()
    path = tmp_path / "log.csv"
    np.savetxt(path, np.hstack([parts["q"], parts["tau"]]), delimiter=",", header="q1,q2,q3,u1,u2,u3", comments="")
    assert "# rate_hz = ..." in survey(path).table


def test_the_rate_of_a_log_without_times_is_drafted_from_velocities(tmp_path: Path) -> None:
    parts = signals()
    path = tmp_path / "log.csv"
    head = ",".join(f"{name}{k}" for name in ("q", "qd", "tau") for k in (1, 2, 3))
    table = np.hstack([parts[name] for name in ("q", "qd", "tau")])
    np.savetxt(path, table, delimiter=",", header=head, comments="")
    assert "rate_hz = 250 " in survey(path).table


def test_nothing_is_said_of_columns_without_rates() -> None:
    parts = signals()
    assert not Content.of({f"c{k}": x for k, x in enumerate(np.hstack([parts["q"], parts["tau"]]).T)}).positions


def test_noisy_accelerations_are_no_torques() -> None:
    """Those of a recorder that differentiates: they stand before the torques, or there are no torques."""
    parts = signals()
    parts["qdd"] = parts["qdd"] + np.std(parts["qdd"]) * RNG.standard_normal(parts["qdd"].shape)
    for layout, torques in ((("q", "qd", "qdd", "tau"), ("tau0", "tau1", "tau2")), (("q", "qd", "qdd"), ())):
        columns = {f"{name}{k}": parts[name][:, k] for name in layout for k in range(JOINTS)}
        assert Content.of(columns).torques == torques


def test_a_file_without_a_header_is_drafted_in_degrees(tmp_path: Path) -> None:
    parts = signals()
    large = [np.degrees(parts[name] * 8) for name in ("q", "qd")]
    path = tmp_path / "log.txt"
    np.savetxt(path, np.hstack([parts["t"], *large, parts["tau"], parts["tau"] + 1e-3]))
    drafted = survey(path, [(str(k),) for k in range(3)]).table
    assert 'time = "column[1]"' in drafted
    assert 'joints = [2, 3, 4], unit = "deg" }' in drafted
    assert "joints = [8, 9, 10]" in drafted
    assert "or column[11] to column[13]" in drafted


@pytest.mark.parametrize("scale", [1.0, 2.2])
def test_accelerations_of_another_rate_are_no_torques_and_torques_of_equal_wheels_are(scale: float) -> None:
    """Learning data sets hold q, dq, ddq, tau without names: accelerations, filtered, were drafted as torques."""
    parts = signals()
    noise = np.random.default_rng(8).standard_normal(parts["qdd"].shape)
    parts["acc"] = (parts["qdd"] + 0.3 * np.std(parts["qdd"]) * noise) * scale
    names = [f"{what}{k}" for what in ("q", "qd", "acc", "tau") for k in range(JOINTS)]
    table = np.hstack([parts[what] for what in ("q", "qd", "acc", "tau")])
    found = Content.of(dict(zip(names, table.T, strict=True)))
    assert found.torques == ("tau0", "tau1", "tau2")
    alone = Content.of(dict(zip(names[:9], table.T[:9], strict=True)))  # of another rate: torques of equal inertias
    assert alone.torques == (() if scale == 1.0 else ("acc0", "acc1", "acc2"))


def test_joints_that_move_in_step_are_all_drafted(tmp_path: Path) -> None:
    """Positions and then their rates in one array, from point to point, and inputs that are one row shorter."""
    n = 900
    s = np.clip((np.arange(n) - 60) / (n - 120), 0, 1)
    shape, rate = 10 * s**3 - 15 * s**4 + 6 * s**5, np.gradient(10 * s**3 - 15 * s**4 + 6 * s**5, DT)
    travels, rng = np.array([0.19, 0.8, 2.1, -1.6, 0.2, -0.004]), np.random.default_rng(1)
    noise = 2e-4 * rng.standard_normal((n, 6))
    state = np.hstack((1.0 + shape[:, None] * travels, rate[:, None] * travels + noise))
    torque = 4 * np.cos(state[:, :6]) + 0.3 * rng.standard_normal((n, 6))
    for name, array in (("time", DT * np.arange(n)), ("trajectory", state), ("input", torque[1:])):
        np.savetxt(tmp_path / f"{name}.csv", array, delimiter=",", fmt="%.6g")
    table = survey(tmp_path).table
    assert tomllib.loads(table)["channels"]["position"]["joints"] == [1, 2, 3, 4, 5, 6]
    assert "is it input[1..6]?" in table


@pytest.mark.parametrize("unit", [1.0, 180 / np.pi], ids=("alike", "measured in degrees"))
def test_planned_positions_in_the_array_of_the_measured_ones_are_no_joints(unit: float) -> None:
    made = signals()
    q, qd = unit * made["q"], unit * made["qd"]
    state = np.column_stack((q, made["plan"], qd, np.gradient(made["plan"], DT, axis=0)))
    columns = {f"state[{k}]": state[:, k] for k in range(4 * JOINTS)}
    columns |= {f"u[{k}]": made["tau"][:, k] for k in range(JOINTS)}
    found = Content.of({"t": DT * np.arange(len(state)), **columns})
    assert found.positions == ("state[0]", "state[1]", "state[2]")
    assert found.torques == ("u[0]", "u[1]", "u[2]")


def test_accelerations_beside_positions_and_rates_are_not_asked_for_as_torques(tmp_path: Path) -> None:
    """A planned trajectory, in one array or by names, has three groups: the third one was offered as the torques."""
    parts = signals()
    planned = np.gradient(np.gradient(parts["q"], DT, axis=0), DT, axis=0)
    apart = {"q": parts["q"], "q_dot_filtered": parts["qd"], "q_ddot_filtered": planned}
    np.savez(tmp_path / "named.npz", t=parts["t"][:, 0], **apart)
    np.savez(tmp_path / "one.npz", t=parts["t"][:, 0], Qrad=np.hstack([parts["q"], parts["qd"], parts["qdd"]]))
    for name in ("named.npz", "one.npz"):
        draft = survey(tmp_path / name).table
        assert "is it" not in draft
        assert "# torque = ...  # no channel of torques" in draft
        assert len(tomllib.loads(draft)["channels"]["position"]["joints"]) == JOINTS
    found = {c.name: c.reason for c in survey(tmp_path / "one.npz").topics[0].channels}
    assert found["Qrad[7]"] == "the rate of a velocity"
    np.savez(tmp_path / "more.npz", t=parts["t"][:, 0], load=parts["tau"], **apart)
    drafted = tomllib.loads(survey(tmp_path / "more.npz").table)["channels"]
    assert drafted["torque"]["field"] == "load"
