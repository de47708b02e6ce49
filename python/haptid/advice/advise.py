"""`advise(identification)`: what to change, each action carried out on the data first, sorted by its gain."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from haptid._internal.arrays import Array
from haptid.advice.bodies import Impossible, impossible
from haptid.advice.edits import Edit, edits_of
from haptid.advice.search import (
    LEAST_GAIN,
    LEAST_SE,
    Proven,
    Trials,
    TriedChange,
    positions,
    proven,
    search_of,
    with_masks,
)
from haptid.advice.trial import Gain, Setting, Trial, gain
from haptid.errors import HaptidError
from haptid.inference.diagnosis import Diagnosis
from haptid.inference.diagnosis.finding import joined_names
from haptid.inference.diagnosis.subsample import subsample
from haptid.study.identify import Identification

Proof = Literal["unseen error", "possible bodies", "prior bodies"]
# Unseen error, per cent, from which signs and assignments of the positions are tried: each is a pass over the log.
# The lower one where parameters are found that no bodies have.
_ROUGH, _LARGE = 20.0, 10.0
# Unseen error, per cent, below which nothing needs to be said of what remains.
CLOSE = 5.0
# Actions of a combination, and actions that are shown.
_MOST, SHOWN = 4, 6
# A factor that is -1 within this is a sign.
_SIGN = 0.3
# Share of a column's length that the model's own columns must leave, and change of the error by a factor of 1.5, for a
# candidate to be told at all.
_TOLD = 1e-4
# Kinds that leave rows out.
MASKS = ("dead torque", "stuck position", "contact")
_CHANGE: Mapping[str, str] = {
    "coulomb": "add Coulomb friction on {where}",
    "viscous": "add viscous friction on {where}",
    "offset": "add a constant torque (direction-dependent dry friction, or an amplifier's offset) on {where}",
    "viscosity by direction": "let viscous friction depend on the direction on {where}",
    "bent viscosity": "add friction that grows with the square of the speed on {where}",
    "stribeck": "add Stribeck friction on {where}",
    "spring": "add a spring on {where}",
    "torque by position": "add a torque that depends on the position of {where}",
    "load friction": "add load-dependent dry friction on {where}",
    "rotor inertia": "add the rotor's inertia on {where}",
    "ripple": "add a torque periodic in the position of {where}",
    "time shift": "shift the torque channel of {where} in time",
    "drift": "the friction or offset of {where} drifts with time: split the log, or record at one temperature",
    "payload": "a payload is on {where} for part of the log: split the log, and estimate it with `haptid payload`",
    "gain": "correct the gain of the torque channel of {where}",
    "torque sign": "reverse the torque channel of {where}",
    "unit": "correct the unit of the torque channel of {where}",
    "torque swap": "exchange the torque channels of {where}",
    "position sign": "reverse the position channel of {where}",
    "position swap": "exchange the position channels of {where}",
    "zero offset": "correct the zero of the position of {where}",
    "length": "correct {where} in the device file",
    "gravity direction": "correct the direction of gravity in the device file",
    "dead torque": "leave out the torque channel of {where}, which is dead: check its wiring, and record again",
    "coarse torque": "record the torque of {where} with a finer resolution",
    "clipped torque": "leave out the parts in which the torque of {where} is clipped",
    "stuck position": "leave out the parts in which the position of {where} is stuck",
    "contact": "leave out the parts in which something touches {where}",
}


@dataclass(frozen=True)
class Action:
    """A change that was carried out on the data.

    Attributes:
        kind: such as "stribeck".
        places: where.
        change: what to do, and by how much.
        proof: kind of the proof.
        before, after: error of torque on unseen rows, per cent; for "possible bodies" the distance of the parameters
            from bodies that can exist, in standard errors; for "prior bodies" the ratio of the torque to theirs.
        se: paired standard error of before - after, None where the error is not the proof.
        share: of the weighted squared unseen error that goes away.
        adds: whether it belongs to the best combination.
        edits: of study and device file; empty where files cannot say it.
    """

    kind: str
    places: tuple[str, ...]
    change: str
    proof: Proof
    before: float
    after: float
    se: float | None
    share: float
    adds: bool
    edits: tuple[Edit, ...]

    @property
    def sentence(self) -> str:
        """The change and its proof."""
        change = self.change[0].upper() + self.change[1:]
        if self.kind in MASKS:
            rows = f"{self.before:.3g} % of all rows, {self.after:.3g} % of the others without them"
            return f"{change}: the error on unseen blocks is {rows}."
        if self.proof == "unseen error":
            size = f"{self.before:.3g} to {self.after:.3g} % (paired standard error {self.se:.2g})"
            return f"{change}: the error on unseen blocks falls from {size}."
        if self.proof == "possible bodies":
            return f"{change} negative: without it they are {self.before:.3g} standard errors below zero or more."
        return f"{change}: the torque is {self.before:.3g} times that of the prior bodies, and then {self.after:.3g}."

    def to_dict(self) -> dict[str, Any]:
        """As JSON values."""
        return {
            "kind": self.kind,
            "places": list(self.places),
            "change": self.change,
            "proof": self.proof,
            "before": self.before,
            "after": self.after,
            "se": self.se,
            "share": self.share,
            "adds": self.adds,
            "sentence": self.sentence,
            "edits": [edit.to_dict() for edit in self.edits],
        }


@dataclass(frozen=True)
class Advice:
    """Actions by their gain, and what the log cannot tell.

    Attributes:
        actions: those with proof, sorted.
        before, after: unseen error without changes and with the best combination, per cent, on the same rows.
        untold: sentences on what cannot be told from this log.
        tried: number of candidates.
    """

    actions: tuple[Action, ...]
    before: float
    after: float
    untold: tuple[str, ...]
    tried: int

    @property
    def combination(self) -> tuple[Action, ...]:
        """The actions of the best combination, in the order in which they were added."""
        return tuple(action for action in self.actions if action.adds)

    @property
    def edits(self) -> tuple[Edit, ...]:
        """Edits of the best combination."""
        return tuple(edit for action in self.combination for edit in action.edits)

    @property
    def sentences(self) -> tuple[str, ...]:
        """The first actions, then what cannot be told."""
        shown = [
            f"{k}. {action.sentence}{'' if action.adds else ' Not in addition to the others.'}"
            for k, action in enumerate(self.actions[:SHOWN], 1)
        ]
        if len(self.combination) > 1:
            shown.append(
                f"Together ({joined_names([a.kind for a in self.combination])}): unseen error {self.before:.3g} to "
                f"{self.after:.3g} %."
            )
        return (*shown, *self.untold)

    def to_dict(self) -> dict[str, Any]:
        """As JSON values."""
        return {
            "tried": self.tried,
            "unseen_error_percent": self.before,
            "combined_error_percent": self.after,
            "actions": [action.to_dict() for action in self.actions],
            "untold": list(self.untold),
        }


def advise(found: Identification, diagnosis: Diagnosis | None = None) -> Advice:
    """Try every change that haptid knows on the rows of an identification, and keep those with a proof.

    Fits on every other time block are judged on the blocks between; a change is proposed where its test is significant
    at 0.01 over all candidates together and its gain is more than three standard errors of paired block differences.
    Where a change would only rescale parameters, the proof is by bodies that can exist, or by the device file's prior
    bodies. Nothing is changed.

    Args:
        found: a study carried out.
        diagnosis: of its estimate, whose comparison with prior bodies is used; not compared where None.
    """
    part = subsample(found.estimate)
    motions = part.observation.motions
    if any(motion.treatment.momentum for motion in motions):
        return Advice((), 0.0, 0.0, ("No action is tried without accelerations.",), 0)
    try:
        search = search_of(found.model, motions, part.beta, part.zero)
    except HaptidError as error:
        return Advice((), 0.0, 0.0, (f"No action could be tried: {error}",), 0)
    search, masks = with_masks(search)
    base = search.base()
    before = _percent(search, base)
    negative = list(impossible(part, search.rows.position))
    if before > (_LARGE if negative else _ROUGH):
        search = replace(search, candidates=(*search.candidates, *positions(search)))
    made = [_named(one) for one in proven(search, base)]
    chosen, after = _combined(search, base, made)
    treatment = found.proposal.treatment
    listed = [_action(search, base, one, one in chosen, edits_of(search, one, treatment)) for one in made]
    listed = [action for action in listed if action.after < action.before]
    for mask in masks:  # the others keep their order
        shown = _mask_action(mask, edits_of(search, mask, treatment))
        listed.insert(sum(action.share > shown.share for action in listed), shown)
    known = {(action.kind, place) for action in listed for place in action.places}
    first = [*_bodies(negative, known)]
    known |= {(action.kind, place) for action in first for place in action.places}
    first += _units(diagnosis, known)
    start = max([before, *(action.before for action in listed if action.proof == "unseen error")])
    return Advice(
        (*first, *listed), start, after, tuple(_untold(search, base, [*first, *listed])), len(search.candidates)
    )


def _percent(search: Trials, trial: Trial) -> float:
    """Unseen relative error of all motors, per cent; the rms of the motors' where their units differ."""
    units = {search.model.device.torque_units[k] for k in search.model.measured_rows}
    left = trial.errors.sum(axis=0) / search.bench.weights**2
    own = search.bench.squares(trial.setting).sum(axis=0)
    if len(units) > 1:
        return float(100 * np.sqrt(np.mean(left / np.maximum(own, np.finfo(float).tiny))))
    return float(100 * np.sqrt(left.sum() / own.sum()))


