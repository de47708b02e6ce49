"""Checks: each fault is named with its channel and its size, and sound but coarse logs pass."""

from __future__ import annotations

import dataclasses
import json
import math
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from haptid import errors
from haptid.log import Channels, Log, Signal, read_log
from haptid.log.stamps import checked
from haptid.log.units import SPELLINGS, TABLES, closest_unit

QUICK = settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
T = np.arange(4000) / 1000
POSITION = np.sin(2 * np.pi * T)
TORQUE = 3 * np.cos(2 * np.pi * T) + 0.1 * np.sin(300 * T)


def read(
    folder: Path,
    q: np.ndarray | None = None,
    tau: np.ndarray | None = None,
    position: dict[str, object] | None = None,
    torque: dict[str, object] | None = None,
    exclude: tuple[tuple[float, float], ...] = (),
) -> Log:
    """The log of one joint at 1 kHz with these samples, 4 s of a sine where None."""
    path = folder / "log.npz"
    q = POSITION if q is None else q
    np.savez(path, q=q, tau=TORQUE[: q.size] if tau is None else tau)
    settings = {"channels": "q", "unit": "rad"} | (position or {})
    return read_log(
        path,
        Channels(
            Signal(**settings),  # type: ignore[arg-type]
            Signal(**({"channels": "tau", "unit": "N m"} | (torque or {}))),  # type: ignore[arg-type]
            rate_hz=1000,
        ),
        exclude=exclude,
    )


@pytest.mark.parametrize(
    ("made", "doubted"),
    [(np.abs, True), (lambda tau: tau, False), (lambda tau: 20 + tau, False), (lambda tau: np.abs(tau) - 0.3, False)],
)
def test_torques_that_may_be_magnitudes_are_doubted(tmp_path: Path, made: Callable, doubted: bool) -> None:
    """Servos of hobby arms give the size of their current: no sign was asked for, and channels were said to be dead."""
    path = tmp_path / "log.npz"
    tau = made(np.column_stack((TORQUE, 0.5 * np.roll(TORQUE, 90))))
    np.savez(path, q1=POSITION, q2=np.roll(POSITION, 50), tau1=tau[:, 0], tau2=tau[:, 1])
    log = read_log(path, Channels(Signal(("q1", "q2"), "rad"), Signal(("tau1", "tau2"), "N m"), rate_hz=1000))
    assert any("all 2 torque channels are never negative" in note for note in log.notes) == doubted


def test_missing_samples_are_counted(tmp_path: Path) -> None:
    tau = TORQUE.copy()
    tau[[17, 40, 41]] = np.nan, np.inf, 1e40
    with pytest.raises(errors.LogDataError) as raised:
        read(tmp_path, tau=tau)
    assert raised.value.where == ("tau", 17)
    assert raised.value.found == 3


def test_dead_channels(tmp_path: Path) -> None:
    dead = np.full(T.size, 0.25)
    with pytest.raises(errors.LogDataError) as raised:
        read(tmp_path, q=dead)
    assert raised.value.where == "q"
    assert raised.value.found == 0.25
    with pytest.raises(errors.LogDataError) as raised:
        read(tmp_path, tau=dead)
    assert raised.value.where == "tau"
    log = read(tmp_path, q=dead, tau=dead, position={"constant_ok": True}, torque={"constant_ok": True})
    assert len(log.notes) == 2


def test_identical_channels(tmp_path: Path) -> None:
    with pytest.raises(errors.LogDataError) as raised:
        read(tmp_path, tau=POSITION)
    assert raised.value.where == ("q", "tau")
    nearly = POSITION.copy()
    nearly[1234] += 1e-3
    assert read(tmp_path, tau=nearly)


def test_faults_in_parts_that_are_left_out_are_no_faults(tmp_path: Path) -> None:
    """A position that jumps there and back, and a clipped torque."""
    q, tau = POSITION.copy(), TORQUE.copy()
    q[2000:2010] += 3.0
    tau[3000:3100] = 5.0
    with pytest.raises(errors.LogDataError, match=r"jumps by 3\.0"):
        read(tmp_path, q=q, exclude=((2.99, 3.11),))
    with pytest.raises(errors.LogDataError, match="saturated"):
        read(tmp_path, q=q, tau=tau, exclude=((1.99, 2.02),))
    log = read(tmp_path, q=q, tau=tau, exclude=((1.99, 2.02), (2.99, 3.11)))
    assert len(log.segments) == 3
    left = ((log.t < 1.99) | (log.t > 2.02)) & ((log.t < 2.99) | (log.t > 3.11))
    assert left.all()
    np.testing.assert_array_equal(np.asarray(log.position)[:, 0], POSITION[np.rint(1000 * log.t).astype(int)])


