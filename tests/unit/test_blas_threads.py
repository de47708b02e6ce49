"""BLAS has one thread while haptid computes, and as many as before afterwards."""

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

import haptid
from haptid._internal.blas_threads import on_one_blas_thread
from motions import motion, truth


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


def test_a_diagnosis_has_one_thread(monkeypatch):
    monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)
    model, seen = haptid.DynamicModel(haptid.read_device("emps")), []
    estimate = haptid.estimate(haptid.observe(model, motion(model, truth(model), noise=0.1)), haptid.WLS())
    monkeypatch.setattr("haptid.inference.diagnosis.diagnosis.subsample", lambda one: seen.append(threads()) or one)
    with threadpool_limits(limits=2, user_api="blas"):
        haptid.diagnose(estimate)
    assert seen == [{1}]
