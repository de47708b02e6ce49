"""Elastic motors from the motors alone behind coarse encoders: rows that weigh each frequency by its noise."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from test_motor_side import two_joints

import haptid
from elastic_motors import DT
from haptid.errors import IdentifiabilityError
from haptid.estimation.methods.motor_noise import WHITENED, with_noise_uncertainty
from haptid.simulation.driven_noise import gains
from haptid.treatment_choice import whitening as module
from haptid.treatment_choice.hidden_joints import complete_logs
from haptid.treatment_choice.motor_delays import with_motor_delays


def coarse() -> tuple[haptid.DynamicModel, haptid.Log, dict[str, float]]:
    """Two coupled links behind encoders of 12 bits."""
    model, log, values = two_joints()
    step = 2 * np.pi / 4096
    return model, replace(log, position=np.ascontiguousarray(step * np.round(log.position / step))), values


def test_stiffness_that_noise_at_one_frequency_hides_is_found_from_the_others():
    pytest.importorskip("mujoco")
    model, log, values = coarse()
    _, found = complete_logs(model, [log], [True])
    assert found.method.whitening is not None
    found = with_noise_uncertainty(with_motor_delays(found))
    assert WHITENED in found.notes
    for name, value, se in zip(found.names, found.beta, found.se, strict=True):
        if name in values:  # the others have regroupings
            assert abs(value - values[name]) < 3.5 * se, (name, value, se)
    for motor, stiffness in (("a", 400.0), ("b", 150.0)):
        assert abs(found[f"KE{motor}"].value / stiffness - 1) < 0.02
        assert abs(found[f"DE{motor}"].value / 0.3 - 1) < 0.1


def test_rows_behind_a_filter_that_is_given_keep_it():
    pytest.importorskip("mujoco")
    model, log, _ = coarse()
    with pytest.raises(IdentifiabilityError, match="noise of the encoders"):
        complete_logs(model, [log], [True], parallel_cutoff_hz=10.5)


def test_filters_are_the_inverse_of_a_spectrum(monkeypatch):
    """A resonance whose amplitude is twenty times that of the noise beside it, and a white one."""
    pytest.importorskip("mujoco")
    model, log, _ = coarse()
    motion = haptid.treat(log, haptid.Treatment(cutoff_hz=80.0, decimation=10, parallel_cutoff_hz=12.0))

    def density(*given: object) -> np.ndarray:
        f = np.asarray(given[-1])
        return np.array([1 + 400 / (1 + ((f - 6.0) / 0.7) ** 2), np.ones_like(f)])

    monkeypatch.setattr(module, "residual_density", density)
    taps = module.whitening(SimpleNamespace(model=model, motions=(motion,)), np.zeros(1), True)
    np.testing.assert_array_equal(taps, taps[:, ::-1])
    f = np.linspace(0.5, 10.0, 200)
    before, plain = density(f)
    first, second = gains(taps, f, DT) ** 2
    assert (before * first).max() / np.median(before * first) < 0.1 * before.max() / np.median(before)
    np.testing.assert_allclose(plain * second, 1.0, atol=0.1)  # what passes counts, and the band ends at 12 Hz
