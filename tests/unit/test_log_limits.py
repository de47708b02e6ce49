"""What only the device can tell: degrees for radians, radians for degrees, exchanged channels."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from haptid import errors
from haptid.log import Channels, Log, Signal, check_against
from haptid.log.log import Side

T = np.arange(500) / 100
NAMES = ("A", "B")
RANGES = ((-1.5, 1.5), (0.0, 3.0))


def log(position: np.ndarray, unit: str = "rad", side: Side = "joint") -> Log:
    """A log of joints whose positions, (n, joints), are already in SI."""
    channels = Channels(Signal(("q1", "q2")[: position.shape[1]], unit, side), Signal("tau", "N m"), rate_hz=100)
    return Log(Path("log"), "", T, position, np.ones((T.size, 1)), channels)


def motion(scale: float = 1.0) -> np.ndarray:
    return scale * np.column_stack([1.2 * np.sin(T), 1.5 + 1.2 * np.cos(T)])


def test_sound_positions_pass() -> None:
    for ranges in (RANGES, (None, None)):
        assert check_against(log(motion()), ranges, (False, False), NAMES) == ()
        assert check_against(log(motion(), "deg"), ranges, (False, False), NAMES) == ()


def test_degrees_passed_as_radians() -> None:
    with pytest.raises(errors.LogMismatchError) as raised:
        check_against(log(motion(57.3)), RANGES, (False, False), NAMES)
    assert raised.value.where == "A"
    assert raised.value.limit == RANGES[0]
    with pytest.raises(errors.LogMismatchError) as raised:
        check_against(log(motion(57.3)), (None, None), (False, False), NAMES)
    assert raised.value.where == "A"
    assert raised.value.limit is None


def test_many_turns_within_limits_are_meant() -> None:
    turns = np.column_stack([20 * np.sin(T), 1.5 + np.cos(T)])
    assert check_against(log(turns), ((-25.0, 25.0), (0.0, 3.0)), (False, False), NAMES) == ()


def test_sliding_joints_have_no_degrees() -> None:
    assert check_against(log(motion(57.3)), (None, None), (True, True), NAMES) == ()
    assert check_against(log(motion(0.001), "m"), (None, None), (True, True), NAMES) == ()


def test_radians_passed_as_degrees() -> None:
    for ranges in (RANGES, (None, None)):
        with pytest.raises(errors.LogMismatchError) as raised:
            check_against(log(motion(np.pi / 180), "deg"), ranges, (False, False), NAMES)
        assert raised.value.found < raised.value.limit


def test_exchanged_channels() -> None:
    a, b = np.column_stack([1.2 * np.sin(T), 2.0 + 0.5 * np.cos(T)]).T
    ranges = ((-1.5, 1.5), (1.0, 3.0))
    with pytest.raises(errors.LogMismatchError) as raised:
        check_against(log(np.column_stack([b, a])), ranges, (False, False), NAMES)
    assert raised.value.where == ("A", "B")
    assert raised.value.found == pytest.approx(2.5, rel=0.05)


def test_a_joint_outside_its_limits_is_not_exchanged_with_one_of_wide_limits() -> None:
    """A controller's zero is a quarter turn away: the other joint is within its own limits, wide as they are."""
    a, b = 1.2 * np.sin(T), 2.6 + 1.4 * np.cos(T)
    (sentence,) = check_against(log(np.column_stack([a, b])), ((-6.3, 6.3), (-3.1, 3.1)), (False, False), NAMES)
    assert "joint B runs from 1.2" in sentence


@pytest.mark.parametrize("still", [False, True])
def test_a_joint_alone_beyond_its_limits_is_not_exchanged(still: bool) -> None:
    """An arm's elbow was 0.16 rad beyond its stop, by another zero; the log was refused, as another joint moves hardly,
    or within the elbow's limits, and was to be exchanged with it."""
    a, b = 0.9 + 1.06 * np.sin(T), 0.02 * np.cos(T) if still else 0.6 + 0.5 * np.cos(T)
    (sentence,) = check_against(log(np.column_stack([a, b])), ((0.0, 2.44), (-0.3, 2.2)), (False, False), NAMES)
    assert "joint A runs from -0.16" in sentence


def test_a_joint_outside_its_limits_is_only_mentioned() -> None:
    (sentence,) = check_against(log(motion()), ((-1.0, 1.0), (0.0, 3.0)), (False, False), NAMES)
    assert "joint A runs from -1.2 to 1.2, outside its limits -1 .. 1" in sentence


def test_motor_side_positions_are_not_compared() -> None:
    assert check_against(log(motion(57.3), side="motor"), RANGES, (False, False), NAMES) == ()


def test_one_joint_that_turns_among_others_is_not_in_degrees() -> None:
    """A wrist without limits turns two and a half times each way; as degrees the other joints would hardly move."""
    turning = np.column_stack([8 * np.sin(T), 0.8 * np.cos(T), np.sin(T)])
    channels = Channels(Signal(("q1", "q2", "q3"), "rad"), Signal("tau", "N m"), rate_hz=100)
    made = Log(Path("log"), "", T, turning, np.ones((T.size, 1)), channels)
    assert check_against(made, (None, None, None), (False,) * 3, ("A", "B", "C")) == ()
    degrees = Log(Path("log"), "", T, 50 * turning, np.ones((T.size, 1)), channels)
    with pytest.raises(errors.LogMismatchError, match="give the joint limits"):
        check_against(degrees, (None, None, None), (False,) * 3, ("A", "B", "C"))


@pytest.mark.parametrize("limits", [None, (-np.pi, np.pi)])
def test_a_single_joint_may_turn(limits: tuple[float, float] | None) -> None:
    """A pendulum that swings up over and over is no mistake of units; fifty turns are one."""
    turns = np.column_stack([10 * np.sin(T)])
    (note,) = check_against(log(turns), (limits,), (False,), NAMES[:1])
    assert ("turns 3.2 times" in note) == (limits is None)
    with pytest.raises(errors.LogMismatchError, match="57.3" if limits is None else "far beyond"):
        check_against(log(16 * turns), (limits,), (False,), NAMES[:1])
