"""Of a long log a part is looked at again and again: it is read once, and is the whole log's there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import haptid
from diagnosed import log, phantom
from haptid.advice.clash import _upside_down
from haptid.advice.recorder import _torque_faults
from haptid.advice.search import Trials, search_of
from haptid.inference.diagnosis import subsample
from haptid.inference.diagnosis.residuals import residuals
from haptid.log import OnDisk, PartlyInMemory, as_array
from haptid.motion.motion import shifted, treat
from haptid.motion.streaming import CUBIC
from haptid.observation.observation import Observation, observe

TREATMENT = haptid.Treatment(cutoff_hz=40, decimation=5, block_s=0.5)


class Counted(OnDisk):
    """Samples as if they were on disk, and how many were read."""

    def __init__(self, samples: np.ndarray) -> None:
        self.samples, self.read = samples, 0

    @property
    def shape(self) -> tuple[int, int]:
        return self.samples.shape[0], self.samples.shape[1]

    def make(self, low: int, high: int) -> np.ndarray:
        self.read += high - low
        return np.ascontiguousarray(self.samples[low:high].T)

    def between(self, low: int, high: int) -> np.ndarray:
        return self.make(low, high)


@given(st.lists(st.tuples(st.integers(0, 99), st.integers(1, 30)), min_size=1, max_size=20), st.floats(-3.0, 3.0))
def test_kept_ranges_are_read_once(slices: list[tuple[int, int]], shift: float) -> None:
    samples = np.random.default_rng(0).normal(size=(140, 2))
    source = Counted(samples)
    part = PartlyInMemory(source, ((0, 60), (80, 140)))
    later = shifted(as_array(part), shift, CUBIC)
    whole = shifted(samples, shift, CUBIC)
    for low, length in slices:
        np.testing.assert_array_equal(part[low : low + length], samples[low : low + length])
        np.testing.assert_allclose(later[low : low + length], whole[low : low + length], rtol=1e-12, atol=1e-15)
    once = source.read
    for low, length in slices:
        for start, stop in part.ranges:
            if start <= low and low + length <= stop:
                part[low : low + length]
    assert source.read == once


def on_disk(made: haptid.Log) -> haptid.Log:
    return replace(made, position=as_array(Counted(made.position)), torque=as_array(Counted(made.torque)))


def estimated(made: haptid.Log) -> haptid.Estimate:
    return haptid.estimate(observe(phantom(), treat(made, TREATMENT)), haptid.WLS())


def test_the_part_of_a_log_on_disk_is_read_once_and_is_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(subsample, "MOST_SAMPLES", 15_000)
    made = log(3, seconds=40.0)
    parts = [subsample.subsample(estimated(one)) for one in (made, on_disk(made))]
    in_memory, of_disk = (residuals(part) for part in parts)
    np.testing.assert_allclose(of_disk.e, in_memory.e, atol=1e-9)
    counted = parts[1].observation.motions[0].log.torque
    before = counted.read
    assert not np.isnan(residuals(replace(parts[1])).e).all()
    assert counted.read == before


def test_there_is_one_part_of_an_estimate(monkeypatch: pytest.MonkeyPatch) -> None:
    made = estimated(log(3, seconds=40.0))
    monkeypatch.setattr(subsample, "MOST_SAMPLES", 15_000)
    part = subsample.subsample(made)
    assert subsample.subsample(made) is part
    monkeypatch.setattr(subsample, "MOST_SAMPLES", 25_000)
    assert len(subsample.subsample(made).observation.blocks) > len(part.observation.blocks)


def test_rows_under_other_gravity_are_those_of_the_whole_log(monkeypatch: pytest.MonkeyPatch) -> None:
    made = estimated(log(3, seconds=40.0))
    monkeypatch.setattr(subsample, "MOST_SAMPLES", 15_000)
    part = subsample.subsample(made).observation
    turned, of_all = _upside_down(part), _upside_down(made.observation)
    down = made.model.with_gravity([-x for x in made.model.device.gravity])
    expected = observe(down, *made.observation.motions)
    _same(of_all, expected)
    _same(turned, expected.pick(np.array([expected.blocks.index(block) for block in part.blocks])))


def _same(ours: Observation, theirs: Observation) -> None:
    assert ours.blocks == theirs.blocks
    for own, other in zip(ours.motors, theirs.motors, strict=True):
        np.testing.assert_array_equal(own.r_factors, other.r_factors)
        np.testing.assert_array_equal(own.rows, other.rows)


def searched(made: haptid.Log) -> Trials:
    found = estimated(made)
    return search_of(phantom(), found.observation.motions, found.beta)


def test_of_a_log_on_disk_the_samples_under_the_rows_are_simulated(monkeypatch: pytest.MonkeyPatch) -> None:
    """Mean squares of the candidates in them are in the proportion of those of the whole log in memory, simulated."""
    monkeypatch.setattr("haptid.inference.diagnosis.subsample.MOST_SAMPLES", 30_000)
    made = log(3, seconds=60.0)
    whole, part = (searched(one) for one in (made, on_disk(made)))
    simulated = [search.bench.artefact() for search in (whole, part)]
    assert all(one is not None for one in simulated)
    powers = [
        np.diag(one.over(np.array([0])).pooled(search.bench.weights**2)) / search.rows.used.sum()
        for one, search in zip(simulated, (whole, part), strict=True)
    ]
    seen = powers[0] > 1e-12 * powers[0].max()
    ratio = np.log(powers[1][seen] / powers[0][seen])
    assert abs(np.median(ratio)) < np.log(3)  # rows at the ends of the ranges are lost
    assert np.median(np.abs(ratio - np.median(ratio))) < 0.1


@given(st.integers(0, 999), st.sampled_from(["noise", "steps", "zeros", "ends", "two", "constant"]))
def test_faults_of_a_channel_are_those_by_all_its_values(seed: int, kind: str) -> None:
    rng = np.random.default_rng(seed)
    u = rng.normal(size=5000)
    match kind:
        case "steps":
            u = np.round(rng.uniform(1.0, 60.0) * u) / 8
        case "zeros":
            u[rng.random(5000) < rng.uniform(0.2, 0.5)] = 0.0
        case "ends":
            u = np.clip(u, -rng.uniform(0.5, 3.0), rng.uniform(0.5, 3.0))
        case "two":
            u = np.where(rng.random(5000) < 0.4, 0.5, np.where(rng.random(5000) < 0.7, -0.5, u))
        case "constant":
            u[:] = 1.0
    values, count = np.unique(u, return_counts=True)
    share = count[1:-1].max(initial=0) / len(u)
    found = [(fault.kind, fault.share, fault.size) for fault in _torque_faults(u, 0)]
    dead = share > 0.3 and share >= count.max(initial=0) / len(u)
    kinds = [own for own, _, _ in found]
    assert ("dead torque" in kinds) == dead
    if dead:
        assert found[0][1:] == (share, values[1 + int(np.argmax(count[1:-1]))])
    assert ("coarse torque" in kinds) == (not dead and 1 < len(values) <= 64)