def _paired(search: Trials, before: Trial, after: Trial) -> float:
    """Standard error of the difference of two unseen errors, per cent: paired by block, by the delta method."""
    w = search.bench.weights**2
    own = search.bench.squares(before.setting).sum()
    difference = ((before.errors - after.errors) / w).sum(axis=1)
    spread = np.sqrt(len(difference)) * difference.std(ddof=1) / own
    both = np.sqrt((before.errors / w).sum() / own) + np.sqrt((after.errors / w).sum() / own)
    return float(100 * spread / max(both, 1e-300))


def _named(one: Proven) -> Proven:
    """With the kind that a gain really is, and the sizes of what was found."""
    candidate, fitted = one.candidate, one.trial.whole
    at = {int(c): k for k, c in enumerate(fitted.columns)}
    values, settings = [], []
    for term, choice, source in zip(one.trial.setting.terms, fitted.chosen, candidate.sources, strict=False):
        values.append(np.array([fitted.theta[at[c]] for c in term[choice]]))
        settings.append(source.settings[choice] if choice < len(source.settings) else {})
    if candidate.kind == "gain":
        factor = float(fitted.factors[candidate.indices[0]])
        kind = "torque sign" if abs(factor + 1) < _SIGN else "gain"
        candidate = replace(candidate, kind=kind)
    return Proven(candidate, one.trial, one.gain, tuple(values), tuple(settings))


