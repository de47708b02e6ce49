"""Rounding of encoders in periodic motion: its effect on parameters and delays is found from the rounded log alone."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import haptid
from haptid.log.spectrum import spectra
from haptid.treatment_choice import find_delays
from haptid.treatment_choice.rounding import Rounding, rounding_effect
from haptid.treatment_choice.uncertainty import with_treatment_uncertainty
from sampling import of_deviation, of_share
from small_study import two_links
from true_parameters import true_parameters

DT, SAMPLES, TURNS, DRAWS = 5e-3, 41, 40, 10
# Steps of encoders, rad: strokes of tens of steps, and one too fine to matter.
COARSE, FINE = 2e-2, 1e-7
TREATMENT = haptid.Treatment(cutoff_hz=40.0, parallel_cutoff_hz=20.0, reversal_speed=0.5, reversal_guard_s=0.005)


@pytest.fixture(scope="module")
def model():
    return two_links()


def log(model, beta, seed: int, step: float, apart: float = 1.0) -> haptid.Log:
    """Three harmonics whose period is a whole number of samples, rounded; torque with white noise of a thousandth.

    With frequencies that are apart by another factor the motion does not come back.
    """
    rng, t = np.random.default_rng(seed), DT * np.arange(SAMPLES * TURNS)
    w = 2 * np.pi / (SAMPLES * DT) * np.arange(1, 4) ** apart
    a, p = rng.normal(size=(2, 3)) / np.arange(1, 4), rng.uniform(0, 2 * np.pi, (2, 3, 1))
    q, qd, qdd = (
        np.einsum("jk,jkn->jn", 0.4 * a * w**k, np.sin(w[:, None] * t + p + 0.5 * np.pi * k)) for k in range(3)
    )
    q = q + rng.uniform(-0.5, 0.5, (2, 1))  # the lattice lies anywhere
    tau = haptid.inverse_dynamics(model, beta, q, qd, qdd)
    tau = tau + 1e-3 * tau.std(axis=1, keepdims=True) * rng.normal(size=tau.shape)
    channels = haptid.Channels(haptid.Signal(("q1", "q2"), "rad"), haptid.Signal(("u1", "u2"), "N m"), time="t")
    return haptid.Log(Path("log"), "", t, step * np.round(q.T / step), tau.T, channels)


def effect(model, made: haptid.Log) -> tuple[haptid.Estimate, haptid.treatment_choice.Delays, Rounding | None]:
    """Estimate and delays of a log, and what rounding moves them by."""
    delays = find_delays(model, [made], TREATMENT)
    treatment = replace(TREATMENT, torque_delay_s=delays.setting)
    estimate = haptid.estimate(haptid.observe(model, haptid.treat(made, treatment)), haptid.WLS())
    return estimate, delays, rounding_effect(estimate, [made], [spectra(made)], treatment, delays)


def test_rounding_moves_estimates_as_far_as_is_found_and_intervals_hold_the_truth(model):
    beta = model.base.of(true_parameters(model))
    found, scatter, inside = [], [], []
    for seed in range(DRAWS):
        estimate, delays, rounding = effect(model, log(model, beta, seed, COARSE))
        assert rounding is not None
        size = np.sqrt(np.mean(rounding.shifts**2, axis=0))
        errors = np.append(estimate.beta - beta, delays.seconds)[: len(size)]
        found += list(errors / size)
        scatter += list((estimate.beta - beta) / estimate.se)
        ends = np.asarray(with_treatment_uncertainty(estimate, delays, {}, rounding).conf_int())
        inside.append(np.mean((ends[:, 0] <= beta) & (beta <= ends[:, 1])))
    # All parameters of a draw share its errors: as if a quarter of them were independent.
    many = DRAWS * len(beta) / 4
    assert abs(np.sqrt(np.mean(np.square(found))) - 1) < of_deviation(int(many)) + 0.15  # eight lattices: t of 8 dof
    assert np.sqrt(np.mean(np.square(scatter))) > 10
    assert np.mean(inside) > 0.95 - of_share(0.95, many)


def test_motion_that_does_not_come_back_is_in_the_scatter_of_blocks(model):
    """Nothing is added, or little by chance; lattices of one step added more than the blocks' own variance."""
    beta, off, added = model.base.of(true_parameters(model)), [], 0.0
    for seed in range(DRAWS):
        estimate, _, rounding = effect(model, log(model, beta, seed, 0.1 * COARSE, apart=0.9))
        off += list((estimate.beta - beta) / estimate.se)
        if rounding is not None:
            added += float(np.mean(np.sum(rounding.beyond()[:, : len(beta)] ** 2, axis=0) / estimate.se**2))
    many = DRAWS * len(beta) / 4
    assert abs(np.sqrt(np.mean(np.square(off))) - 1) < of_deviation(int(many)) + 0.1  # blocks: t of few dof
    assert added / DRAWS < 0.3


def test_a_fine_encoder_costs_nothing(model):
    beta = model.base.of(true_parameters(model))
    assert effect(model, log(model, beta, 1, FINE))[2] is None


def test_only_what_no_scatter_shows_is_added_and_shifts_stay_together():
    shifts = np.array([[3.0, 1.0, 0.0], [4.0, -1.0, 0.0]])
    rounding = Rounding(shifts, np.array([2.5, 1.0, 0.0]), np.array([1.0, 1.0, 0.0]))
    share = 1 - (2.5 + 1.0) / (12.5 + 1.0)
    assert np.allclose(rounding.beyond(), shifts * np.sqrt(share / 2))
    share = 1 - (2.5 + 4.0 + 1.0 + 1.0) / (12.5 + 1.0)
    assert np.allclose(rounding.beyond(np.array([4.0, 1.0, 1.0])), shifts * np.sqrt(share / 2))
    assert not rounding.beyond(100.0).any()


def test_what_cancels_in_the_torque_still_does():
    """Of two columns that are nearly alike only the sum is known; rounding moves the parameters against each other."""
    shifts = np.array([[1.0, -1.0], [-1.1, 1.1], [0.9, -0.9]])
    added = Rounding(shifts, np.array([0.2, 0.9]), np.array([1.0, 1.0])).beyond()
    assert added.any()
    assert np.allclose(added.sum(axis=1), 0.0)
