"""What of a long log is looked at once more."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import haptid
from diagnosed import log, phantom
from haptid.inference.diagnosis import diagnose, subsample
from haptid.inference.diagnosis.residuals import residuals
from haptid.inference.diagnosis.subsample import (
    FEWEST_BLOCKS,
    MOST_SAMPLES,
    block_numbers,
    evenly_spaced,
    log_name,
    row_ranges,
)
from haptid.observation.plan import Plan

TREATMENT = haptid.Treatment(cutoff_hz=40, decimation=5, block_s=0.5)


def estimated(**faults: float) -> haptid.Estimate:
    motion = haptid.treat(log(3, seconds=40.0, **faults), TREATMENT)
    return haptid.estimate(haptid.observe(phantom(), motion), haptid.WLS())


@given(st.integers(1, 600), st.integers(1, 50_000_000))
def test_blocks_are_few_in_order_and_spread_over_all(blocks: int, samples: int) -> None:
    kept = evenly_spaced(blocks, samples)
    assert (np.diff(kept) > 0).all()
    assert kept[0] >= 0
    assert kept[-1] < blocks
    if len(kept) == blocks:
        assert samples <= MOST_SAMPLES * (1 + 1 / blocks) + blocks or blocks <= FEWEST_BLOCKS
        return
    assert len(kept) * samples <= MOST_SAMPLES * blocks or len(kept) <= FEWEST_BLOCKS
    assert len(kept) >= 0.7 * min(FEWEST_BLOCKS, blocks)
    assert np.diff(kept, prepend=0, append=blocks).max() <= max(3 * blocks / min(len(kept), 20), 2)


def test_a_short_log_is_looked_at_whole() -> None:
    made = estimated()
    assert subsample.subsample(made) is made
    assert not any("long" in sentence for sentence in diagnose(made).left_out)


def test_runs_are_the_wanted_blocks_and_nothing_else() -> None:
    made = estimated()
    plan = Plan.of(phantom(), made.observation.motions[0])
    wanted = made.observation.blocks[2:5] + made.observation.blocks[9:10]
    assert list(row_ranges(plan, made.observation.blocks)) == list(plan.segments())
    assert list(row_ranges(plan, wanted)) == [(2 * plan.block, 5 * plan.block), (9 * plan.block, 10 * plan.block)]
    assert dict(block_numbers(plan, wanted)) == {2: 0, 3: 1, 4: 2, 9: 3}


def test_residuals_of_a_portion_are_those_of_the_whole_there(monkeypatch: pytest.MonkeyPatch) -> None:
    made = estimated()
    whole = residuals(made)
    monkeypatch.setattr(subsample, "MOST_SAMPLES", 15_000)
    part = subsample.subsample(made)
    assert FEWEST_BLOCKS <= len(part.observation.blocks) < len(made.observation.blocks)
    assert {log_name(motion) for motion in part.observation.motions} == {b.log for b in part.observation.blocks}
    some = residuals(part)
    there = np.isfinite(some.t) & (some.block >= 0)
    at = np.searchsorted(whole.t[np.isfinite(whole.t)], some.t[there] - 1e-9)
    np.testing.assert_allclose(some.e[:, there], whole.e[:, at], atol=1e-9 * np.nanmax(np.abs(whole.predicted)))


@pytest.mark.parametrize(
    ("fault", "size", "name"),
    [
        ("late", 2.0, "time delay"),
        ("offset", 0.5, "friction by direction"),
        ("stribeck", 1.0, "friction near standstill"),
    ],
)
def test_a_portion_finds_the_fault_that_the_whole_has(
    monkeypatch: pytest.MonkeyPatch, fault: str, size: float, name: str
) -> None:
    made = estimated(**{fault: size})
    whole = diagnose(made)
    monkeypatch.setattr(subsample, "MOST_SAMPLES", 15_000)
    part = diagnose(made)
    assert "tests of the residual use" in part.left_out[0]
    assert part[name].status == whole[name].status != "ok"
    assert part["excitation"] == whole["excitation"]
    assert part["influence"] == whole["influence"]


def test_a_portion_accuses_a_clean_log_of_nothing_more_than_the_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    made = estimated()
    whole = diagnose(made)
    monkeypatch.setattr(subsample, "MOST_SAMPLES", 15_000)
    part = diagnose(made)
    bad = [{finding.name for finding in found.findings if finding.status == "bad"} for found in (part, whole)]
    assert bad[0] <= bad[1]