def _combined(search: Trials, base: Trial, made: Sequence[Proven]) -> tuple[list[Proven], float]:
    """The best combination by forward selection, and its unseen error, per cent."""
    on, now, chosen = Setting(), base, list[Proven]()
    left = list(made)
    while left and len(chosen) < _MOST:
        trials = [(one, search.bench.run(on.plus(one.trial.setting), test=False)) for one in left]
        gains = [(gain(now, trial), one, trial) for one, trial in trials]
        worth = [each for each in gains if each[0].share > LEAST_GAIN and each[0].share > LEAST_SE * each[0].se]
        if not worth:
            break
        # The ranking prefers the simpler of those alike.
        _, best, trial = worth[0] if not chosen else max(worth, key=lambda each: each[0].share)
        chosen.append(best)
        on, now = on.plus(best.trial.setting), trial
        # Changes of one channel, and other rows, exclude each other.
        left = [one for one in left if one is not best and not _excludes(best.candidate, one.candidate)]
    return chosen, _percent(search, now)


def _excludes(one: TriedChange, other: TriedChange) -> bool:
    channels = ("gain", "torque sign", "torque swap", "position sign", "position swap")
    return one.kind in channels and other.kind in channels


def _action(search: Trials, base: Trial, one: Proven, adds: bool, edits: tuple[Edit, ...]) -> Action:
    """A proven candidate in words."""
    candidate = one.candidate
    where = joined_names(list(dict.fromkeys(candidate.places)), most=8)
    change = _CHANGE[candidate.kind].format(where=where) + _size(one)
    before, after, se = _percent(search, base), _percent(search, one.trial), _paired(search, base, one.trial)
    return Action(
        candidate.kind, candidate.places, change, "unseen error", before, after, se, one.gain.share, adds, edits
    )


def _size(one: Proven) -> str:
    """How large what was found is, in words."""
    kind = one.candidate.kind
    if kind in ("gain", "torque sign"):
        return f", which is {float(one.trial.whole.factors[one.candidate.indices[0]]):.4g} times the model's"
    if not one.values:
        return ""
    theta = [float(v[0]) for v in one.values]
    match kind:
        case "time shift":
            return f" by {', '.join(f'{1e3 * x:.3g}' for x in theta)} ms"
        case "length":
            return f" by {1e3 * theta[0]:.3g} mm"
        case "zero offset" | "gravity direction":
            return f" by {', '.join(f'{x:.3g}' for x in theta)} rad"
        case "stribeck":
            return f" (velocity {', '.join(format(s['velocity'], '.3g') for s in one.settings)} rad/s or m/s)"
        case "ripple":
            return f" (period {', '.join(format(s['period'], '.3g') for s in one.settings)} rad or m)"
        case "payload":
            return f" (from t = {one.settings[0]['time']:.4g} s)" if one.settings else ""
        case _:
            return ""