@pytest.mark.parametrize("at", [2000, 2005, 2010])
def test_a_part_that_is_left_out_does_not_hide_lost_counts(tmp_path: Path, at: int) -> None:
    """The position jumps and does not come back; and a part at the end of the log, after which nothing is used."""
    q = POSITION.copy()
    q[at:] += 0.5
    with pytest.raises(errors.LogDataError, match=r"stays 0\.5\d* away: its counts are lost"):
        read(tmp_path, q=q, exclude=((1.999, 2.011),))
    assert read(tmp_path, q=q, exclude=((1.999, 1e3),)).t[-1] < 2.0


# --- saturation ---


@pytest.mark.parametrize("sign", [1, -1])
def test_saturated_torque(tmp_path: Path, sign: int) -> None:
    tau = sign * np.minimum(TORQUE, 2.5)
    with pytest.raises(errors.LogDataError) as raised:
        read(tmp_path, tau=tau)
    assert raised.value.where == "tau"
    assert raised.value.found > raised.value.limit
    log = read(tmp_path, tau=tau, torque={"allow_saturation": True})
    assert "is saturated at" in log.notes[0]


@pytest.mark.parametrize("sign", [1, -1])
def test_a_torque_of_one_direction_is_not_called_saturated(tmp_path: Path, sign: int) -> None:
    tau = sign * np.maximum(TORQUE - TORQUE.mean(), 0.0)
    with pytest.raises(errors.LogDataError, match=r"exactly at its extreme 0 N m .* one direction only, or is dead"):
        read(tmp_path, tau=tau)
    assert read(tmp_path, tau=tau, torque={"allow_saturation": True})


@QUICK
@given(share=st.floats(0.3, 0.93), step=st.floats(1e-4, 0.02), phase=st.floats(0, 1))
def test_a_clipped_converter_is_caught(tmp_path: Path, share: float, step: float, phase: float) -> None:
    tau = np.clip(np.sin(2 * np.pi * (T + phase)), -share, share)
    with pytest.raises(errors.LogDataError):
        read(tmp_path, tau=np.round(tau / step))


@QUICK
@given(
    levels=st.floats(3, 4000),
    frequency=st.floats(0.5, 5),
    phase=st.floats(0, 1),
    offset=st.floats(-1, 1),
    hold=st.integers(1, 20),
)
def test_coarse_torques_are_not_saturated(
    tmp_path: Path, levels: float, frequency: float, phase: float, offset: float, hold: int
) -> None:
    smooth = np.sin(2 * np.pi * (frequency * T + phase)) + offset + 0.2 * np.sin(40 * T)
    held = np.repeat(smooth[::hold], hold)[: T.size]
    assert read(tmp_path, tau=np.round(held * levels / 2))


def test_a_torque_that_is_switched_between_two_levels_is_no_saturated_one(tmp_path: Path) -> None:
    switched = np.where(np.sin(3 * T) > 0.3, 5.0, -2.0)
    (note,) = [note for note in read(tmp_path, tau=switched).notes if "relay" in note]
    assert "between -2 and 5 N m" in note
    with pytest.raises(errors.LogDataError, match="saturated"):
        read(tmp_path, tau=np.clip(5 * np.sin(3 * T), -1, 1))


def test_a_torque_at_rest_is_not_saturated(tmp_path: Path) -> None:
    q, tau = POSITION.copy(), TORQUE.copy()
    q[:600], tau[:600] = q[600], 5.0
    assert read(tmp_path, q=q, tau=tau)


# --- jumps and wraps ---


@QUICK
@given(place=st.integers(5, 3990), jump=st.floats(0.5, 1.5), spike=st.booleans())
def test_position_jumps(tmp_path: Path, place: int, jump: float, spike: bool) -> None:
    q = POSITION.copy()
    q[place : place + 1 if spike else None] += jump
    with pytest.raises(errors.LogDataError) as raised:
        read(tmp_path, q=q)
    assert raised.value.where[0] == "q"
    assert ("a damaged row" if spike else "lost counts") in str(raised.value)


