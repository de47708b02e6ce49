"""Cached R factors of an interrupted run are used only for the same motion and the same device."""

from dataclasses import replace

import numpy as np
import pytest

import haptid
from haptid.observation.batch import observe_all
from haptid.observation.cache import RFactorCache, fingerprint
from haptid.observation.plan import Plan
from small_study import DEVICE, write_study

TERMS = """
[[terms]]
kind = "load-friction"
motors = "all"
[[terms]]
kind = "stribeck"
joints = ["2"]
velocity = { start = 0.5, low = 0.02, high = 5 }
[[terms]]
kind = "custom"
name = "C1"
unit = "N m"
joints = ["1"]
expression = "tanh(v_1 / s)"
constants = { s = { start = 0.2, low = 0.01, high = 2 } }
"""


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    path = tmp_path_factory.mktemp("device") / "device.toml"
    path.write_text(DEVICE + TERMS)
    return haptid.DynamicModel(haptid.read_device(path))


@pytest.fixture(scope="module")
def motion(tmp_path_factory):
    study = haptid.read_study(write_study(tmp_path_factory.mktemp("study")))
    log = haptid.read_log(study.path.parent / "log.csv", study.logs[0].channels)
    return haptid.treat(log, haptid.Treatment(cutoff_hz=30.0, decimation=5))


def named(model, motion):
    return fingerprint(Plan.of(model, motion))


def test_another_load_of_the_bodies_has_another_name(model, motion):
    heavy = model.loaded(np.ones(len(model.base)))
    names = [named(d, motion) for d in (model, heavy, model.loaded(2.0 * np.ones(len(model.base))))]
    assert len(set(names)) == 3
    assert named(model.loaded(np.ones(len(model.base))), motion) == names[1]


def test_another_value_of_a_searched_constant_has_another_name(model, motion):
    assert len({named(model.at_constants(values), motion) for values in ((0.5, 0.2), (0.4, 0.2), (0.5, 0.3))}) == 3


@pytest.mark.parametrize("what", ["tau", "q"])
@pytest.mark.parametrize("where", [0.3, 0.9])
def test_signals_that_differ_late_have_another_name(model, motion, what, where):
    first = int(where * len(motion))
    signals = np.array(getattr(motion, what))
    signals[first:] += 1e-3
    assert named(model, replace(motion, **{what: signals})) != named(model, motion)


def test_a_run_does_not_take_what_another_load_left(model, motion, tmp_path):
    kept = RFactorCache(tmp_path / "kept", least=1)
    heavy = model.loaded(np.ones(len(model.base)))
    observe_all(model, [motion], cache=kept)
    (found,) = observe_all(heavy, [motion], cache=kept)
    np.testing.assert_array_equal(found.stack(), haptid.observe(heavy, motion).stack())