def _mask_action(mask: Proven, edits: tuple[Edit, ...]) -> Action:
    """Rows left out, in words."""
    one = mask.candidate
    where = joined_names(list(one.places))
    note = f" ({100 * one.fault.share:.2g} % of the samples)" if one.fault else ""
    before, after, se = mask.figures
    return Action(
        one.kind, one.places, _CHANGE[one.kind].format(where=where) + note, "unseen error", before, after, se,
        mask.gain.share, True, edits,
    )  # fmt: skip


def _bodies(found: Sequence[Impossible], known: set[tuple[str, str]]) -> Iterator[Action]:
    """Signs of motors of which everything is negative."""
    for one in found:
        if ("torque sign", one.label) in known or any(kind == "position sign" for kind, _ in known):
            continue
        change = f"reverse the torque or the position channel of {one.label}, whose {joined_names(one.names)} cannot be"
        edit = Edit("study", "multiply", ("channels", "torque", "gain"), -1.0, one.motor)
        yield Action("torque sign", (one.label,), change, "possible bodies", one.t, 0.0, None, 1.0, True, (edit,))


def _units(diagnosis: Diagnosis | None, known: set[tuple[str, str]]) -> Iterator[Action]:
    """Torques whose size relative to the prior bodies a confusion of units explains."""
    if diagnosis is None:
        return
    found = next((one for one in diagnosis.findings if one.name == "units and signs"), None)
    if found is None or found.status != "bad":
        return
    labels = [motor.label for motor in diagnosis.estimate.observation.motors]
    for k, label in enumerate(labels):
        factor = found.figures.get(f"factor {label}")
        if factor is None or (0.5 < factor < 2.0) or {("gain", label), ("torque sign", label)} & known:
            continue
        kind = "torque sign" if factor < 0 else "unit"
        edit = Edit("study", "multiply", ("channels", "torque", "gain"), float(f"{1 / factor:.6g}"), k)
        change = _CHANGE[kind].format(where=label)
        yield Action(kind, (label,), change, "prior bodies", factor, 1.0, None, 1.0, True, (edit,))


def _untold(search: Trials, base: Trial, actions: Sequence[Action]) -> Iterator[str]:
    """What cannot be told from this log."""
    bench = search.bench
    every = np.arange(bench.blocks)
    G = bench.grams["used"].sum(axis=0)
    alike = []
    for one in search.candidates:
        if len(one.setting.terms) == 1 and one.kind in ("spring", "rotor inertia", "zero offset", "length"):
            columns = list(one.setting.terms[0][0])
            if _independent(G, bench.kept, columns[0], bench.weights) < _TOLD:
                alike.append(f"{one.kind} ({one.places[0]})")
    error = bench.errors(base.whole, Setting()).sum()
    if any(action.kind in ("gain", "unit", "torque sign") for action in actions):
        error = 0.0
    for k, row in reversed(list(enumerate(search.model.measured_rows))):
        other = Setting(factors=((k, 1.5),))
        if bench.errors(bench.fit(other, every), other).sum() < 1.01 * error:
            alike.insert(0, f"gain of the torque ({search.model.device.row_labels[row]})")
    if alike:
        yield (
            f"Cannot be told from this log, because the model's other parameters would absorb it: "
            f"{joined_names(alike, most=3)}."
        )
    if not actions and _percent(search, base) > CLOSE:
        yield (
            f"None of {len(search.candidates)} changes lowers the error on unseen blocks "
            f"({_percent(search, base):.3g} %): its cause cannot be told from this log."
        )


def _independent(G: Array, kept: np.ndarray, column: int, weights: Array) -> float:
    """Share of a column's length that the base columns leave."""
    every = np.append(kept, column)
    A = np.einsum("k,kij->ij", weights**2, G[:, every[:, None], every])
    scale = 1 / np.sqrt(np.maximum(np.diag(A), np.finfo(float).tiny))
    A = A * scale[:, None] * scale
    left = A[-1, -1] - A[-1, :-1] @ np.linalg.pinv(A[:-1, :-1], rcond=1e-10, hermitian=True) @ A[:-1, -1]
    return float(np.sqrt(max(left, 0.0)))


__all__ = ["Action", "Advice", "Gain", "advise"]
