"""Cross-validation of a study: its logs predicted by models for use from other rows, by the study's scheme."""

from __future__ import annotations

from collections.abc import Sequence

from haptid.dynamics.model import DynamicModel
from haptid.errors import IdentifiabilityError
from haptid.estimation import Estimate, estimate
from haptid.estimation.nonlinear.load_friction import has_nonlinear_constants
from haptid.observation.observation import Observation, concatenated
from haptid.study.study import Study
from haptid.validation.cross_validation import alternate, each_log
from haptid.validation.model_for_use import model_for_use
from haptid.validation.validation import Validation, pooled, validate

# Time blocks in a row that are held out together, as they are tried.
_RUNS = (1, 2, 3)
# Groups of logs whose blocks are held out together, at most: every group takes two fits.
_MOST_GROUPS = 10


def held_out(
    study: Study, model: DynamicModel, observations: Sequence[Observation], references: Sequence[Observation | None]
) -> tuple[tuple[Validation, ...], ...]:
    """Errors of the rows of each log of the fit, predicted from other rows; none where the study holds none out.

    Args:
        study: with the scheme, and the method of these fits.
        model: as its file has it; nonlinear constants and load-dependent friction are estimated again in every fit.
        observations: of each log of the fit.
        references: all rows of each log behind the reference filter; None for no errors on them.
    """
    if study.cross_validation is None:
        return tuple(() for _ in observations)
    by_log = study.cross_validation == "leave-one-log-out"
    size = 1 if by_log else -(-len(observations) // _MOST_GROUPS)
    found: list[Validation] = []
    for first in range(0, len(observations), size):
        group = slice(first, first + size)
        others = [*observations[:first], *observations[first + size :]]
        rows, all_rows = observations[group], references[group]
        if has_nonlinear_constants(model):
            found += _nonlinear(study, model, rows, others, all_rows)
        elif by_log:
            found.append(validate(_usable(study, others), rows[0], all_rows[0]))
        else:
            found += _halves(study, rows, others, all_rows)
    return tuple((one,) for one in found)


def _nonlinear(
    study: Study,
    model: DynamicModel,
    rows: Sequence[Observation],
    others: Sequence[Observation],
    references: Sequence[Observation | None],
) -> Sequence[Validation]:
    motions, used = ([motion for one in several for motion in one.motions] for several in (rows, others))
    behind = [None if one is None else one.motions[0] for one in references]
    if study.cross_validation == "leave-one-log-out":
        return (each_log(model, motions[0], used, study.method, behind[0], study.use),)
    return alternate(model, motions, used, study.method, behind, study.use)


def _halves(
    study: Study,
    rows: Sequence[Observation],
    others: Sequence[Observation],
    references: Sequence[Observation | None],
) -> Sequence[Validation]:
    """Both halves of some logs' time blocks, predicted from the other ones and the other logs.

    Alternate blocks may all have the same part of a periodic motion, as its motion in one direction: longer runs of
    them then alternate.
    """

    def predicted(run: int) -> list[Validation]:
        halves = [one.alternate(run) for one in rows]
        folds = []
        for parity in (0, 1):
            usable = _usable(study, [*(half[parity] for half in halves), *others])
            unseen = [half[1 - parity] for half in halves]
            folds.append([validate(usable, one, own) for one, own in zip(unseen, references, strict=True)])
        return [pooled(*both) for both in zip(*folds, strict=True)]

    for run in _RUNS[:-1]:
        try:
            return predicted(run)
        except IdentifiabilityError:
            continue
    return predicted(_RUNS[-1])


def _usable(study: Study, rows: Sequence[Observation]) -> Estimate:
    """The model for use of some rows, chosen on these rows alone."""
    return model_for_use(estimate(concatenated(rows), study.method), None, study.use).estimate
