"""BLAS has one thread while haptid computes, and as many as before afterwards."""

from importlib import import_module
from types import SimpleNamespace

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

import haptid
from haptid._internal.blas_threads import on_one_blas_thread
from haptid.advice import advise
from haptid.experiment.excitation import FourierSeries, design_excitation


def threads() -> set[int]:
    np.ones((2, 2)) @ np.ones((2, 2))
    return {pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"}


@pytest.mark.parametrize(("chosen", "inside"), [(None, {1}), ("2", {2})])
def test_threads_of_blas(monkeypatch, chosen, inside):
    """Nothing is changed where the environment has a number of threads."""
    monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)
    if chosen:
        monkeypatch.setenv("OPENBLAS_NUM_THREADS", chosen)
    with threadpool_limits(limits=2, user_api="blas"):
        if threads() != {2}:
            pytest.skip("this BLAS has one thread")
        assert on_one_blas_thread(threads)() == inside
        assert threads() == {2}


class Reached(Exception):
    """The function has begun."""


@pytest.mark.parametrize(
    ("function", "module", "first"),
    [
        (haptid.identify, "haptid.study.identify", "check_kind"),
        (haptid.diagnose, "haptid.inference.diagnosis.diagnosis", "fit_errors"),
        (advise, "haptid.advice.advise", "subsample"),
        (design_excitation, "haptid.experiment.excitation.search", "indices"),
    ],
)
def test_what_users_call_has_one_thread(monkeypatch, function, module, first):
    """Asked at the first thing that each of them does."""
    seen = []

    def begun(*_):
        seen.append(threads())
        raise Reached

    monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)
    monkeypatch.setattr(import_module(module), first, begun)  # a package may have a function of the module's name
    model = haptid.DynamicModel(haptid.read_device("emps"))
    given = {design_excitation: (model, FourierSeries())}.get(function, (SimpleNamespace(estimate=None),))
    with threadpool_limits(limits=2, user_api="blas"):
        if threads() != {2}:
            pytest.skip("this BLAS has one thread")
        with pytest.raises(Reached):
            function(*given)
    assert seen == [{1}]
