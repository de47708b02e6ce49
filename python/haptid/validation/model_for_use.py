"""The model for use: which fit predicts, compensates and is exported, by cross-validation on the rows of the fit.

The unconstrained fit has the nominal coverage, and single parameters are quoted from it. For the torque of other
motions it is often not the best one: where a log excites a direction poorly, or the model misses an effect, its
parameters are those of no body, and its torque is far off as soon as the motion differs. So the model for use is
physically consistent, unless held-out rows say otherwise.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from haptid._internal.arrays import Array, freeze
from haptid._internal.late import dataclass
from haptid.dynamics.model import DynamicModel
from haptid.errors import ConvergenceError, PhysicalConsistencyError
from haptid.estimation import Estimate, Method, estimate
from haptid.estimation.bias import carried, less, may_be_less
from haptid.estimation.feasibility.cone import Cone
from haptid.estimation.feasibility.feasible import nearest_base_parameters, roomy
from haptid.estimation.intervals.cluster_robust import ClusterRobust
from haptid.estimation.intervals.covariance import Limiting
from haptid.estimation.least_squares import EXCITED, unexcited, weakest_direction
from haptid.estimation.method import only_weights_rows
from haptid.estimation.methods.anchored import Anchored, AnchoredConsistent, open_parameters, reference_torque
from haptid.estimation.methods.constrained import FixedAtZero, PhysicallyConsistent
from haptid.estimation.methods.regularised import (
    COARSE,
    ENTROPIC_STRENGTHS,
    RIDGE_STRENGTHS,
    Entropic,
    EntropicPenalty,
    Ridge,
    has_prior,
    prior_links,
    strengthened,
)
from haptid.observation.observation import MotorRows, Observation, stacked
from haptid.observation.r_factor import r_factor
from haptid.validation.validation import of_all_motors

# Folds of the cross-validation: each block is in one, neighbours in different ones. Of few blocks there are fewer
# folds, with two blocks each.
_FOLDS, _IN_FOLD = 5, 2
# Fewer blocks than these are not split.
_FEWEST_BLOCKS = 2 * _IN_FOLD
# Least gain of the error, as a share of it: held-out blocks are of the same motion, and a smaller gain does not
# outweigh what parameters of no body, or a wrong prior, do in another motion (benchmarks/model_for_use.py).
_LEAST_GAIN = 0.02
# Error of the consistent fit, in those of the free one, from which on what is wrong is not the noise.
CLASH = 2.0
CONSISTENT, FREE, RIDGE, ENTROPIC, ANCHORED = "consistent", "free", "ridge", "entropic", "anchored"
# Name of the uncertainty by a bias that cannot be subtracted.
_BIAS = "bias by the treatment"
# Parameters that are named in a sentence; what to record for them, which a note on those not told at all says itself.
_NAMED = 4
_RECORD = " Record motion of these joints, fast and at other poses."
STRENGTHS: Mapping[str, tuple[float | None, ...]] = {
    CONSISTENT: (None,),
    FREE: (None,),
    RIDGE: RIDGE_STRENGTHS[::2],
    ENTROPIC: ENTROPIC_STRENGTHS[2:],
}
NAMES = {
    CONSISTENT: "the physically consistent fit",
    FREE: "the free fit",
    RIDGE: "the fit with the ridge prior",
    ENTROPIC: "the fit with the entropic prior",
}


@dataclass(frozen=True, eq=False)
class UseCandidate:
    """A fit that may be the model for use, with its held-out error.

    Attributes:
        name: "consistent", "free", "ridge" or "entropic".
        strength: of the prior, the best of those tried; None without one.
        error: relative error of all motors on held-out rows, per cent.
        excess: squared relative error less that of the consistent fit, and its standard error over the blocks.
        gain: reduction of the error of the consistent fit, as a share of it.
    """

    name: str
    strength: float | None
    error: float
    excess: tuple[float, float]
    gain: float

    @property
    def is_better(self) -> bool:
        """Whether its held-out error is lower by more than one standard error and by more than 2 %."""
        difference, se = self.excess
        return difference < -se and self.gain > _LEAST_GAIN


@dataclass(frozen=True, eq=False)
class ModelForUse:
    """The fit that predicts, compensates and is exported, and why.

    Attributes:
        name: "consistent", "free", "ridge" or "entropic"; "given" where the estimate has constraints, a prior or a
            method that is not least squares.
        estimate: the fit.
        reason: a sentence with the figures.
        candidates: with their held-out errors; none where there was nothing to choose.
        open: base parameters that the log leaves open; where there are some, the fit has a weak prior on torque, see
            `Anchored`.
    """

    name: str
    estimate: Estimate
    reason: str
    candidates: tuple[UseCandidate, ...] = ()
    open: tuple[str, ...] = ()

    @property
    def beta(self) -> Array:
        """Its base parameters, (p,), SI."""
        return self.estimate.beta

    @property
    def method(self) -> Method:
        """That makes it from other rows."""
        return self.estimate.method


def model_for_use(
    fitted: Estimate, reference: Sequence[Observation] | None = None, wanted: str = "auto"
) -> ModelForUse:
    """The model for use, chosen on the rows of an estimate alone.

    The physically consistent fit is replaced by the free one, or by one with a prior where the device has prior values,
    only if the error on held-out blocks is smaller by more than one standard error of the paired differences, and by
    more than 2 %.
    Strengths of priors are those of least held-out error. An estimate with constraints or a prior of its own, or by
    another method than least squares on weighted rows, is used as it is. Where the rows do not tell some parameters,
    so that the free fit has none of them, all others are those with a weak prior: see `Anchored`.

    Args:
        fitted: the free fit.
        reference: all rows of its logs behind the reference filter, on which errors are compared; its own rows where
            None. They are put together only for a comparison: of many logs they take more memory than all else.
        wanted: "auto", or the name of the fit to use without a comparison.

    """
    if not (only_weights_rows(fitted.method) or _untold(fitted)):
        return ModelForUse("given", fitted, f"The model for use is the estimate itself, by {fitted.method.name}.")
    if wanted == FREE:
        return ModelForUse(FREE, fitted, "The model for use is the free fit, as the study says.")
    try:
        return _chosen(fitted, reference or (fitted.observation,), wanted)
    except (PhysicalConsistencyError, ConvergenceError) as error:
        return ModelForUse(FREE, fitted, f"The model for use is the free fit: no consistent one was found ({error})")


def _chosen(fitted: Estimate, reference: Sequence[Observation], wanted: str) -> ModelForUse:
    """The consistent fit, or one that is better on held-out blocks."""
    untold = left = _untold(fitted)
    if wanted == "auto":
        left = (*left, *(name for name in _open(fitted) if name not in left))
    if left:
        fitted = _made(fitted, ANCHORED, None)
    consistent = _made(fitted, CONSISTENT, None)
    because = _left_open(left, fitted, "" if untold else _RECORD)
    if wanted == CONSISTENT:
        why = f"The model for use is {NAMES[CONSISTENT]}, as the study says."
        return ModelForUse(CONSISTENT, consistent, why + because, open=left)
    has = fitted.model
    priors = [] if left else [RIDGE] * has_prior(has) + [ENTROPIC] * bool(prior_links(has))
    if not consistent.constrained and not priors:
        why = "The free fit is physically consistent: it is the model for use."
        return ModelForUse(CONSISTENT, consistent, why + because, open=left)
    trial = _trial(fitted, reference, (CONSISTENT, FREE, *priors))
    if trial is None:
        why = "the log is too short, or too poorly excited, to compare it with others on held-out rows"
        reason = f"The model for use is {NAMES[CONSISTENT]}: {why}.{because}"
        return ModelForUse(CONSISTENT, consistent, reason, open=left)
    candidates = tuple(trial.candidates())
    best = min(
        (candidate for candidate in candidates if candidate.is_better),
        key=lambda candidate: candidate.error,
        default=candidates[0],
    )
    chosen = consistent if best is candidates[0] else _made(fitted, best.name, best.strength)
    return ModelForUse(best.name, chosen, _reason(best, candidates) + because, candidates, left)


def _untold(fitted: Estimate) -> tuple[str, ...]:
    """Base parameters that the free fit does not have because the rows do not tell them; none of other reduced fits."""
    if isinstance(fitted.method, FixedAtZero) and unexcited(fitted.observation.stack()[:-1, :-1])[0]:
        return fitted.method.names
    return ()


def _open(fitted: Estimate) -> tuple[str, ...]:
    """Base parameters that the log leaves open."""
    if not fitted.fit.unit_residual:
        return ()
    A = reference_torque(fitted.observation)
    return open_parameters(fitted.observation, A, fitted.covariance, fitted.classical_covariance, beta=fitted.free)


def _left_open(left: Sequence[str], fitted: Estimate, advice: str) -> str:
    """What the log does not determine and what was done about it, with advice; empty where it determines all."""
    if not left:
        return ""
    others = f" and {len(left) - _NAMED} more" if len(left) > _NAMED else ""
    held_at = "the device file's bodies" if has_prior(fitted.model) else "zero"
    return (
        f" The log does not determine {', '.join(left[:_NAMED])}{others}: a weak prior keeps the torque of other "
        f"motion near that of {held_at}.{advice}"
    )


def _reason(best: UseCandidate, candidates: Sequence[UseCandidate]) -> str:
    """Why, in one sentence with the figures."""
    if best is candidates[0]:
        others = ", ".join(f"{candidate.error:.3g} % of {NAMES[candidate.name]}" for candidate in candidates[1:])
        return (
            f"The model for use is {NAMES[CONSISTENT]}: its error on held-out blocks is {best.error:.3g} %, against "
            f"{others}, none better by both one standard error of the paired "
            f"differences and 2 %."
        )
    difference, se = best.excess
    clash = (
        " No bodies that can exist move as the log says: look for a torque or position of wrong sign or unit, swapped "
        "channels, axes or lengths of the device file that are not the device's, and missing terms. Until that is "
        "mended, this fit predicts motion like the log's, and no other."
    )
    return (
        f"The model for use is {NAMES[best.name]}: its error on held-out blocks is {best.error:.3g} %, against "
        f"{candidates[0].error:.3g} % of {NAMES[CONSISTENT]}, better by {-difference / se:.2g} standard errors of the "
        f"paired differences.{clash if best.name == FREE and candidates[0].error > CLASH * best.error else ''}"
    )


def _made(fitted: Estimate, name: str, strength: float | None) -> Estimate:
    """A candidate from all rows."""
    if name == FREE:
        return fitted
    method: Method
    if name == ANCHORED:
        method = Anchored(fitted.method.weighting if isinstance(fitted.method, FixedAtZero) else fitted.method)
    elif isinstance(fitted.method, Anchored):
        method = AnchoredConsistent(fitted.method.weighting)
    elif name == RIDGE:
        method = Ridge(strength=strength)
    elif name == ENTROPIC:
        method = Entropic(strength, fitted.method)
    else:
        method = PhysicallyConsistent(fitted.method)
    limited = isinstance(fitted.intervals, Limiting) and name != CONSISTENT
    made = estimate(fitted.observation, method, ClusterRobust() if limited else fitted.intervals)
    bias = carried(made, (fitted.fit.solution.beta - fitted.free)[None])[0]
    if bias.any():  # which the treatment of the log has, and the free fit is without
        made = less(made, bias) if may_be_less(made) else made.with_nuisance(_BIAS, bias[None])
    return made.with_nuisances_of(fitted)


@dataclass(frozen=True, eq=False)
class _Trial:
    """Squared errors of candidates on held-out blocks, by fits without the fold that a block is in.

    Attributes:
        best: of each candidate by name, the strength of least error, and its errors, (blocks,): they sum to the squared
            relative error of all motors.
    """

    best: dict[str, tuple[float | None, Array]]

    def candidates(self) -> Iterator[UseCandidate]:
        """Each with its best strength, the consistent fit first."""
        base = self.best[CONSISTENT][1]
        for name, (strength, tried) in self.best.items():
            excess = tried - base
            error, own = (100 * float(np.sqrt(part.sum())) for part in (tried, base))
            gain = 1 - error / own if own else 0.0
            yield UseCandidate(name, strength, error, (float(excess.sum()), se_of_sum(excess)), gain)


def se_of_sum(values: Array) -> float:
    """Standard error of the sum of a series, (n,), robust to its serial correlation.

    Source: Newey and West (1987), Econometrica 55(3); never below that of independent values.
    """
    n, deviations = len(values), values - values.mean()
    lags = min(n - 1, round(n ** (1 / 3)))
    own = float(deviations @ deviations)
    serial = 2 * sum((1 - k / (lags + 1)) * float(deviations[k:] @ deviations[:-k]) for k in range(1, lags + 1))
    return float(np.sqrt((own + max(serial, 0.0)) * n / (n - 1)))


def _trial(fitted: Estimate, reference: Sequence[Observation], names: Sequence[str]) -> _Trial | None:
    """Fits without each fold and their errors on it; None where there are too few blocks to leave some out."""
    rows, model = fitted.fit.observation, fitted.model
    count = len(rows.blocks)
    if count < _FEWEST_BLOCKS:
        return None
    scale = 1.0 if fitted.fit.unit_residual else fitted.fit.solution.rest / np.sqrt(fitted.fit.solution.dof)
    number = min(_FOLDS, count // _IN_FOLD)
    fold_of = np.arange(count) % number
    held = [_folds(rows, fold_of, one) for one in reference]
    motors = _picked(reference, [np.flatnonzero(one >= 0) for one in held])
    held_folds = np.concatenate([one[one >= 0] for one in held])
    factors = of_all_motors(np.array([motor.norm**2 for motor in motors]), [motor.unit for motor in motors])
    prior = fitted.method.knowledge(rows).rows if isinstance(fitted.method, Anchored) else None
    folds = []
    for fold in range(number):
        T = rows.pick(np.flatnonzero(fold_of != fold)).stack(fitted.fit.weights / scale)
        if prior is not None:
            T = r_factor(np.concatenate([T, prior]))
        unseen = np.flatnonzero(held_folds == fold)
        if weakest_direction(T[:-1, :-1])[1] < EXCITED or not len(unseen):
            return None
        folds.append(_Fold(model, T, unseen))
    back = np.argsort(np.concatenate([fold.unseen for fold in folds]))
    least = [_least(factors, motors, fold.unseen, len(rows.base)) for fold in folds]

    def best(name: str) -> tuple[float | None, Array]:
        """The strength of least error, and its squared errors, (blocks,); others are left as soon as they have more."""
        found: tuple[float | None, Array] | None = None
        lowest = np.inf
        for strength in STRENGTHS[name]:
            parts: list[Array] = []
            for k, fold in enumerate(folds):
                parts.append(_squares(factors, motors, fold.unseen, fold.fit(name, strength)))
                total = sum(float(part.sum()) for part in parts)
                if found is not None and total + sum(least[k + 1 :]) >= lowest:
                    break
            else:
                found, lowest = (strength, np.concatenate(parts)[back]), total
        assert found is not None
        return found

    made = {}
    for name in names:
        try:
            made[name] = best(name)
        except ConvergenceError:  # such a fit is no candidate
            if name == CONSISTENT:
                raise
    return _Trial(made)


def _picked(observations: Sequence[Observation], blocks: Sequence[np.ndarray]) -> list[MotorRows]:
    """Rows of each motor in some blocks of several observations; they are copied once, motor by motor."""
    return [
        replace(
            own[0],
            r_factors=freeze(np.concatenate([motor.r_factors[k] for motor, k in zip(own, blocks, strict=True)])),
            rows=np.concatenate([motor.rows[k] for motor, k in zip(own, blocks, strict=True)]),
        )
        for own in zip(*(one.motors for one in observations), strict=True)
    ]


def _folds(rows: Observation, fold_of: np.ndarray, reference: Observation) -> np.ndarray:
    """The fold of the block of rows that holds the middle of each reference block; -1 where there is none."""
    found = np.full(len(reference.blocks), -1)
    by_log: dict[str, list[int]] = {}
    for k, block in enumerate(rows.blocks):
        by_log.setdefault(block.log, []).append(k)
    for k, block in enumerate(reference.blocks):
        middle = 0.5 * (block.start + block.stop)
        for own in by_log.get(block.log, ()):
            if rows.blocks[own].start <= middle < rows.blocks[own].stop:
                found[k] = fold_of[own]
    return found


def _squares(factors: Array, motors: Sequence[MotorRows], blocks: np.ndarray, beta: Array) -> Array:
    """Squared errors of base parameters, (p,), block by block, (blocks,).

    Args:
        factors: of the motors' squared residuals, as of `of_all_motors`.
    """
    total = np.zeros(len(blocks))
    for factor, motor in zip(factors, motors, strict=True):
        e = motor.r_factors[blocks] @ np.append(-beta[motor.columns], 1.0)
        total += factor * np.einsum("bi,bi->b", e, e)
    return total


def _least(factors: Array, motors: Sequence[MotorRows], blocks: np.ndarray, count: int) -> float:
    """The least that squared errors of any base parameters, (count,), add up to in some blocks."""
    return float(r_factor(stacked([motor.pick(blocks) for motor in motors], np.sqrt(factors), count))[-1, -1] ** 2)


@dataclass(frozen=True, eq=False)
class _Fold:
    """The rows that are fitted where one fold is held out.

    Attributes:
        T: their R factor, of unit noise, (p + 1, p + 1).
        unseen: blocks of the reference rows in the fold.
    """

    model: DynamicModel
    T: Array
    unseen: np.ndarray

    @property
    def _R(self) -> Array:
        return self.T[:-1, :-1]

    @cached_property
    def _free(self) -> Array:
        return np.asarray(np.linalg.lstsq(self._R, self.T[:-1, -1], rcond=None)[0])

    @cached_property
    def _cone(self) -> Cone:
        return roomy(self.model, self._free)

    @cached_property
    def _penalty(self) -> EntropicPenalty:
        return EntropicPenalty.of(self.model, self._cone)

    def fit(self, name: str, strength: float | None) -> Array:
        """Base parameters of a candidate, (p,), SI."""
        if name == FREE:
            return self._free
        if name == CONSISTENT:
            return nearest_base_parameters(self._cone, self._free, self._R)
        assert strength is not None
        if name == RIDGE:
            known = strengthened(Ridge().prior(self.model), strength).rows
            own = r_factor(np.concatenate([self.T, known]))
            return np.asarray(np.linalg.lstsq(own[:-1, :-1], own[:-1, -1], rcond=None)[0])
        return np.asarray(self._cone.A @ self._penalty.minimiser(self._R, self.T[:-1, -1], strength, COARSE))
