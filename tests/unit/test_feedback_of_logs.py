"""The feedback that a log was recorded under, and what noise that goes around it adds to moments of rows."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import haptid
from elastic_motors import DT, FV, FVM, IA, STEP, TRUTH, D, J, K, axis, recorded
from haptid.estimation.methods.simulation_based import base_columns
from haptid.experiment import bench
from haptid.simulation.driven_noise import MotionNoise, noise_moments
from haptid.simulation.loop import Loop, loop_of

TREATMENT = haptid.Treatment(cutoff_hz=80.0, decimation=10, parallel_cutoff_hz=25.0)


def test_gains_of_the_controller_are_found_above_the_motion():
    """On the bench, whose controller filters the velocity: the gain of the position is read off, and the damping."""
    pytest.importorskip("mujoco")
    model = axis()
    chi = np.array([TRUTH.get(name, 0.0) for name in model.device.parameters.names])
    setup = bench.Setup(
        model, chi, bench.Controller((60.0,), (2.0,)), bench.Encoders((80_000.0,)), bench.Amplifiers(noise=(0.05,))
    )
    kind = bench.Multisine(8.0, (0.0,), (0.5,), frequencies_hz=(0.4, 8.0), count=8)
    motion = bench.plan(kind, model, setup.dt, np.random.default_rng(0))
    made = bench.simulate(setup, motion, np.random.default_rng(1))
    channels = haptid.Channels(haptid.Signal(("q", "theta"), "rad"), haptid.Signal(("u",), "N m", side="motor"), "t")
    seen, command = np.ascontiguousarray(made.position), np.ascontiguousarray(made.command)
    log = haptid.Log(Path("made"), "", made.t, seen, command, channels)
    treatment = replace(TREATMENT, cutoff_hz=30.0)  # the controller filters the velocity at 100 Hz
    loop = loop_of(model, haptid.treat(log, treatment))
    assert loop is not None
    assert loop.gains[0, 0, 0] == pytest.approx(60.0, rel=0.1)
    assert loop.gains[1, 0, 0] == pytest.approx(2.0, rel=0.1)
    assert loop.rest[0] < 0.05 * 2 * DT * 0.05**2
    # Noise that is read with the torque and moves nothing hides the feedback: the torque is not that of the positions.
    rng = np.random.default_rng(2)
    loud = np.asarray(log.torque) + 2.0 * rng.standard_normal(log.torque.shape)
    assert loop_of(model, haptid.treat(replace(log, torque=loud), treatment)) is None


def test_a_torque_that_does_not_follow_the_positions_is_no_feedback():
    """The closed form, whose torque has noise of its own above the motion."""
    assert loop_of(axis(), haptid.treat(recorded(), TREATMENT)) is None


@pytest.mark.parametrize("feedback", [True, False])
def test_moments_of_noise_are_those_of_the_closed_form(feedback):
    model, motion = axis(), haptid.treat(recorded(seconds=4.0), TREATMENT)
    beta = np.array([TRUTH[name] for name in model.base.names])
    kp, kd, level, w = 60.0, 2.0, 2 * DT * 0.05**2, 2 * DT * STEP**2 / 12
    loop = Loop(np.array([kp, kd, 0.0])[:, None, None], np.zeros(1)) if feedback else None
    density = np.array([0.0, w])[:, None] * np.ones((2, 2))  # of the links, which are not measured, and of the motor
    noise = MotionNoise(np.array([0.0, 500.0]), density, loop)
    # The integral on a finer grid.
    f = (np.arange(4000) + 0.5) * 100.0 / 4000
    taps = motion.treatment.taps(DT)
    power = np.abs(np.exp(-2j * np.pi * np.outer(f, np.arange(len(taps))) * DT) @ taps) ** 2 * 100.0 / 4000
    s = 2j * np.pi * f
    Z = IA * s**2 + FVM * s + (K + D * s) * (J * s**2 + FV * s) / (J * s**2 + (FV + D) * s + K)
    G = 1 / (Z + kp + kd * s) if feedback else 0 * s
    S = G * Z if feedback else 1.0
    error = np.sum(power * w * np.abs(Z) ** 2)
    made = noise_moments(model, base_columns(model), beta, motion, noise, np.array([error + level * power.sum()]))
    assert made.error[0] == pytest.approx(error, rel=1e-3)
    for name, slope in (("IAM1", s**2), ("FVM1", s)):
        k = model.base.names.index(name)
        score = np.sum(power * (w * (np.conj(slope * S) * Z).real + level * (slope * G).real))
        size = np.sum(power * (w * np.abs(slope * S * Z) + level * np.abs(slope * G)))
        assert made.score[0, k] == pytest.approx(score, abs=2e-3 * size)
        assert made.information[0, k, k] == pytest.approx(np.sum(power * w * np.abs(slope * S) ** 2), rel=2e-3)
    late = np.sum(power * (w * (s * Z * S * np.conj(Z)).real + level * (s * Z * G).real))
    assert made.late[0] == pytest.approx(late, abs=2e-3 * np.sum(power * np.abs(s * Z) * (w * np.abs(Z * S) + level)))
