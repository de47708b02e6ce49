"""The coverage study of the zoo: its statistics, and one log through the default path."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from zoo.case import Case
from zoo.coverage import CLASSES, covered, figures, holm, logs_of

NAMES = ["ZZ1", "FV1", "FC1"]


def rows(shares: list[float], count: int, seed: int) -> list[dict[str, Any]]:
    """Logs whose intervals hold the truth independently, with a probability for each parameter."""
    inside = np.random.default_rng(seed).random((count, len(shares))) < shares
    late = {"delay off": [0.0], "delay inside": [True]}
    return [{"status": "ok", "names": NAMES, "inside": row.tolist(), **late} for row in inside]


def test_holm_rejects_in_steps() -> None:
    """The example of Holm (1979) scaled to four hypotheses at 5 %: limits are 0.0125, 0.0167, 0.025 and 0.05."""
    assert holm(np.array([0.01, 0.04, 0.03, 0.005]), 0.05) == [3, 0]
    assert holm(np.array([0.013, 0.001, 0.9, 0.9]), 0.05) == [1, 0]
    assert holm(np.array([0.02, 0.02, 0.02, 0.02]), 0.05) == []


def test_a_parameter_that_is_inside_too_seldom_is_named_and_others_are_not() -> None:
    made = figures(rows([0.95, 0.75, 0.95], 300, 1))
    assert made["below 90 %"] == ["FV1"] == [made["least of"]]
    assert made["p of least"] < 0.05
    assert made["delays inside"] == 1.0
    fair = [figures(rows([0.95, 0.95, 0.95], 300, 10 + k)) for k in range(40)]
    assert not any(one["below 90 %"] for one in fair)
    # 95 % intervals of 40 studies: fewer than 32 hold 0.95 with a probability below 1e-4.
    assert sum(one["monte carlo interval"][0] <= 0.95 <= one["monte carlo interval"][1] for one in fair) >= 32


def test_only_logs_with_status_ok_count() -> None:
    wrong = [{"status": "uncertain", "names": NAMES, "inside": [False] * 3, "delay off": None}] * 5
    made = figures(rows([1.0, 1.0, 1.0], 10, 3) + wrong)
    assert (made["logs"], made["ok"], made["covered"]) == (15, 10, 1.0)


def test_logs_of_a_class_differ_in_the_seed_alone_and_share_none_with_another_class() -> None:
    seen: set[int] = set()
    for name, kind in CLASSES.items():
        cases = list(logs_of(name, 3, 2))
        assert all(replace(case, seed=kind.seed) == kind for case in cases)
        assert len({case.seed for case in cases} - seen) == 3
        seen |= {case.seed for case in cases}


def test_a_clean_log_is_inside(tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every one of four parameters within four standard errors: outside with a probability of 3e-4 at 60 dof."""
    monkeypatch.setattr("zoo.kept.CACHE", tmp_path)
    row = covered(Case(7, "axis", 250, 12, 1.5, 3, bits=18, level=0.01, delay=0.5))
    assert row["status"] == "ok", row
    assert max(np.abs(row["off"])) < 4, row
    assert len(row["inside"]) == len(row["names"])


def test_delays_beside_a_drift_are_as_sure_as_they_are_right() -> None:
    """The jumps of dry friction told whitened rows: four of these logs were six to fifteen standard errors off."""
    made = [covered(case) for case in logs_of("random-walk torque noise", 40, 777)]
    off = np.array([row["delay off"][0] for row in made])
    assert np.abs(off).max() < 4.5
    assert np.sqrt(np.mean(off**2)) < 1.5
