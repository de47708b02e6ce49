"""`compare(...)`: which parameters of two or more independent estimates differ, by Welch's test with Holm's correction.

Sources: Welch (1947), Biometrika 34, eq. (28); Welch (1951), Biometrika 38, eq. (20); Holm (1979), Scandinavian Journal
of Statistics 6.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import overload

import numpy as np

from haptid.errors import SettingError, SharedRowsError
from haptid.estimation import Estimate
from haptid.estimation.intervals.clusters import Clusters
from haptid.estimation.intervals.covariance import with_prior_variance
from haptid.inference.comparison.comparable import Clustered, Comparable, common_parameters
from haptid.inference.comparison.differences import Comparison, Series
from haptid.inference.joint_tests import joint_tests
from haptid.inference.misfit import clusters_with_misfit
from haptid.observation.plan import shared_block
from haptid.uncertainty.quantities import Quantities

# Factor on standard errors, for errors of the model, above which it is reported.
_WIDENED = 1.2


@overload
def compare(
    first: Comparable, second: Comparable, /, *, confidence: float = 0.95, independent: bool = True, joint: bool = True
) -> Comparison: ...


@overload
def compare(
    *estimates: Comparable,
    labels: Sequence[str],
    confidence: float = 0.95,
    independent: bool = True,
    joint: bool = True,
) -> Series: ...


@overload
def compare(
    *estimates: Comparable, confidence: float = 0.95, independent: bool = True, joint: bool = True
) -> Comparison | Series: ...


def compare(
    *estimates: Comparable,
    labels: Sequence[str] | None = None,
    confidence: float = 0.95,
    independent: bool = True,
    joint: bool = True,
) -> Comparison | Series:
    """Which parameters of two or more estimates differ: mountings of a device, tools, days, devices of a series.

    Parameters are the same where name and unit agree; base parameters also need the same regrouping. A parameter that
    not every estimate has is left out, and a note names it.

    Args:
        estimates: two or more: base parameters, targets or results, from logs or time ranges without common rows; the
            devices may differ.
        labels: one for each; "1", "2", ... where None.
        confidence: family-wise confidence level over all parameters, between 0 and 1.
        independent: whether common rows are an error; if not, they are noted.
        joint: whether groups of directions are tested too, and errors of the model widen the standard errors.

    Returns:
        A `Comparison` of two estimates without labels, otherwise a `Series`.

    Raises:
        SettingError: the confidence is not between 0 and 1; there are fewer than two estimates; not one different label
            for each.
        SharedRowsError: two were made from the same rows.
        ModelMismatchError: they have no parameter in common.
    """
    _check_settings(estimates, confidence)
    pair = ("the first estimate", "the second estimate") if len(estimates) == 2 and labels is None else None
    called = _labels(estimates, labels or pair)
    shared = _shared_rows(estimates, independent)
    names = common_parameters(estimates)
    free = [estimate.unconstrained for estimate in estimates]
    picked = [quantities.pick([quantities.names.index(name) for name in names]) for quantities in free]
    notes = list(_notes(estimates, called, names))
    scores = [_scores(estimate) if joint else None for estimate in estimates]
    widened = [_with_misfit(*own) for own in zip(free, scores, picked, strict=True)]
    for label, before, after in zip(called, picked, widened, strict=True):
        notes += _misfit_note(label, before, after)
    known = [own for own in scores if own is not None] if _comparable(estimates, scores, names) else []
    tests = None
    if known:
        first = estimates[0]
        assert isinstance(first, Clustered)
        tests = joint_tests(first.model, [quantities.values for quantities in free], known, confidence)
    if shared:
        notes.append("Some were made from the same rows: their errors are not independent, and the test is not valid.")
    series = Series(
        labels=called,
        names=names,
        units=picked[0].units,
        value=np.array([quantities.values for quantities in widened]),
        se=np.array([quantities.se for quantities in widened]),
        dof=np.array([quantities.dof for quantities in widened]),
        covariance=np.array([quantities.covariance for quantities in widened]),
        confidence=confidence,
        notes=tuple(notes),
        joint=tests,
    )
    return series.pair(*pair) if pair else series


def _check_settings(estimates: Sequence[Comparable], confidence: float) -> None:
    """Raise SettingError for a confidence that is none, or for fewer than two estimates."""
    if not 0 < confidence < 1:
        raise SettingError(
            f"confidence is {confidence!r}.",
            where="confidence",
            found=confidence,
            limit=(0, 1),
            advice="Write a number between 0 and 1, such as 0.95.",
        )
    if len(estimates) < 2:
        raise SettingError(
            f"{len(estimates)} estimates cannot be compared; give 2 or more.",
            where="estimates",
            found=len(estimates),
            limit=2,
        )


def _labels(estimates: Sequence[Comparable], labels: Sequence[str] | None) -> tuple[str, ...]:
    """A different label for each estimate: those given, or their numbers.

    Raises:
        SettingError: those given are not one for each.
    """
    called = tuple(labels or (str(k + 1) for k in range(len(estimates))))
    if len(called) != len(estimates) or len(set(called)) != len(called):
        raise SettingError(
            f"{len(set(called))} different labels are given for {len(estimates)} estimates, {list(called)!r}; give one "
            "for each.",
            where="labels",
            found=len(set(called)),
            limit=len(estimates),
        )
    return called


def _shared_rows(estimates: Sequence[Comparable], independent: bool) -> bool:
    """Whether two estimates were made from the same rows.

    Raises:
        SharedRowsError: they were, and have to be independent.
    """
    block = shared_block(estimate.blocks for estimate in estimates)
    if block is not None and independent:
        raise SharedRowsError(
            f"both estimates were made from the rows from {block.start:.3f} to {block.stop:.3f} s of log "
            f"{block.log[:12]}, so the standard error of their difference is not known.",
            where=(block.log, block.start),
            advice="Compare estimates from logs, or time ranges, without common rows.",
        )
    return block is not None


def _scores(estimate: Comparable) -> Clusters | None:
    """Scores of the time blocks with the shifts by missing terms, if they are known."""
    if isinstance(estimate, Estimate):
        return clusters_with_misfit(estimate)
    return estimate.clusters if isinstance(estimate, Clustered) else None


def _with_misfit(every: Quantities, scores: Clusters | None, picked: Quantities) -> Quantities:
    """Parameters with the covariance that errors of the model add.

    Args:
        every: all base parameters of the estimate.
        scores: of its time blocks.
        picked: those compared.
    """
    if scores is None:
        return picked
    shifts = scores.misfit_shifts[:, [every.names.index(name) for name in picked.names]]
    covariance, own = scores.misfit * picked.covariance, np.eye(len(picked))
    covariance, dof = with_prior_variance(covariance, picked.dof, own, shifts if len(shifts) else None)
    return replace(picked, covariance=covariance, dof=dof)


def _misfit_note(label: str, before: Quantities, after: Quantities) -> Iterator[str]:
    """A sentence on how much errors of the model widen the standard errors, and of which parameters most."""
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.nan_to_num(after.se / before.se, nan=1.0, posinf=1.0)
    if ratio.max(initial=1.0) > _WIDENED:
        most = [after.names[k] for k in np.argsort(-ratio)[:3] if ratio[k] > _WIDENED]
        yield (
            f"Errors of the model count as uncertainty of {label}: its standard errors are up to {ratio.max():.2g} "
            f"times those of noise, most of {', '.join(most)}. The diagnosis names the missing terms."
        )


def _comparable(estimates: Sequence[Comparable], scores: Sequence[Clusters | None], names: tuple[str, ...]) -> bool:
    """Whether all have scores and the same base parameters, each of them excited in more than one block."""
    comparable = all(
        estimate.unconstrained.names == names and not estimate.unconstrained.unbounded for estimate in estimates
    )
    return comparable and all(own is not None and own.root.any(axis=1).all() for own in scores)


def _notes(estimates: Sequence[Comparable], labels: Sequence[str], names: tuple[str, ...]) -> Iterator[str]:
    """What could not be compared, and which standard errors cannot be estimated."""
    alone = dict.fromkeys(name for estimate in estimates for name in estimate.unconstrained.names if name not in names)
    if alone:
        yield f"Not compared (not in all with one unit and meaning): {', '.join(alone)}."
    for estimate, label in zip(estimates, labels, strict=True):
        if estimate.constrained:
            yield f"Constraints are active in {label}: its unconstrained fit is compared."
        unbounded = [estimate.unconstrained.names[k] for k in estimate.unconstrained.unbounded]
        if shown := [name for name in names if name in unbounded]:
            yield (
                f"{', '.join(shown)} excited in a single time block of {label}: the standard error cannot be "
                f"estimated, and no difference can be significant."
            )