@QUICK
@given(counts=st.floats(2, 1e5), speed=st.floats(0.01, 10))
def test_coarse_positions_do_not_jump(tmp_path: Path, counts: float, speed: float) -> None:
    q = np.round(counts * np.sin(speed * T)).astype(np.int32)
    if q.min() != q.max():
        assert read(tmp_path, q=q, position={"unit": "counts", "gain": (2 * math.pi / 4000,)})


WRAPS = [
    ("rad", 2 * np.pi, 1.0),
    ("deg", 360.0, 1.0),
    ("turn", 1.0, 1.0),
    ("counts", 4096.0, 2 * np.pi / 4096),
]


@pytest.mark.parametrize(("unit", "turn", "gain"), WRAPS)
@QUICK
@given(speed=st.floats(2.0, 100.0), start=st.floats(0, 1))
def test_wrapped_angles_are_recognised_and_straightened(
    tmp_path: Path, unit: str, turn: float, gain: float, speed: float, start: float
) -> None:
    straight = turn * (start + speed * T * (1 + 0.1 * np.sin(T)))
    wrapped = np.mod(straight, turn)
    options = {"unit": unit, "gain": (gain,)}
    with pytest.raises(errors.LogDataError) as raised:
        read(tmp_path, q=wrapped, position=options)
    assert "`unwrap = true`" in raised.value.advice
    log = read(tmp_path, q=wrapped, position=options | {"unwrap": True})
    scale = 2 * np.pi / turn
    travel = (straight - straight[0]) * scale
    np.testing.assert_allclose(log.position[:, 0] - log.position[0, 0], travel, rtol=0, atol=1e-9 * travel[-1])
    assert "unwrapped at" in log.notes[0]


def test_a_period_that_is_no_power_of_two(tmp_path: Path) -> None:
    straight = 50_000 * 3 * T
    options: dict[str, object] = {"unit": "counts", "gain": (2 * math.pi / 50_000,), "period": 50_000}
    with pytest.raises(errors.LogDataError) as raised:
        read(tmp_path, q=np.mod(straight, 50_000), position=options)
    assert raised.value.found == 50000
    log = read(tmp_path, q=np.mod(straight, 50_000), position=options | {"unwrap": True})
    np.testing.assert_allclose(log.position[:, 0], 6 * np.pi * T, atol=1e-9)


@pytest.mark.parametrize("speed", [0.3, 3.0, -7.0])
def test_a_register_that_wraps_at_its_own_range(tmp_path: Path, speed: float) -> None:
    """A drive that counts from -12.5 to 12.5 rad: jumps of about the channel's range, not of a turn."""
    straight = speed * 40 * T * (1 + 0.1 * np.sin(T))
    wrapped = np.mod(straight + 12.5, 25.0) - 12.5
    with pytest.raises(errors.LogDataError, match="it is wrapped") as raised:
        read(tmp_path, q=wrapped)
    assert raised.value.found == 25
    assert "`unwrap = true` and `period = 25`" in raised.value.advice
    log = read(tmp_path, q=wrapped, position={"unit": "rad", "unwrap": True, "period": 25.0})
    np.testing.assert_allclose(log.position[:, 0], straight, rtol=0, atol=1e-9 * np.abs(straight).max())


# --- units, gains, mapping ---


