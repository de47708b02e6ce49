"""Cross-validation of a study by blocks: who predicts what, and how many fits it takes."""

from types import SimpleNamespace

import numpy as np
import pytest

import haptid
from haptid.observation import concatenated
from haptid.report.run import _pictured
from haptid.study import held_out as module
from haptid.study.held_out import held_out
from haptid.validation.validation import pooled
from motions import motion, truth

STUDY = SimpleNamespace(cross_validation="blocks", method=haptid.WLS(), use="free")


@pytest.fixture(scope="module")
def model():
    return haptid.DynamicModel(haptid.read_device("arm3"))


@pytest.fixture(scope="module")
def observations(model):
    beta = truth(model)
    return [haptid.observe(model, motion(model, beta, seconds=3.0, seed=k, noise=0.1)) for k in range(13)]


def predicted(group, others):
    """Errors of the logs of a group by the definition, per cent."""
    halves = [one.alternate() for one in group]
    folds = []
    for parity in (0, 1):
        fit = haptid.estimate(concatenated([*(half[parity] for half in halves), *others]), haptid.WLS())
        folds.append([haptid.validate(fit, half[1 - parity]) for half in halves])
    return [pooled(*both).relative for both in zip(*folds, strict=True)]


def test_of_few_logs_each_is_held_out_by_itself(model, observations):
    some = observations[:3]
    found = [one.relative for (one,) in held_out(STUDY, model, some, [None] * 3)]
    wanted = [predicted([one], [other for other in some if other is not one])[0] for one in some]
    np.testing.assert_allclose(found, wanted, rtol=1e-9)


def test_of_many_logs_a_tenth_is_held_out_at_a_time(model, observations, monkeypatch):
    fits = []
    monkeypatch.setattr(module, "estimate", lambda *args: fits.append(args) or haptid.estimate(*args))
    found = [one.relative for (one,) in held_out(STUDY, model, observations, [None] * 13)]
    assert len(fits) == 2 * 7  # seven groups of two logs at most
    for first in (0, 12):
        group = slice(first, first + 2)
        wanted = predicted(observations[group], observations[:first] + observations[first + 2 :])
        np.testing.assert_allclose(found[group], wanted, rtol=1e-9)


def test_of_many_logs_those_that_are_predicted_worst_are_pictured():
    def run(error):
        return SimpleNamespace(unseen=(SimpleNamespace(comparable=SimpleNamespace(relative=error)),), fit_errors=None)

    runs = [run(error) for error in range(30)]
    assert [k for k, _ in _pictured(runs)] == list(range(18, 30))
    assert [k for k, _ in _pictured(runs[:5])] == list(range(5))
