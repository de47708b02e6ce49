"""What logs tell at best of elastic motors: the bound against a closed form, and what it advises, tried."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import haptid
from elastic_motors import DT, TRUTH, D, J, K, axis, quasi_static, recorded, treated
from haptid.errors import IdentifiabilityError
from haptid.treatment_choice.elasticity import expect_elasticity, with_bounds
from haptid.treatment_choice.hidden_joints import _followed, complete_logs
from haptid.treatment_choice.spring_bound import SpringBound, spring_bound

NAMES = axis().base.names
BETA = np.array([TRUTH[name] for name in NAMES])
# Sines of the motor's position, Hz, whose torque's noise is this share of its torque.
LINES, NOISE = np.geomspace(0.4, 11.0, 16), 0.01


def impedance(s: np.ndarray, beta: np.ndarray) -> np.ndarray:
    """Torque of the motor by its position, whose link follows."""
    J, K, D, IA, FV, FVM = beta  # by the order of NAMES
    spring = K + D * s
    return IA * s**2 + FVM * s + spring * (J * s**2 + FV * s) / (J * s**2 + FV * s + spring)


def motor(counts: float, seconds: float = 6.0, times: float = 1.0) -> tuple[haptid.Log, np.ndarray, float]:
    """A log of the motor's side, its motion played so many times as fast: with amplitudes, and the torque's noise."""
    rng, t = np.random.default_rng(1), DT * np.arange(round(seconds / DT))
    first = 2j * np.pi * LINES * rng.uniform(0.97, 1.03, len(LINES))
    Q = (1.5 / np.abs(first)) * np.exp(1j * rng.uniform(0, 2 * np.pi, len(LINES)))
    theta = Q * (J * first**2 + (TRUTH["FV1"] + D) * first + K) / (D * first + K)
    noise = NOISE * float(np.sqrt(np.sum(np.abs(impedance(first, BETA) * theta) ** 2) / 2))
    s = times * first
    wave, step = np.exp(s[:, None] * t), 2 * np.pi / counts
    q, tau = ((x[:, None] * wave).real.sum(axis=0) for x in (theta, impedance(s, BETA) * theta))
    tau = tau + noise * rng.standard_normal(len(t))
    channels = haptid.Channels(haptid.Signal(("theta",), "rad"), recorded().channels.torque, "t")
    seen = np.ascontiguousarray(step * np.round(q / step)[:, None])
    return haptid.Log(Path("made"), "", t, seen, tau[:, None], channels), s, noise


def bound(log: haptid.Log, highest: float = 11.0) -> SpringBound:
    rows = haptid.observe(axis(), treated(_followed(axis(), log)))
    found = spring_bound(rows, BETA, highest, delays=False)
    assert found is not None
    return found


def test_the_bound_is_that_of_a_transfer_function():
    """White noise of rounding and of the torque, line by line."""
    counts, seconds = 4096.0, 12.0
    log, s, noise = motor(counts, seconds)
    unit = 1e-6 * np.diag(BETA)
    slopes = np.array([impedance(s, BETA + h) - impedance(s, BETA - h) for h in unit]) / (2e-6 * BETA[:, None])
    theta = np.abs(np.linalg.lstsq(np.exp(s[:, None] * log.t).T, log.position[:, 0] + 0j, rcond=None)[0]) * 2
    density = 2 * DT * (np.abs(impedance(s, BETA)) ** 2 * (2 * np.pi / counts) ** 2 / 12 + noise**2)
    information = seconds * ((slopes * theta**2 / density) @ slopes.conj().T).real
    wanted = 100 * np.sqrt(np.diag(np.linalg.inv(information))) / BETA
    found = bound(log)
    assert found.names == ("KE1", "DE1")
    assert found.reached
    np.testing.assert_allclose(found.least, wanted[[NAMES.index(name) for name in found.names]], rtol=0.2)


def test_what_would_lower_the_bound_does():
    """Finer encoders, a faster motion, a longer log: each as it is advised, and somewhat less of it."""
    poor = bound(motor(512.0)[0])
    assert not poor.reached
    advised = re.search(
        r"\((\d+) counts a turn\), or this motion ([\d.]+) times as fast \(to [\d.]+ Hz\), or a log ([\d.]+) times",
        poor.advice,
    )
    assert advised, poor.advice
    counts, times, longer = map(float, advised.groups())
    for factor, reached in ((1.0, True), (0.5, False)):
        assert bound(motor(factor * counts)[0]).reached is reached
    assert bound(motor(512.0, times=times)[0], times * 11.0).reached
    for factor, reached in ((1.2, True), (0.8, False)):
        assert bound(motor(512.0, seconds=factor * longer * 6.0)[0]).reached is reached


def test_a_refusal_tells_the_bound_and_what_would_reach_it():
    with pytest.raises(IdentifiabilityError, match=r"Cramer-Rao bound.*KE1 [\d.]+ %, DE1 [\d.]+ %") as caught:
        complete_logs(axis(), [motor(256.0)[0]], [True], torque_delay_s=0.0, parallel_cutoff_hz=12.0)
    assert "noise of the encoders" in str(caught.value)
    assert "counts a turn" in caught.value.advice


def test_positions_of_a_few_steps_have_no_bound():
    rows = haptid.observe(axis(), treated(_followed(axis(), motor(64.0)[0])))
    assert spring_bound(rows, BETA, 11.0) is None


def test_springs_that_both_sides_hide_are_hidden_and_others_have_bounds_that_their_errors_keep():
    """Far below the resonance; least squares finds a spring there, with a standard error of a sixth of it."""
    settings = haptid.Treatment(cutoff_hz=40.0, decimation=10, parallel_cutoff_hz=12.0)
    found = haptid.estimate(haptid.observe(axis(), haptid.treat(quasi_static(2e-4), settings)), haptid.WLS())
    with pytest.raises(IdentifiabilityError, match="KE1 hidden"):
        expect_elasticity(found, 3.7)
    rough = np.random.default_rng(0).standard_normal(recorded().torque.shape)
    noisy = replace(recorded(), torque=recorded().torque + 0.4 * recorded().torque.std() * rough)
    poor = with_bounds(haptid.estimate(haptid.observe(axis(), treated(noisy)), haptid.WLS()), 11.0)
    told = re.search(r"KE1 ([\d.]+) %, DE1 ([\d.]+) %\.$", poor.notes[-1])
    assert told, poor.notes[-1]
    for name, least in zip(("KE1", "DE1"), map(float, told.groups()), strict=True):
        assert 0.8 * least < poor[name].relative_se  # of some 15 blocks


def test_a_refusal_says_where_a_method_would_do():
    """Behind a wide filter, rows that weigh all frequencies alike."""
    log = motor(1024.0)[0]
    with pytest.raises(IdentifiabilityError, match="That would do, and haptid does not reach it"):
        complete_logs(axis(), [log], [True], torque_delay_s=0.0, parallel_cutoff_hz=28.0)
