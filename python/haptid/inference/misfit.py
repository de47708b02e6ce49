"""Errors of the model in a comparison: how far the parameters would move if significant missing terms were added.

A term that the model lacks is absorbed by the others, differently along every motion, so two logs of one device then
differ by more than noise. The terms that the diagnosis tests on every friction coordinate are tested here too; the
shift of the parameters by the most significant one of each coordinate counts as one standard error in a comparison.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from haptid._internal.arrays import Array
from haptid.estimation import Estimate
from haptid.estimation.intervals.clusters import Clusters
from haptid.estimation.method import PointEstimate
from haptid.inference.diagnosis.added_variable import augment, device_rows
from haptid.inference.diagnosis.finding import SIGNIFICANCE
from haptid.inference.diagnosis.lack_of_fit import CANDIDATES, best_alternative, columns_at, friction_coordinates
from haptid.inference.diagnosis.residuals import residuals
from haptid.inference.diagnosis.subsample import subsample
from haptid.observation.augmented import CandidateColumns
from haptid.uncertainty.multiple_testing import together

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
    small = [m.residual(estimate.beta) <= _EXACT * m.norm for m in estimate.observation.motors]
    if all(small) or isinstance(estimate.method, PointEstimate):
        return none
    part = subsample(estimate)
    left, places = residuals(part), friction_coordinates(part.model, device_rows(part))
    candidates: list[CandidateColumns] = []
    groups = []
    for k, place in enumerate(places):
        for term in CANDIDATES:
            columns = columns_at(term, place, left)
            groups.append((k, range(len(candidates), len(candidates) + len(columns))))
            candidates += columns
    augmented = augment(part, candidates)
    tests = [best_alternative(augmented, which) for _, which in groups]
    significant = together(np.array([test.p for test in tests])) < SIGNIFICANCE
    reached = np.unique(np.concatenate([own.columns for own in augmented.observation.motors]))
    fitted = [k for k in reached if k < p and k not in estimate.zero]
    made = []
    for k in range(len(places)):
        own = [
            test
            for (place, _), test, seen in zip(groups, tests, significant, strict=True)
            if place == k and seen and test.fit is not None
        ]
        if own:
            shift, best = np.zeros(p), min(own, key=lambda test: test.p)
            assert best.fit is not None
            shift[fitted] = best.fit.shift
            made.append(shift)
    return np.array(made) if made else none