@pytest.mark.parametrize(
    ("unit", "si"),
    [("rad", 1), ("deg", math.pi / 180), ("turn", 2 * math.pi), ("m", 1), ("mm", 1e-3), ("um", 1e-6)],
)
def test_positions_are_in_si(tmp_path: Path, unit: str, si: float) -> None:
    log = read(tmp_path, q=POSITION / si * 0.3, position={"unit": unit, "gain": (2.0,), "offset": (0.5,)})
    np.testing.assert_allclose(log.position[:, 0], 0.6 * POSITION + 0.5, rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize(
    ("unit", "base", "si"),
    [
        ("N m", "N m", 1),
        ("mN m", "N m", 0.001),
        ("N", "N", 1),
        ("V", "V", 1),
        ("mV", "V", 0.001),
        ("A", "A", 1),
        ("mA", "A", 0.001),
        ("counts", "counts", 1),
    ],
)
def test_torques_are_in_the_base_unit(tmp_path: Path, unit: str, base: str, si: float) -> None:
    log = read(tmp_path, torque={"unit": unit, "gain": (-1.0,)})
    np.testing.assert_allclose(log.torque[:, 0], -si * TORQUE, rtol=1e-12)
    assert log.channels.torque_unit == base


def test_unknown_units_say_what_was_meant() -> None:
    for quantity, table in TABLES.items():
        for unit in table:
            for spelling in SPELLINGS[unit]:
                mega = "MN" + spelling[2:] if unit.startswith("MN") and spelling[:2] == "mn" else spelling
                assert closest_unit(mega, quantity) == unit
    with pytest.raises(errors.LogChannelError) as raised:
        Channels(Signal("q", "rad"), Signal("tau", "Nm"), "t")
    assert raised.value.where == "torque"
    assert raised.value.found == "Nm"
    assert raised.value.advice.startswith("Write 'N m'.")
    assert "mN m" in raised.value.limit
    with pytest.raises(errors.LogChannelError) as raised:
        Channels(Signal("q", "furlong"), Signal("tau", "N m"), "t")
    assert raised.value.where == "position"
    assert not raised.value.advice.startswith("Write")
    with pytest.raises(errors.LogChannelError) as raised:
        Channels(Signal("q", "rad"), Signal("tau", "N m"), "t", time_unit="min")
    assert raised.value.where == "time"


def test_units_of_something_else() -> None:
    with pytest.raises(errors.LogChannelError) as raised:
        Channels(Signal("q", "N m"), Signal("tau", "N m"), "t")
    assert raised.value.where == "position"
    assert raised.value.found == "N m"
    with pytest.raises(errors.LogChannelError) as raised:
        Channels(Signal("q", "rad"), Signal("tau", "deg"), "t")
    assert raised.value.where == "torque"
    assert raised.value.found == "deg"


def test_counts_need_a_gain() -> None:
    with pytest.raises(errors.LogChannelError) as raised:
        Channels(Signal("q", "counts"), Signal("tau", "N m"), "t")
    assert raised.value.where == "gain"


def test_times_in_another_unit_than_they_are_said_to_be() -> None:
    with pytest.raises(errors.LogTimeError) as raised:
        checked(Path("log.csv"), "t", 1000.0 * np.arange(200), 1.0)
    assert raised.value.found == 1000.0
    assert "'us'" in raised.value.advice


def test_time_is_given_once() -> None:
    q, tau = Signal("q", "rad"), Signal("tau", "N m")
    with pytest.raises(errors.LogChannelError) as raised:
        Channels(q, tau)
    assert raised.value.found == (None, None)
    with pytest.raises(errors.LogChannelError) as raised:
        Channels(q, tau, "t", rate_hz=100)
    assert raised.value.found == ("t", 100)


@pytest.mark.parametrize(
    "wrong",
    [
        {"channels": ()},
        {"channels": ("q", "")},
        {"side": "link"},
        {"gain": (1.0, 2.0)},
        {"gain": (0.0,)},
        {"gain": (math.nan,)},
        {"offset": (math.inf,)},
        {"period": -1.0},
    ],
)
def test_signals_that_contradict_themselves(wrong: dict[str, object]) -> None:
    with pytest.raises(errors.LogChannelError) as raised:
        Signal(**({"channels": ("q",), "unit": "rad"} | wrong))  # type: ignore[arg-type]
    assert raised.value.where in wrong
    with pytest.raises(errors.LogChannelError) as raised:
        Channels(Signal("q", "rad"), Signal("tau", "N m"), rate_hz=-1)
    assert raised.value.where == "rate_hz"


def test_one_figure_stands_for_all_channels() -> None:
    signal = Signal(["a", "b"], "rad", gain=(2.0,))  # type: ignore[arg-type]
    assert (signal.channels, signal.gain, signal.offset) == (("a", "b"), (2.0, 2.0), (0.0, 0.0))


@pytest.mark.parametrize(("names", "time"), [(("q", "q"), "t"), (("q", "tau"), "t"), (("q", "t"), "t")])
def test_one_channel_in_two_places(names: tuple[str, ...], time: str) -> None:
    with pytest.raises(errors.LogChannelError) as raised:
        Channels(Signal(names, "rad"), Signal("tau", "N m"), time)
    assert len(raised.value.found) == 2


# --- the value ---


def test_a_log_keeps_its_channels_contiguous_and_unwritable() -> None:
    channels = Channels(Signal(("a", "b"), "rad"), Signal("tau", "N m"), rate_hz=10)
    position = np.arange(20.0).reshape(10, 2)
    log = Log(Path("x"), "", np.arange(10) / 10, position, np.ones((10, 1)), channels)
    position[0, 0] = 99
    assert log.position[0, 0] == 0
    assert log.position.T.flags.c_contiguous
    assert (log.dt, log.rate_hz) == pytest.approx((0.1, 10))
    with pytest.raises(ValueError, match="read-only"):
        log.position[0, 0] = 1
    with pytest.raises(dataclasses.FrozenInstanceError):
        log.t = position[:, 0]  # type: ignore[misc]
    with pytest.raises(errors.ShapeError, match="position"):
        Log(Path("x"), "", np.arange(10) / 10, position.T, np.ones((10, 1)), channels)
    with pytest.raises(errors.LogTimeError):
        Log(Path("x"), "", np.zeros(1), np.zeros((1, 2)), np.ones((1, 1)), channels)


def test_every_error_of_a_log_is_tested() -> None:
    tests = "".join(path.read_text() for path in Path(__file__).parent.glob("test_log_*.py"))
    names = [cls.__name__ for cls in errors.LogError.__subclasses__()]
    assert [name for name in names if f"errors.{name}" not in tests] == []


def test_a_joint_that_stands_between_two_steps_of_its_encoder_is_not_wrapped(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    t = np.arange(2000) * 1e-3
    still = 0.4 + 5.75e-4 * (rng.random(t.size) < 0.1) + 1e-12 * rng.standard_normal(t.size)
    moving = np.sin(3.0 * t)
    path = tmp_path / "log.npz"
    np.savez(path, t=t, q1=moving, q2=still, tau1=moving + 0.01 * t, tau2=rng.standard_normal(t.size))
    assert read_log(path).position.shape[1] == 2
    np.savez(path, t=t, q1=np.mod(40.0 * t, 25.0) - 12.5, tau1=moving)
    with pytest.raises(errors.LogDataError, match="jumps by its whole period of 25 rad"):
        read_log(path)


def test_first_rows_of_an_earlier_run_are_left_out_by_the_exclude_that_is_said(tmp_path: Path) -> None:
    """A recorder that starts with what its buffer holds: the first two rows are of the end of the run before."""
    t = np.arange(3000) * 1e-3
    q, tau, path = 0.1 * np.sin(3.0 * t), np.random.default_rng(1).standard_normal(t.size), tmp_path / "log.npz"
    q[:2] -= 1.4
    np.savez(path, t=t, q1=q, tau1=tau)
    with pytest.raises(errors.LogDataError, match="first rows are of another moment") as raised:
        read_log(path)
    shown = re.search(r"exclude = (\[\[.*\]\])", str(raised.value))
    assert shown is not None
    log = read_log(path, exclude=tuple(map(tuple, json.loads(shown[1]))))
    assert len(log.t) == 2998
    assert float(np.ptp(np.asarray(log.position))) < 0.21


@pytest.mark.parametrize("rows", [(700,), (700, 1200, 1500)])
def test_damaged_rows_are_no_wrap_and_say_what_to_exclude(rows: tuple[int, ...], tmp_path: Path) -> None:
    """A recorder that writes another packet now and then: once, there and back are from one end to the other."""
    t = np.arange(9000) * 1e-3
    q, tau, path = 0.1 * np.sin(3.0 * t), np.random.default_rng(1).standard_normal(t.size), tmp_path / "log.npz"
    damaged = q.copy()
    damaged[list(rows)] = 0.9
    np.savez(path, t=t, q1=damaged, q2=np.cos(t), tau1=tau, tau2=tau[::-1])
    with pytest.raises(errors.LogDataError, match="damaged row") as raised:
        read_log(path)
    shown = re.search(r"exclude = (\[\[.*\]\])", str(raised.value))
    assert shown is not None
    ranges = json.loads(shown[1])
    assert [round(float(np.mean(one)) * 1e3) for one in ranges] == list(rows)
    log = read_log(path, exclude=tuple(map(tuple, ranges)))
    assert float(np.ptp(np.asarray(log.position)[:, 0])) < 0.21
