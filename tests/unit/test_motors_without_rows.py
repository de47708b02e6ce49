"""Methods that weight or filter single rows, where a motor has none: its torque shows noise alone."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from test_noise_alone import study

import haptid
import small_study
from haptid.estimation import SUR, Heteroscedastic
from haptid.study.read import read_study


@pytest.fixture(scope="module")
def rows(tmp_path_factory: pytest.TempPathFactory) -> haptid.Observation:
    """Of two links, of which the second motor has no rows and no friction: the first one tells all."""
    found = read_study(study(tmp_path_factory.mktemp("noise"), 0.3))
    text = small_study.DEVICE.replace('joints = "all"', 'joints = ["1"]')
    path = tmp_path_factory.mktemp("device") / "device.toml"
    path.write_text(text)
    log = haptid.read_log(found.path.parent / found.logs[0].path, found.logs[0].channels)
    treatment = haptid.Treatment(cutoff_hz=20.0, parallel_cutoff_hz=10.0, decimation=4, block_s=0.5)
    made = haptid.observe(haptid.DynamicModel(haptid.read_device(path)), haptid.treat(log, treatment))
    assert [bool(motor.rows.any()) for motor in made.motors] == [True, False]
    return made


@pytest.mark.parametrize("method", [haptid.GLS(), haptid.IRLS(), Heteroscedastic(), SUR()], ids=lambda m: m.name)
def test_the_others_are_identified(rows: haptid.Observation, method: haptid.Method) -> None:
    plain = haptid.estimate(rows, haptid.WLS())
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        found = haptid.estimate(rows, method)
    assert np.isfinite(found.se).all()
    assert (np.abs(found.beta - plain.beta) < 4 * np.hypot(plain.se, found.se)).all()
