"""A stream gives the rows of the whole log, block by block, however its samples come."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import haptid
from haptid.errors import LogDataError, SettingError, ShapeError
from haptid.estimation import RecursiveIdentification
from haptid.motion import Causal, HighPass
from haptid.observation import Observation, RowStream
from motions import multisine, truth
from small_study import two_links

DT = 2e-3
CHANNELS = haptid.Channels(haptid.Signal(("q1", "q2"), "rad"), haptid.Signal(("t1", "t2"), "N m"), rate_hz=1 / DT)
MODEL = two_links()
TREATMENTS = {
    "differences": haptid.Treatment(decimation=10),
    "guards and delay": haptid.Treatment(
        decimation=7, reversal_speed=0.1, rest_speed=0.02, torque_delay_s=0.0013, block_s=0.7
    ),
    "momentum": haptid.Treatment(decimation=10, formulation="momentum"),
    "causal": haptid.Treatment(
        cutoff_hz=None,
        velocity=HighPass(30.0),
        parallel_cutoff_hz=10.0,
        parallel_shape=Causal(),
        formulation="momentum",
        decimation=5,
    ),
}


def samples(seconds: float, seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Positions and noisy torques, each (n, 2)."""
    q, qd, qdd = multisine(2, seconds, DT, seed)
    tau = haptid.inverse_dynamics(MODEL, truth(MODEL) + 0.1, q, qd, qdd)
    return q.T, (tau + 0.02 * np.random.default_rng(seed).standard_normal(tau.shape)).T


def batch(q: np.ndarray, tau: np.ndarray, treatment: haptid.Treatment, t0: float = 0.0) -> Observation:
    """The rows of a log of these samples."""
    log = haptid.Log(Path("log"), "stream", t0 + DT * np.arange(len(q)), q, tau, CHANNELS)
    return haptid.observe(MODEL, haptid.treat(log, treatment))


def streamed(q: np.ndarray, tau: np.ndarray, treatment: haptid.Treatment, sizes: list[int]) -> list[Observation]:
    """Blocks of a stream that comes in pieces of these sizes, over and over."""
    stream, found, at, k = RowStream(MODEL, CHANNELS, DT, treatment), [], 0, 0
    while at < len(q):
        size = sizes[k % len(sizes)]
        found += stream.push(q[at : at + size], tau[at : at + size])
        at, k = at + size, k + 1
    return found + list(stream.finish())


def same(one: Observation, other: Observation) -> None:
    """The same blocks, rows and information, to what rounding of second differences leaves."""
    times = [[(block.start, block.stop) for block in made.blocks] for made in (one, other)]
    np.testing.assert_allclose(*times, rtol=0, atol=1e-9)
    for a, b in zip(one.motors, other.motors, strict=True):
        np.testing.assert_array_equal(a.rows, b.rows)
        A, B = (np.einsum("bij,bik->bjk", x.r_factors, x.r_factors) for x in (a, b))
        assert np.abs(A - B).max() < 1e-10 * np.abs(A).max()


@pytest.mark.parametrize("name", TREATMENTS)
@settings(max_examples=3, deadline=None)
@given(st.lists(st.integers(1, 900), min_size=1, max_size=5), st.integers(0, 3))
def test_rows_are_those_of_the_whole_log(name, sizes, seed):
    q, tau = samples(9.3, seed)
    whole = batch(q, tau, TREATMENTS[name])
    same(whole, sum(streamed(q, tau, TREATMENTS[name], sizes)))


def test_rows_come_as_soon_as_their_samples_are_there():
    """A block is there when `lag` samples after its last row are; a causal treatment waits for a few only."""
    treatment = TREATMENTS["causal"]
    q, tau = samples(6.0)
    stream, count = RowStream(MODEL, CHANNELS, DT, treatment), 0
    assert stream.lag <= 8
    for k in range(len(q)):
        for made in stream.push(q[k : k + 1], tau[k : k + 1]):
            last_row = made.blocks[-1].stop - 0.5 * treatment.decimation * DT
            assert k * DT == pytest.approx(last_row + stream.lag * DT)
            count += 1
    assert count > 4


def test_a_gap_begins_another_log():
    treatment = TREATMENTS["differences"]
    q, tau = samples(12.0)
    stream = RowStream(MODEL, CHANNELS, DT, treatment)
    made = [*stream.push(q[:2600], tau[:2600]), *stream.gap(0.8), *stream.push(q[3000:], tau[3000:]), *stream.finish()]
    parts = batch(q[:2600], tau[:2600], treatment) + batch(q[3000:], tau[3000:], treatment, 3000 * DT)
    one, other = sum(made), parts
    assert one.rows == other.rows
    A, B = one.stack(), other.stack()
    np.testing.assert_allclose(A.T @ A, B.T @ B, rtol=0, atol=1e-10 * np.abs(B.T @ B).max())
    assert one.blocks[-1].stop == pytest.approx(other.blocks[-1].stop)


def test_memory_is_bounded():
    stream = RowStream(MODEL, CHANNELS, DT, TREATMENTS["differences"])
    q, tau = samples(4.0)
    for _ in range(20):
        list(stream.push(q, tau))
        assert len(stream._position) < 3 * stream.lag + 2 * round(1.0 / DT) + stream._reach


def test_a_part_shorter_than_the_filters_gives_no_rows():
    stream = RowStream(MODEL, CHANNELS, DT)
    q, tau = samples(0.05)
    assert [*stream.push(q, tau), *stream.finish()] == []


def test_bad_samples_are_refused():
    stream = RowStream(MODEL, CHANNELS, DT)
    q, tau = samples(0.1)
    with pytest.raises(ShapeError):
        list(stream.push(q[:, :1], tau))
    with pytest.raises(LogDataError, match="torque"):
        list(stream.push(q, np.where(tau == tau[3, 0], np.nan, tau)))
    with pytest.raises(SettingError):
        RowStream(MODEL, CHANNELS, 0.0)


@pytest.mark.parametrize("name", TREATMENTS)
def test_without_forgetting_the_recursion_is_the_batch(name):
    q, tau = samples(20.3)
    whole = haptid.estimate(batch(q, tau, TREATMENTS[name]), haptid.WLS())
    recursion = RecursiveIdentification(MODEL)
    for made in streamed(q, tau, TREATMENTS[name], [400]):
        recursion.add(made)
    found = recursion.estimate()
    np.testing.assert_allclose(found.beta, whole.beta, rtol=1e-10)
    np.testing.assert_allclose(found.se, whole.se, rtol=1e-8)
    np.testing.assert_allclose(found.dof, whole.dof, rtol=1e-8)
    assert (found.status, found.notes) == (whole.status, ())
    few = RecursiveIdentification(MODEL, most=8)
    for made in streamed(q, tau, TREATMENTS[name], [400]):
        few.add(made)
    assert 4 <= len(few) <= 8
    np.testing.assert_allclose(few.estimate().beta, whole.beta, rtol=1e-10)
