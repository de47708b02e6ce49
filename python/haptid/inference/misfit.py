"""Errors of the model in a comparison: how far the parameters would move if significant missing terms were added.

A term that the model lacks is absorbed by the others, differently along every motion, so two logs of one device then
differ by more than noise. The terms that the diagnosis tests on every friction coordinate are tested here too; the
shift of the parameters by the most significant one of each coordinate counts as one standard error in a comparison.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from haptid._internal.arrays import Array
from haptid.estimation import Estimate
from haptid.estimation.intervals.clusters import Clusters
from haptid.estimation.method import PointEstimate
from haptid.inference.diagnosis.added_variable import augment, device_rows
from haptid.inference.diagnosis.finding import SIGNIFICANCE
from haptid.inference.diagnosis.lack_of_fit import (
    CANDIDATES,
    TermTest,
    columns_at,
    friction_coordinates,
    known_term_tests,
    term_tests,
)
from haptid.inference.diagnosis.residuals import residuals
from haptid.inference.diagnosis.subsample import subsample
from haptid.observation.augmented import CandidateColumns
from haptid.uncertainty.multiple_testing import holm_adjusted

# Share of the measured torque below which a residual is rounding and is not tested.
_EXACT = 1e-6


def clusters_with_misfit(estimate: Estimate) -> Clusters:
    """Scores of the time blocks of an estimate, with the shifts by terms that its model lacks.

    Args:
        estimate: whose observation holds the motions.

    Raises:
        HaptidError: as `observe` does where a motion no longer fits the device.
    """
    return replace(estimate.clusters, misfit_shifts=_shifts(estimate))


def _shifts(estimate: Estimate) -> Array:
    """Change of the base parameters by the most significant missing term of each friction coordinate, (n, p), SI."""
    p, none = len(estimate.beta), np.zeros((0, len(estimate.beta)))
    small = [m.residual(estimate.beta) <= _EXACT * m.size(estimate.beta) for m in estimate.observation.motors]
    if all(small) or isinstance(estimate.method, PointEstimate):
        return none
    part = subsample(estimate)
    tests = known_term_tests(part) or _tested(part)
    significant = dict(
        zip(tests, holm_adjusted(np.array([test.p for test in tests.values()])) < SIGNIFICANCE, strict=True)
    )
    reached = np.unique(np.concatenate([own.columns for own in part.observation.motors]))
    fitted = [k for k in reached if k not in estimate.zero]
    shifts = []
    for place in sorted({k for _, k in tests}):
        own = [test for key, test in tests.items() if key[1] == place and significant[key] and test.fit is not None]
        if own:
            shift, best = np.zeros(p), min(own, key=lambda test: test.p)
            assert best.fit is not None
            shift[fitted] = best.fit.shift
            shifts.append(shift)
    return np.array(shifts) if shifts else none


def _tested(estimate: Estimate) -> Mapping[tuple[str, int], TermTest]:
    """Tests of every term at every friction coordinate."""
    left = residuals(estimate)
    candidates: list[CandidateColumns] = []
    index_of = {}
    for k, place in enumerate(friction_coordinates(estimate.model, device_rows(estimate))):
        for term in CANDIDATES:
            columns = columns_at(term, place, left)
            index_of[term.name, k] = range(len(candidates), len(candidates) + len(columns))
            candidates += columns
    return term_tests(augment(estimate, candidates), index_of)
