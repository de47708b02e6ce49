"""Proof of single changes: significant over all candidates together, with a gain on unseen blocks that is worth it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from haptid.advice.columns import ELASTIC
from haptid.advice.search import LARGE_GAIN, Proven, Trials, TriedChange, large_enough
from haptid.advice.trial import Bench, Gain, Trial, gain
from haptid.inference.diagnosis.finding import SIGNIFICANCE
from haptid.inference.diagnosis.lack_of_fit import friction_coordinates

# Largest sizes that are believed: s, rad, m.
LARGEST_CHANGE = {"time shift": 0.1, "zero offset": 0.6, "gravity direction": 0.6, "length": 0.3}
# Terms whose parameters are not negative, as friction takes energy: one below zero has another cause, such as a delay.
_NOT_NEGATIVE = ("coulomb", "viscous", "stribeck", "presliding", "load friction", "rotor inertia", ELASTIC)
# Factors between torque and model that cannot be distinguished from 1, on either side.
SAME = 0.03
# Friction that rises to the Coulomb friction with speed: the column of Stribeck friction with a parameter below zero.
DEGRESSIVE = "degressive friction"


def proven(search: Trials, before: Trial | None = None) -> list[Proven]:
    """All candidates whose proof holds."""
    base = before or search.base()
    singles: dict[str, list[_Member]] = {}
    tests = len(search.candidates)
    for one in search.candidates:
        trial = search.bench.run(one.setting)
        made = gain(base, trial)
        # What is alone and too small is no action, significant or not; the test may need the log simulated.
        worth = large_enough(made) if _is_alone(one) else made.share > made.se
        if not worth:
            continue
        one = _by_its_sign(search, one, trial)
        if _matters(one, trial) and _significant(search.bench, trial, made, SIGNIFICANCE / tests / one.looked_at):
            singles.setdefault(_group(one), []).append((one, trial, made))
    found = []
    for members in singles.values():
        merged, trial, made = max(_together(search, base, members), key=lambda each: each[2].share, default=members[0])
        if large_enough(made):
            found.append(Proven(merged, trial, made))
    return found


_Member = tuple[TriedChange, Trial, Gain]


def _together(search: Trials, base: Trial, members: Sequence[_Member]) -> Iterator[_Member]:
    """Candidates of one kind as one action, whose gain is large enough: of the surest motor, the two surest, ..., all.

    A motor that helps little, and differently from block to block, would hide what is proven on the others.
    """
    surest = sorted(members, key=lambda each: each[2].share / each[2].se if each[2].se else np.inf, reverse=True)
    for count in range(1, len(members) + 1):
        some = [each for each in members if each in surest[:count]]
        merged = _merged([one for one, _, _ in some])
        trial = some[0][1] if count == 1 else search.bench.run(merged.setting)
        made = some[0][2] if count == 1 else gain(base, trial)
        if large_enough(made):
            yield merged, trial, made


def _by_its_sign(search: Trials, one: TriedChange, trial: Trial) -> TriedChange:
    """Stribeck friction whose parameter is negative is friction that is less, not more, in slow motion.

    Lubricated gears have it: Coulomb friction that is reached at some speed only. It needs Coulomb friction to be part
    of, which is not negative at standstill.
    """
    if one.kind != "stribeck" or len(one.indices) != 1 or trial.whole.theta[-1] >= 0:
        return one
    model = search.model
    weights = np.abs(friction_coordinates(model, list(model.known_rows))[one.indices[0]].weights)
    dry = dict(zip(model.base.names, search.bench.base_parameters(trial), strict=True))
    own = (t.name for t in model.terms if t.kind == "coulomb" and np.array_equal(np.abs(t.weights), weights))
    at_standstill = sum(dry.get(name, 0.0) for name in own) + float(trial.whole.theta[-1])
    return replace(one, kind=DEGRESSIVE) if at_standstill > 0 else one


def _significant(bench: Bench, trial: Trial, made: Gain, limit: float) -> bool:
    """Whether a candidate is significant, by its gain or, where it adds columns, by their parameters.

    The gain compares two fits, and one with a column that does nothing may have erred less by chance, on all unseen
    blocks alike: their scatter does not show it. No such column explains a quarter of the error; one whose parameters
    are of few blocks, as what gets warm at the start of a log, does, and has few degrees of freedom.
    """
    by_gain = made.p < limit and (made.share > LARGE_GAIN or not trial.setting.terms)
    return by_gain or (bool(trial.setting.terms) and bench.p_value(trial, limit) < limit)


def _matters(one: TriedChange, trial: Trial) -> bool:
    """Whether a factor is another than 1, and a parameter, an offset, a length or a shift one that can be."""
    if one.kind in _NOT_NEGATIVE and trial.whole.theta[-1] < 0:
        return False
    most = min(LARGEST_CHANGE.get(one.kind, np.inf), one.geometry.most if one.geometry else np.inf)
    if one.setting.terms and np.isfinite(most) and np.abs(trial.whole.theta[-1]) > most:
        return False
    return not one.setting.free or abs(float(trial.whole.factors[one.setting.free[0]]) - 1.0) > SAME


def _group(one: TriedChange) -> str:
    """Candidates that are one action together."""
    return f"{one.kind} {one.places}" if _is_alone(one) else one.kind


def _is_alone(one: TriedChange) -> bool:
    """Whether a candidate is an action by itself, at every place."""
    alone = ("gain", "length", "payload", "zero offset")
    return bool(one.seconds) or one.kind in alone or one.kind.endswith(("swap", "sign"))


def _merged(members: Sequence[TriedChange]) -> TriedChange:
    """One candidate of one kind on several motors."""
    if len(members) == 1:
        return members[0]
    setting = members[0].setting
    for one in members[1:]:
        setting = setting.plus(one.setting)
    return TriedChange(
        members[0].kind,
        tuple(place for one in members for place in one.places),
        setting,
        tuple(source for one in members for source in one.sources),
        tuple(index for one in members for index in one.indices),
    )
