"""What is proven on some rows: those of the log, or of the log with its torques shifted in time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.advice.bodies import Impossible, impossible, inertias_below_zero
from haptid.advice.coarse import with_coarse_torques
from haptid.advice.delays import with_delays, with_shift
from haptid.advice.positions import positions
from haptid.advice.proof import proven
from haptid.advice.ranking import in_order, of_possible_bodies, stated
from haptid.advice.reversed_motors import reversed_motors, without_complements
from haptid.advice.search import LARGE_GAIN, Proven, Trials, search_of, unseen_percent, with_masks
from haptid.advice.spoiled import spoiled_parts
from haptid.advice.trial import Trial
from haptid.dynamics.model import DynamicModel
from haptid.errors import HaptidError
from haptid.estimation import Estimate
from haptid.motion.motion import Motion

# Unseen error, per cent, from which signs and assignments of the positions are tried: each is a pass over the log.
# The lower one where parameters are found that no bodies have, of which signs are tried in any case, and for sides.
ROUGH_ERROR, LARGE_ERROR = 20.0, 10.0
# Share of the error that a shift of torques leaves at most where all else is tried behind it.
_BEHIND = 0.5
# A factor that is -1 within this is a sign.
_SIGN = 0.3


@dataclass(frozen=True, eq=False)
class Sought:
    """Changes that are proven on some rows.

    Attributes:
        whole, search: rows and candidates, without and with what masks leave out.
        masks: rows left out.
        base: the trial without changes.
        made: what is proven, in order.
        signs: groups of motors whose torque is reversed by what is negative of them.
    """

    whole: Trials
    search: Trials
    masks: list[Proven]
    base: Trial
    made: list[Proven]
    signs: list[tuple[Impossible, ...]]

    @property
    def before(self) -> float:
        """Unseen error without changes, per cent."""
        return self.error(self.base)

    def error(self, trial: Trial) -> float:
        """Unseen error of a trial, per cent."""
        return unseen_percent(self.search.model, self.search.bench, trial)

    def impossible(self, trial: Trial) -> bool:
        """Whether a motor has a negative inertia by a trial."""
        below = inertias_below_zero(self.search.model, self.search.rows)
        return below(self.search.bench.base_parameters(trial)) > 0

    @property
    def late(self) -> Proven | None:
        """The shift of torques that is the best change, where it leaves little of the error."""
        first = self.made[0] if self.made else None
        if first is None or not first.candidate.seconds or self.error(first.trial) > _BEHIND * self.before:
            return None
        return first


def sought(
    model: DynamicModel, part: Estimate, motions: Sequence[Motion], beta: Array, given: bool, changed: bool
) -> Sought:
    """Try all changes on motions.

    Args:
        model: of the motions.
        part: an estimate on them, or on others of the same logs.
        motions: treated signals of the fit.
        beta: base parameters from which candidates are computed, (p,).
        given: whether the study gives their delays, so that shifts are tried whatever the rows were.
        changed: whether their treatment is another than the one that was chosen.

    Raises:
        HaptidError: no rows are left.
    """
    whole = replace(search_of(model, motions, beta, part.zero), spoiled=tuple(spoiled_parts(part)))
    search, masks = with_masks(whole)
    search = with_coarse_torques(search)
    base = search.base()
    error = unseen_percent(model, search.bench, base)
    negative = list(impossible(part, search.rows))
    if negative or error > ROUGH_ERROR:
        search = replace(search, candidates=(*search.candidates, *positions(search, signs_only=error <= LARGE_ERROR)))
    if (changed or masks) and not given:  # the delays were of another filter, or of bad rows
        search = replace(search, candidates=tuple(one for one in search.candidates if one.kind != "time shift"))
    else:
        search = with_delays(search)
    made = in_order([(_named(one), stated(search, base, one.trial)) for one in proven(search, base)])
    signs = reversed_motors(search, base, negative)
    made = without_complements(search, signs, made)
    made = of_possible_bodies(made, search.bench, inertias_below_zero(model, search.rows))
    if changed or masks:  # small gains may be those of the treatment, which was chosen with them
        made = [one for one in made if one.gain.share > LARGE_GAIN]
    return Sought(whole, search, masks, base, made, signs)


def behind(first: Sought, part: Estimate, motions: Sequence[Motion]) -> Sought:
    """What is proven on motions whose torques are shifted as the best change has them; as it is without one.

    Else all that remains hides behind the error of the shift, and is found only once that is corrected.
    """
    late = first.late
    if late is None:
        return first
    beta = first.search.bench.base_parameters(late.trial)
    try:
        return sought(
            first.search.model, part, with_shift(first.search, motions, late.candidate), beta, given=False, changed=True
        )
    except HaptidError:
        return first


def _named(one: Proven) -> Proven:
    """With the kind that a gain really is, and the sizes of what was found."""
    candidate, fitted = one.candidate, one.trial.whole
    at = {int(c): k for k, c in enumerate(fitted.columns)}
    values, settings = [], []
    for term, choice, source in zip(one.trial.setting.terms, fitted.chosen, candidate.sources, strict=False):
        values.append(np.array([fitted.theta[at[c]] for c in term[choice]]))
        settings.append(source.settings[choice] if choice < len(source.settings) else {})
        if candidate.kind == "spring":
            stiffness, *offset = values[-1].tolist()
            settings[-1] = {"rest": settings[-1]["middle"] - sum(offset) / stiffness}
    if candidate.kind == "gain":
        factor = float(fitted.factors[candidate.indices[0]])
        kind = "torque sign" if abs(factor + 1) < _SIGN else "gain"
        candidate = replace(candidate, kind=kind)
    return Proven(candidate, one.trial, one.gain, tuple(values), tuple(settings))
