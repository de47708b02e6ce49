"""Tables without names of channels: what they hold is told by the numbers, or nothing is said."""

import numpy as np
import pytest

from haptid.log.by_numbers import is_time, rate_by_velocities, recognised
from haptid.log.survey import survey
from motions import multisine

RATE = 125.0


def table(joints=3, seconds=20.0, noise=1e-4, seed=0):
    """Positions, velocities, noisy accelerations and torques, (rows, joints) each."""
    rng = np.random.default_rng(seed)
    q, v, a = multisine(joints, seconds, 1 / RATE, seed)
    torque = 2.0 * a + 3.0 * np.sin(q) + 0.5 * np.sign(v)
    made = (q, v, a + a.std() * rng.standard_normal(a.shape), torque)
    return [(x + noise * x.std() * rng.standard_normal(x.shape)).T for x in made]


@pytest.mark.parametrize("joints", [1, 3, 6])
def test_columns_are_recognised_in_their_order(joints):
    q, v, a, torque = table(joints)
    t = np.arange(len(q)) / RATE + 798.2
    found = recognised(np.column_stack([t, q, v, a, torque]).T, joints)
    n = joints
    assert found.time == 0
    assert found.positions == tuple(range(1, 1 + n))
    assert found.velocities == tuple(range(1 + n, 1 + 2 * n))
    assert found.torques == (tuple(range(1 + 3 * n, 1 + 4 * n)),)
    assert 1 / found.step_s == pytest.approx(RATE, rel=0.03)


def test_torques_may_stand_first_and_wanted_motion_last():
    q, v, _, torque = table(2)
    found = recognised(np.column_stack([torque[:-3], q[:-3], v[:-3], q[3:], v[3:]]).T, 2)
    assert (found.positions, found.velocities, found.torques) == ((2, 3), (4, 5), ((0, 1),))


def test_as_many_joints_as_can_be_without_a_device():
    q, v, _, torque = table(4)
    assert recognised(np.column_stack([q, v, torque]).T).positions == (0, 1, 2, 3)


def test_nothing_is_said_of_columns_without_rates():
    q, _, _, torque = table(3)
    assert recognised(np.column_stack([q, torque]).T, 3) is None
    assert recognised(np.random.default_rng(1).standard_normal((9, 400)), 3) is None


def test_a_time_grows_steadily():
    t = np.arange(500) * 0.008
    assert is_time(t + 5)
    assert not is_time(t[::-1])
    assert not is_time(np.sin(t))
    assert not is_time(np.repeat(t, 2))
    assert not is_time(t**3)


def test_the_rate_of_a_log_without_times_is_drafted_from_velocities(tmp_path):
    q, v, _, torque = table(2)
    named = tmp_path / "named.csv"
    head = "q1,q2,qd1,qd2,tau1,tau2"
    np.savetxt(named, np.column_stack([q, v, torque]), delimiter=",", header=head, comments="")
    assert "rate_hz = 125 " in survey(named).table
    assert rate_by_velocities(q, v) == pytest.approx(RATE, rel=0.03)
    assert rate_by_velocities(q, torque) == 0


def test_no_rate_is_made_up(tmp_path):
    """A study with a rate that nobody wrote would be wrong without a word: the key is left to be written."""
    q, _, _, torque = table(2)
    path = tmp_path / "log.csv"
    np.savetxt(path, np.column_stack([q, torque]), delimiter=",", header="q1,q2,tau1,tau2", comments="")
    assert "# rate_hz = ..." in survey(path).table


def test_a_file_without_a_header_is_drafted(tmp_path):
    q, v, _, torque = table(3)
    path = tmp_path / "log.txt"
    np.savetxt(
        path, np.column_stack([np.arange(len(q)) / RATE, np.degrees(q * 40), np.degrees(v * 40), torque, torque])
    )
    drafted = survey(path, [(str(k),) for k in range(3)]).table
    assert 'time = "column[1]"' in drafted
    assert 'joints = [2, 3, 4], unit = "deg" }  # guess: column[5] to column[7] are its rates' in drafted
    assert 'joints = [8, 9, 10], unit = "N m" }' in drafted
    assert "or column[11] to column[13]" in drafted
