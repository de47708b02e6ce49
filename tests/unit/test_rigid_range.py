"""How far the rigid model holds: up to the end of excitation, below it where an axis is elastic, few false alarms."""

import numpy as np
import pytest
from scipy.stats import binom

from elastic_axis import ROTOR, estimated
from haptid.inference import diagnose
from haptid.inference.diagnosis.residuals import residuals
from haptid.inference.diagnosis.rigid_range import FALSE_ALARMS, frequency_ranges, rigid_range

SEEDS = 40


def found(estimate):
    return rigid_range(frequency_ranges(estimate, residuals(estimate)))


def test_a_rigid_axis_is_explained_up_to_the_end_of_excitation():
    finding = diagnose(estimated(1))["rigid range"]
    assert finding.status == "ok"
    assert 5 < finding.figures["motor 1, Hz"] < 12
    assert "up to at least" in finding.sentence


@pytest.mark.parametrize(("side", "sign", "resonance"), [("motor", 1, 20.0), ("joint", -1, 10.0)])
def test_an_elastic_axis_fails_with_its_resonance(side, sign, resonance):
    estimate = estimated(2, resonance=resonance, side=side)
    (ranges,) = frequency_ranges(estimate, residuals(estimate))
    finding = rigid_range([ranges])
    assert finding.status == "doubt"
    assert "elasticity" in finding.sentence
    assert finding.figures["motor 1, Hz"] < 8
    # Measured at the motor the ratio grows by the link's share, at the joint it falls by the rotor's share.
    share = {"motor": 1 - ROTOR, "joint": ROTOR}[side]
    slope, _ = ranges.growth()
    assert np.sign(slope) == sign
    assert finding.figures["motor 1, resonance, Hz"] == pytest.approx(resonance / np.sqrt(share), rel=0.25)


def test_rigid_axes_raise_few_alarms():
    alarms = sum(
        found(estimated(seed, seconds=20.0, noise=(0.01, 0.05)[seed % 2], dt=4e-3)).status != "ok"
        for seed in range(SEEDS)
    )
    assert alarms <= binom.ppf(0.999, SEEDS, FALSE_ALARMS)


def test_bands_without_excitation_tell_nothing():
    estimate = estimated(3, noise=3.0, seconds=10.0)
    finding = found(estimate)
    assert finding.status == "ok"
    assert "No band" in finding.sentence or finding.figures
