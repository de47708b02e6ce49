"""Least squares again with other positions: what noise does to parameters whose delays are estimated with them."""

from dataclasses import replace

import numpy as np

import haptid
from elastic_motors import axis, recorded
from haptid.treatment_choice.delay_estimate import Delays, find_delays
from haptid.treatment_choice.refit import Refit

SETTINGS = haptid.Treatment(cutoff_hz=40.0, decimation=10, parallel_cutoff_hz=16.0)


def fitted(log: haptid.Log, delays: Delays) -> haptid.Estimate:
    late = replace(SETTINGS, torque_delay_s=tuple(delays.seconds))
    return haptid.estimate(haptid.observe(axis(), haptid.treat(log, late)), haptid.WLS())


def test_noise_moves_parameters_as_in_fits_whose_delays_are_estimated_anew():
    """With a delay that stays as it was, damping and friction move by something else."""
    log = recorded(seconds=10.0)
    delays = find_delays(axis(), [log], SETTINGS)
    made = fitted(log, delays)
    refit = Refit.of(made, delays)
    as_is = refit.least_squares([log.position])
    moved, fixed, late = [], [], []
    for seed in range(6):
        noisy = replace(
            log, position=log.position + 5e-4 * np.random.default_rng(seed).standard_normal((len(log.t), 2))
        )
        found = find_delays(axis(), [noisy], SETTINGS)
        anew = fitted(noisy, found).beta
        change = refit.least_squares([noisy.position]) - as_is
        moved.append(made.beta + change[:-1] - anew)
        fixed.append(fitted(noisy, delays).beta - anew)
        late.append((change[-1], found.seconds[0] - delays.seconds[0]))
    rms = np.sqrt(np.mean(np.square([moved, fixed]), axis=1))
    for name in ("DE1", "FV1"):
        own = made.names.index(name)
        assert rms[0, own] < 0.75 * rms[1, own]
    assert np.corrcoef(np.transpose(late))[0, 1] > 0.5
