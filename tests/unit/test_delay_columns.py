"""Delays of logs from control loops, where the positions follow the noise that is in the residual."""

from __future__ import annotations

import functools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import signal

import elastic_motors
import haptid
from haptid.observation.augmented import torque_of
from haptid.treatment_choice import find_delays
from haptid.treatment_choice.delay_columns import smooth_part
from haptid.uncertainty.quantities import half_width

RATE, SECONDS, BAND, DELAY = 1000, 12.0, 1.5, 2e-3
INERTIA, VISCOUS, COULOMB = 0.05, 0.08, 0.15
# The guard is a part of the parallel filter's half length: rows near reversals have jumps of dry friction in them.
SETTINGS = haptid.Treatment(60.0, parallel_cutoff_hz=20.0, decimation=5, reversal_speed=0.1, reversal_guard_s=0.005)
TERMS = [{"kind": kind, "joints": "all"} for kind in ("viscous", "coulomb")]


@functools.cache
def axis():
    return elastic_motors.axis(terms=TERMS)


def in_a_loop(seed, size=0.05, fed_back=True, delay=DELAY):
    """A log of an axis under PD control at 6 Hz, moved by noise of its torque that no channel has.

    Of small disturbances x the loop is linear, J x'' + D x'(t - d) + K x(t - d) = w, and so simulated.
    """
    rng, dt = np.random.default_rng(seed), 1 / RATE
    t = dt * np.arange(-RATE, RATE * SECONDS)
    w = 2 * np.pi * BAND * np.array([1 / 3, 2 / 3, 1.0])[:, None]
    a, p = rng.uniform(0.2, 0.5, (3, 1)), rng.uniform(0, 2 * np.pi, (3, 1))
    q, qd, qdd = (np.sum(a * w**k * np.sin(w * t + p + 0.5 * np.pi * k), axis=0) for k in range(3))
    torque = INERTIA * qdd + VISCOUS * qd + COULOMB * np.sign(qd)
    noise = size * torque.std() * rng.standard_normal(len(t))
    natural, late = 2 * np.pi * 6.0, round(delay / dt)
    loop = np.zeros(late + 4)
    loop[:3] += [1.0, -2.0, 1.0]
    loop[late + 1 : late + 3] += 1.6 * natural * dt * np.array([1.0, -1.0])
    loop[late + 1] += (natural * dt) ** 2
    x = fed_back * signal.lfilter([0.0, dt**2 / INERTIA], loop, noise)
    xd, xdd = np.gradient(x, dt), np.pad(np.diff(x, 2), 1) / dt**2
    command = INERTIA * (qdd + xdd) + VISCOUS * (qd + xd) + COULOMB * np.sign(qd + xd) - noise
    rows = np.arange(RATE, len(t) - late)
    channels = haptid.Channels(haptid.Signal(("q1",), "rad"), haptid.Signal(("u1",), "N m", side="motor"), time="t")
    position, torque = (q + x)[rows, None], command[rows + late][:, None]
    return haptid.Log(Path("made"), str(seed), dt * np.arange(len(rows)), position, torque, channels)


def found(log, bandwidth_hz, settings=SETTINGS):
    return find_delays(axis(), [log], settings, bandwidth_hz=bandwidth_hz)


def test_a_control_loop_that_feeds_noise_back_does_not_bias_the_delay():
    """Twelve blocks give Student's t with some ten degrees of freedom, of standard deviation 1.12."""
    logs = [in_a_loop(seed) for seed in range(6)]
    with_noise, of_motion = (
        np.array([float((one.seconds[0] - DELAY) / one.se[0]) for one in (found(log, band) for log in logs)])
        for band in (np.inf, BAND)
    )
    limit = 4 * 1.12 / np.sqrt(len(logs))
    assert abs(of_motion.mean()) < limit < with_noise.mean()
    assert np.sqrt(np.mean(of_motion**2)) < 1.12 + limit


def test_the_motion_has_all_of_the_delay_where_positions_have_no_noise():
    log = in_a_loop(1, fed_back=False)
    whole, part = found(log, np.inf), found(log, BAND)
    np.testing.assert_allclose(part.seconds, whole.seconds, atol=0.2 * whole.se[0])
    np.testing.assert_allclose(part.se, whole.se, rtol=0.1)


def test_rows_near_reversals_tell_more_of_a_delay():
    log = in_a_loop(1)
    assert found(log, BAND).se < found(log, BAND, replace(SETTINGS, reversal_guard_s=None)).se


def test_an_interval_of_a_delay_has_the_degrees_of_freedom_of_its_blocks():
    one = found(in_a_loop(2), BAND)
    assert 3 < one.dof[0] < SECONDS  # blocks of a second
    np.testing.assert_allclose(np.diff(one.conf_int(0.9))[:, 0], 2 * half_width(one.se, one.dof, 0.9))
    np.testing.assert_allclose(one.conf_int().mean(axis=1), one.seconds)


@pytest.mark.parametrize("kind", ["coulomb", "coulomb-by-direction", "stribeck", "load-friction"])
def test_what_is_low_passed_has_no_jump_at_a_reversal(kind):
    more = {"velocity": 0.3} if kind == "stribeck" else {}
    model = elastic_motors.axis(
        gravity=[0.0, -9.81, 0.0], terms=[{"kind": "viscous", "joints": "all"}, {"kind": kind, "joints": "all", **more}]
    )
    chi = np.ones(10 + len(model.terms))
    c, cd, cdd = np.full((1, 2), 0.3), np.array([[-1e-9, 1e-9]]), np.ones((1, 2))
    whole, smooth = (torque_of(model, x, c, cd, cdd)[0] for x in (chi, smooth_part(model, chi)))
    assert np.ptp(whole) > 0.1
    assert np.ptp(smooth) < 1e-8
    assert np.all(smooth != 0.0)


def test_a_long_delay_in_a_loop_is_seen_in_the_torque_of_the_bodies_too():
    """Beyond six samples it must be; noise in the loop biases a column with what is above the motion."""
    one = found(in_a_loop(1, delay=10e-3), BAND)
    assert one.accepted
    np.testing.assert_allclose(one.seconds, 10e-3, atol=4 * one.se[0])
