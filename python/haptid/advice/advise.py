"""`advise(identification)`: what to change, each action carried out on the data first, sorted by its gain."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from haptid._internal.blas_threads import on_one_blas_thread
from haptid.advice.action import CHANGES, NO_TORQUE, USE, Action, Advice
from haptid.advice.bodies import right_signs
from haptid.advice.clash import clash, whole_reversed
from haptid.advice.columns import ELASTIC, GIVES_WAY
from haptid.advice.conventions import OtherCounts, other_counts, with_all_motion
from haptid.advice.delays import COMMON_DELAY, TIME_SHIFT
from haptid.advice.edits import Edit, edits_in_validation_logs, edits_of, gain_edits
from haptid.advice.elastic import OtherElasticity, other_elasticity, stiffnesses
from haptid.advice.filters import OtherFilter, other_filter
from haptid.advice.more_motion import more_motion
from haptid.advice.orders import OtherOrder, other_order
from haptid.advice.ranking import OF_TORQUE_CHANNELS, helped, stated
from haptid.advice.reversed_motors import sign_actions
from haptid.advice.search import (
    LARGE_GAIN,
    Proven,
    Trials,
    TriedChange,
    large_enough,
    of_no_motor,
    unseen_percent,
)
from haptid.advice.sides import MOST_LEFT, OtherMounting, OtherSide, other_mounting, other_side
from haptid.advice.sought import LARGE_ERROR, ROUGH_ERROR, behind, sought
from haptid.advice.trial import Setting, Trial, gain
from haptid.advice.undetermined import undetermined
from haptid.advice.use import other_use
from haptid.advice.validation_logs import of_validation_logs
from haptid.dynamics.model import DynamicModel
from haptid.errors import HaptidError
from haptid.estimation import Estimate
from haptid.inference.diagnosis import Diagnosis
from haptid.inference.diagnosis.finding import joined_names
from haptid.inference.diagnosis.plausibility import GOOD, confusions, unlike_together
from haptid.inference.diagnosis.subsample import subsample
from haptid.motion.motion import Motion
from haptid.study.identify import Identification
from haptid.treatment_choice.motion_filters import HIGHEST_PARALLEL

# Unseen error, per cent, from which zeros and directions of the joints are tried, of which there are dozens.
_COUNTS = 5.0
# The same from which a device with springs is identified: where springs to first order explain much, and elsewhere.
_FITTED, _UNEXPLAINED = 2.0, 4.0
# Share of the error that a combination leaves where it may be why bodies cannot exist.
_MENDED = 0.5
# Changes that say what a channel is, of which one is made at a time.
_CHANNELS = (*OF_TORQUE_CHANNELS, "position sign", "position swap", "position unit")
# Most actions of a combination.
_MOST = 4


@on_one_blas_thread
def advise(found: Identification, diagnosis: Diagnosis | None = None) -> Advice:
    """Try every change that haptid knows on the rows of an identification, and keep those with a proof.

    Fits on every other time block are judged on the blocks between; a change is proposed where its test is significant
    at 0.01 over all candidates together and its gain is more than three standard errors of paired block differences
    (two where it is a quarter of the squared error). Where a change would only rescale parameters, the proof is by
    bodies that can exist, or by prior bodies. Where nothing is wrong, further motion is proposed by the
    intervals that it is predicted to give. Nothing is changed.

    Args:
        found: a study carried out.
        diagnosis: of its estimate, whose comparison with prior bodies is used; not compared where None.
    """
    part = subsample(found.estimate)
    motions = part.observation.motions
    if any(motion.treatment.momentum for motion in motions):
        return Advice((), 0.0, 0.0, ("No action is tried without accelerations.",), 0)
    if reason := _too_slow(found):
        return Advice((), 0.0, 0.0, (reason,), 0)
    if (side := _side(found, part)) is not None:  # nothing else can be judged with it
        return Advice((side,), side.before, side.after, (), 1)
    try:
        other = _filter(found, part)
        tried = other.motions if other else _with_their_motion(found, motions)
        first = sought(found.model, part, tried, part.beta, found.proposal.delays is None, changed=tried is not motions)
        now = behind(first, part, tried)
    except HaptidError as error:
        return Advice((), 0.0, 0.0, (f"No action could be tried: {error}",), 0)
    search, base, made, masks, before = now.search, now.base, now.made, now.masks, first.before
    chosen, best = _combined(search, base, made)
    after = now.error(best)
    places = {(one.candidate.kind, place) for one in made for place in one.candidate.places}
    reversals = list(sign_actions(search, base, now.signs, places))
    telling = [action for action in reversals if action.proof == "unseen error"]
    left = min([after, *(action.after for action in telling)]) / max(before, 1e-300)
    whole_changes = [one for one in (_mounting(found, part, left), _order(found, part, left)) if one is not None]
    left = min([left, *(one.after / one.before for one in whole_changes)])
    if not masks or now.error(base) >= _COUNTS:  # what rows left out mend is no other zero
        whole_changes += [one for one in (_counts(found, part, left),) if one is not None]
        left = min([left, *(one.after / one.before for one in whole_changes)])
    if (one := _elastic(found, part, chosen, left, before)) is not None:
        whole_changes.append(one)
    elif _springs(chosen[:1]):
        whole_changes.append(_action(search, base, chosen[0], True, (), _rivals(base, chosen[0], made)))
    if whole_changes:  # nothing else can be judged with the one that leaves least
        least = min(whole_changes, key=lambda one: one.after)
        check = tuple(_other_robot(least.after, (0.0, 0.0)))
        return Advice((least,), least.before, least.after, check, len(search.candidates) + len(whole_changes))
    if telling:  # everything else was judged on torques of the wrong sign
        after = min(action.after for action in telling)
        return Advice(tuple(telling), before, after, tuple(_other_robot(after, (0.0, 0.0))), len(search.candidates))
    treatment = found.proposal.treatment
    listed = [
        _action(search, base, one, one in chosen, edits_of(search, one, treatment), _rivals(base, one, made))
        for one in made
    ]
    listed = _shifted_once([action for action in listed if action.after < action.before])
    others = [
        _mask_action(
            mask,
            (*edits_of(now.whole, mask, treatment), *edits_in_validation_logs(found, mask.candidate)),
            search.bench.blocks,
        )
        for mask in masks
    ]
    others += [*([_filter_action(other, search.bench.blocks)] if other else []), *_use(found)]
    if now is not first and (late := first.late):
        others.append(_action(first.search, first.base, late, True, edits_of(first.search, late, treatment), ()))
    for one in others:  # the rest keep their order
        listed.insert(sum(not action.motor and action.falls > one.falls for action in listed), one)
    known = {(action.kind, place) for action in listed for place in action.places}
    # Channels that are proven to be wrong may be why bodies cannot exist: signs are then judged without them.
    of_channels = any(one.candidate.kind in _CHANNELS for one in chosen)
    mended = of_channels and left < _MENDED and not now.impossible(best)
    whole_sign = None if mended else whole_reversed(found, part)
    if whole_sign is not None and whole_sign.kind == "mounting":  # nothing else can be judged with it
        return Advice((whole_sign,), whole_sign.before, whole_sign.after, (), len(search.candidates) + 1)
    signs = [whole_sign] if whole_sign else [] if mended else reversals
    known |= {(action.kind, place) for action in signs for place in action.places}
    signs += _units(search, (base, best), diagnosis, known)
    start = max([before, *(action.before for action in listed if action.proof == "unseen error" and not action.motor)])
    every = [*signs, *listed]
    unknown = undetermined(search, base, {action.kind for action in every}, not every)
    sentences = [
        *_other_robot(after, (0.0, 0.0) if signs or mended else clash(found.use)),
        *_unlike(diagnosis, known),
        *of_validation_logs(found, None if masks else before),  # what spoils rows may do so in the other logs too
        *unknown,
    ]
    # Columns and noise of a model that is known to be wrong predict nothing.
    more = None if every else more_motion(part)
    kinds = frozenset(one.kind for one in search.candidates)
    return Advice(tuple(every), start, after, tuple(sentences), len(search.candidates), more, kinds)


def _shifted_once(listed: Sequence[Action]) -> list[Action]:
    """Without other sizes of a shift in time of the same channels: by its slope, and by shifts that are tried whole."""
    told = {place for one in listed if one.kind == TIME_SHIFT and one.adds for place in one.places}
    kept = []
    for one in listed:
        if one.kind == TIME_SHIFT and not one.adds:
            if told.issuperset(one.places):
                continue
            told |= set(one.places)
        kept.append(one)
    return kept


def _other_robot(after: float, errors: tuple[float, float]) -> Iterator[str]:
    """A sentence on a description that no change reconciles with the log.

    Args:
        after: unseen error with all that is proven, per cent.
        errors: of the fit with bodies that can exist and of the free fit, where they clash; zeros otherwise.
    """
    check = (
        "Check first that the device file is of this robot: its axes and lengths, and the order, directions and zeros "
        "of its joints as the channels have them. Terms may only make up for a wrong description."
    )
    if after > ROUGH_ERROR:
        yield f"What is proven leaves an error of {after:.3g} % on unseen blocks. {check}"
    elif errors[0] > LARGE_ERROR:
        yield (
            f"Bodies that can exist leave an error of {errors[0]:.3g} %, where a fit of any numbers leaves "
            f"{errors[1]:.3g} %. {check}"
        )


def _too_slow(found: Identification) -> str:
    """The reason why no change is tried, for a log sampled too slowly for its motion; empty for others."""
    motion, proposal = found.estimate.observation.motions[0], found.proposal
    limit = HIGHEST_PARALLEL / motion.dt  # a lower filter may be chosen for the noise
    if "parallel_cutoff_hz" in found.study.treatment or proposal.bandwidth_hz <= limit:
        return ""
    return (
        f"The motion, {proposal.bandwidth_hz:.3g} Hz, is faster than the {limit:.3g} Hz that the log's rate of "
        f"{1 / motion.dt:.4g} Hz permits: causes of the error cannot be determined from this log. Record at a higher "
        f"rate, or, if the device vibrates, with softer control."
    )


def _filter(found: Identification, part: Estimate) -> OtherFilter | None:
    """Another cut-off, tried where the study gives one, or where the error is large."""
    given = found.study.treatment.get("cutoff_hz") is not None
    if not given and max((v.relative for v in found.unseen), default=0.0) < LARGE_ERROR:
        return None  # the proposal has compared them
    return other_filter(found.model, part.observation.motions, part.beta, found.proposal.bandwidth_hz, part.zero)


def _with_their_motion(found: Identification, motions: Sequence[Motion]) -> Sequence[Motion]:
    """The motions behind filters that pass all of it, where the proposed one passes less; else as they are.

    What a wrong model leaves looks like noise, and so low a filter better: behind it the cause hardly shows.
    """
    bandwidth = found.proposal.bandwidth_hz
    given = not {"cutoff_hz", "parallel_cutoff_hz"}.isdisjoint(found.study.treatment)
    if given or (found.proposal.treatment.parallel_cutoff_hz or bandwidth) >= bandwidth:
        return motions
    return [with_all_motion(motion, bandwidth) for motion in motions]


def _side(found: Identification, part: Estimate) -> Action | None:
    """Channels of the other side, tried where the error is large."""
    if max((v.comparable.relative for v in found.unseen), default=0.0) < LARGE_ERROR:
        return None
    one = other_side(found.model, part.observation.motions, part.beta, part.zero)
    return None if one is None else _of_whole_log("side", ("the log",), f"take {one.words}", one)


def _order(found: Identification, part: Estimate, left: float) -> Action | None:
    """Another order of the joints' channels, where the best other changes leave more.

    Args:
        left: share of the unseen error that the others leave.
    """
    one = other_order(found.model, part.observation.motions, part.beta, part.zero) if _rough(found) else None
    if one is None or one.after > MOST_LEFT * left * one.before:
        return None
    return _of_whole_log("joint order", one.places, CHANGES["joint order"].format(where=one.words), one)


def _mounting(found: Identification, part: Estimate, left: float) -> Action | None:
    """Gravity along another axis of the base frame, where the best other changes leave more: a spring is like a weight.

    Args:
        left: share of the unseen error that the others leave.
    """
    one = other_mounting(found.model, part.observation.motions, part.beta, part.zero) if _rough(found) else None
    if one is None or one.after > MOST_LEFT * left * one.before:
        return None
    down, *others = (f"[{', '.join(f'{x:.4g}' for x in gravity)}]" for gravity in (one.gravity, *one.rivals))
    change = f"set gravity to {down} in the device file: the base is mounted so"
    less = ", with which the device file's bodies agree less" if one.by_bodies else ""
    return _of_whole_log("mounting", ("the base",), change, one, tuple(f"gravity {other}{less}" for other in others))


def _counts(found: Identification, part: Estimate, left: float) -> Action | None:
    """Other zeros and directions of the joints, where the best other changes leave more: one zero is like a mounting.

    Args:
        left: share of the unseen error that the others leave.
    """
    if max((v.comparable.relative for v in found.unseen), default=0.0) < _COUNTS:
        return None
    one = other_counts(found.model, part.observation.motions, part.beta, part.zero, found.proposal.bandwidth_hz)
    if one is None or one.after > MOST_LEFT * left * one.before:
        return None
    change = f"{one.words}: the log counts otherwise than the device file"
    return _of_whole_log("joint zeros", one.places, change, one, one.rivals)


def _elastic(
    found: Identification, part: Estimate, chosen: Sequence[Proven], left: float, before: float
) -> Action | None:
    """Motors behind springs as a study would identify them, where the best changes leave more.

    Tried for the motors whose springs to first order explain much, or for all where most is not explained: it takes
    seconds.
    """
    springs = _springs(chosen)
    places = [place for one in springs for place in one.candidate.places]
    if before < _FITTED or not (springs or left * before >= _UNEXPLAINED):
        return None
    every = [motor.name for motor in found.model.device.motors]
    some = [name for name in every if f"motor {name}" in places]
    # A stiff motor's spring is not found: then the first order's motors are tried, and each of them alone.
    tried = [own for own in dict.fromkeys([tuple(every), tuple(some), *((name,) for name in some)]) if own]
    delays = found.proposal.treatment.torque_delay_s
    one = other_elasticity(found.model, part.observation.motions, tried, delays, MOST_LEFT * left * before)
    if one is None:
        return None
    told = stiffnesses(one.stiffness, _travel_unit(found.model))
    where, many = joined_names(one.places, most=8), "springs" if len(one.places) > 1 else "a spring"
    change = f"{CHANGES[ELASTIC].format(where=where)}, with {many} of about {told}"
    return _of_whole_log(ELASTIC, one.places, change, one)


def _springs(chosen: Sequence[Proven]) -> list[Proven]:
    """Springs of motors that to first order explain much of the error."""
    return [one for one in chosen if one.candidate.kind == ELASTIC and one.gain.share > LARGE_GAIN]


def _rough(found: Identification) -> bool:
    """Whether the unseen error is so large that an assumption about the whole log may be wrong."""
    return max((v.comparable.relative for v in found.unseen), default=0.0) >= ROUGH_ERROR


def _of_whole_log(
    kind: str,
    places: tuple[str, ...],
    change: str,
    one: OtherSide | OtherOrder | OtherMounting | OtherCounts | OtherElasticity,
    rivals: tuple[str, ...] = (),
) -> Action:
    """The action of another assumption about the whole log."""
    return Action(
        kind, places, change, "unseen error", one.before, one.after, one.se, one.gain.share, True, one.edits,
        one.blocks, rivals,
    )  # fmt: skip


def _combined(search: Trials, base: Trial, made: Sequence[Proven]) -> tuple[list[Proven], Trial]:
    """The best combination by forward selection, and its trial."""
    on, now, chosen = Setting(), base, list[Proven]()
    left = list(made)
    while left and len(chosen) < _MOST:
        trials = [(one, search.bench.run(on.plus(one.trial.setting))) for one in left]
        gains = [(gain(now, trial), one, trial) for one, trial in trials]
        worth = [each for each in gains if large_enough(each[0])]
        if not worth:
            break
        # The ranking prefers the simpler of those alike.
        _, best, trial = worth[0] if not chosen else max(worth, key=lambda each: each[0].share)
        chosen.append(best)
        on, now = on.plus(best.trial.setting), trial
        # Changes of one channel, and other rows, exclude each other.
        left = [one for one in left if one is not best and not _excludes(best.candidate, one.candidate)]
    return chosen, now


def _excludes(one: TriedChange, other: TriedChange) -> bool:
    delays = (TIME_SHIFT, COMMON_DELAY)
    return any(one.kind in group and other.kind in group for group in (_CHANNELS, delays))


def _action(
    search: Trials, base: Trial, one: Proven, adds: bool, edits: tuple[Edit, ...], rivals: tuple[str, ...]
) -> Action:
    """A proven candidate in words."""
    candidate, model, bench = one.candidate, search.model, search.bench
    where = joined_names(list(dict.fromkeys(candidate.places)), most=8)
    kind = NO_TORQUE if of_no_motor(search, one) else GIVES_WAY if candidate.kind == ELASTIC else candidate.kind
    size = "" if kind == NO_TORQUE else _size(one, _travel_unit(model))
    change, edits = CHANGES[kind].format(where=where) + size, () if kind in (NO_TORQUE, GIVES_WAY) else edits
    errors = stated(search, base, one.trial)
    label = "" if errors.motor is None else model.device.row_labels[model.known_rows[errors.motor]]
    return Action(
        kind, candidate.places, change, "unseen error", errors.before, errors.after, errors.se,
        one.gain.share, adds, edits, bench.blocks, rivals, label,
    )  # fmt: skip


def _rivals(base: Trial, one: Proven, made: Sequence[Proven]) -> tuple[str, ...]:
    """Other proven changes that help the same motor as well, within a paired standard error, with their places."""
    alike = []
    for other in made:
        difference, same = gain(other.trial, one.trial), helped(base, other.trial) == helped(base, one.trial)
        if other is not one and same and abs(difference.share) <= difference.se:
            alike.append(f"{other.candidate.kind} ({joined_names(other.candidate.places)})")
    return tuple(alike)


def _travel_unit(model: DynamicModel) -> str:
    """Unit of the joints' positions in words."""
    kinds = {model.device.joints[k].prismatic for k in model.device.active}
    return "rad or m" if len(kinds) > 1 else "m" if kinds == {True} else "rad"


def _size(one: Proven, unit: str) -> str:
    """The size of the effect, in words.

    Args:
        one: what is proven.
        unit: of the joints' positions.
    """
    kind = one.candidate.kind
    if one.candidate.seconds:
        return f", by {1e3 * one.candidate.seconds:.3g} ms"
    if kind in ("gain", "torque sign"):
        return f", which is {float(one.trial.whole.factors[one.candidate.indices[0]]):.4g} times the model's"
    if not one.values:
        return ""
    theta, speed = [float(v[0]) for v in one.values], " or ".join(f"{x}/s" for x in unit.split(" or "))
    match kind:
        case "time shift":
            return f" by {', '.join(f'{1e3 * x:.3g}' for x in theta)} ms"
        case "length":
            return f" by {1e3 * theta[0]:.3g} mm"
        case "zero offset" | "gravity direction":
            return f" by {', '.join(f'{x:.3g}' for x in theta)} rad"
        case "stribeck" | "degressive friction":
            return f" (velocity {', '.join(format(s['velocity'], '.3g') for s in one.settings)} {speed})"
        case "presliding":
            return f" (distance {', '.join(format(s['distance'], '.3g') for s in one.settings)} {unit})"
        case "spring":
            return f" (without torque at {', '.join(format(s['rest'], '.3g') for s in one.settings)} {unit})"
        case kind if kind == ELASTIC:
            return f" of at most about {stiffnesses([1 / x for x in theta], unit)}, to first order"
        case "ripple":
            return f" (period {', '.join(format(s['period'], '.3g') for s in one.settings)} {unit})"
        case "payload":
            return f" (from t = {one.settings[0]['time']:.4g} s)" if one.settings else ""
        case _:
            return ""


def _mask_action(mask: Proven, edits: tuple[Edit, ...], blocks: int) -> Action:
    """Rows left out, in words."""
    one = mask.candidate
    where = joined_names(list(one.places))
    note = f" ({100 * one.fault.share:.2g} % of the samples)" if one.fault and one.fault.share < 1 else ""
    return Action(
        one.kind, one.places, CHANGES[one.kind].format(where=where) + note, "unseen error", *mask.figures,
        mask.gain.share, True, edits, blocks,
    )  # fmt: skip


def _filter_action(one: OtherFilter, blocks: int) -> Action:
    """Another cut-off, in words."""
    where = f"{joined_names([f'{x:g}' for x in dict.fromkeys(one.cutoff_hz)], most=8)} Hz"
    return Action(
        "filter", (where,), CHANGES["filter"].format(where=where), "unseen error", one.before, one.after, one.se,
        one.gain.share, True, (one.edit,), blocks,
    )  # fmt: skip


def _units(
    search: Trials, trials: tuple[Trial, Trial], diagnosis: Diagnosis | None, known: set[tuple[str, str]]
) -> Iterator[Action]:
    """Torques whose size relative to the prior bodies a confusion of units explains.

    Args:
        search: of the log.
        trials: without changes, and with the best combination of those that are proven.
        diagnosis: of the estimate, if there is one.
        known: kinds and places of what is proven.
    """
    if diagnosis is None:
        return
    found = next((one for one in diagnosis.findings if one.name == "units and signs"), None)
    if found is None or found.status != "bad":
        return
    labels = [motor.label for motor in diagnosis.estimate.observation.motors]
    factors = {label: found.figures[f"factor {label}"] for label in labels if f"factor {label}" in found.figures}
    causes = confusions(diagnosis.estimate, factors)
    for k, label in enumerate(labels):
        factor = factors.get(label)
        if factor is None or (0.5 < factor < 2.0) or {("gain", label), ("torque sign", label)} & known:
            continue
        base, best = (unseen_percent(search.model, search.bench, trial, k) for trial in trials)
        if best < _MENDED * base:  # the factor is of parameters that made up for what is mended
            continue
        # Confused units and signs leave the fit as good as it is: the factor of a bad one has another cause.
        if base > ROUGH_ERROR or not (GOOD > -factor > 1 / GOOD or factor > 0):
            continue
        if factor < 0 and k in right_signs(diagnosis.estimate, search.rows):
            continue  # as where a delay takes viscous friction times itself from the inertia
        if factor > 0 and label not in causes:
            continue  # as of a motor that hardly turns its link: bodies, friction and noise are as likely
        kind = "torque sign" if factor < 0 else "unit"
        edits = tuple(gain_edits(search, k, 1 / factor))
        change = CHANGES[kind].format(where=label)
        yield Action(kind, (label,), change, "prior bodies", factor, 1.0, None, 1.0, True, edits)


def _unlike(diagnosis: Diagnosis | None, known: set[tuple[str, str]]) -> Iterator[str]:
    """A sentence on torques whose size relative to the prior bodies no one confusion of units explains."""
    found = None if diagnosis is None else next((f for f in diagnosis.findings if f.name == "units and signs"), None)
    if diagnosis is None or found is None or {"gain", "torque sign", "unit"} & {kind for kind, _ in known}:
        return
    labels = [motor.label for motor in diagnosis.estimate.observation.motors]
    factors = {label: found.figures[f"factor {label}"] for label in labels if f"factor {label}" in found.figures}
    if sentence := unlike_together(diagnosis.estimate, factors):
        yield sentence


def _use(found: Identification) -> Iterator[Action]:
    """Another model for use than the one that the study demands."""
    one = other_use(found)
    if one is not None:
        change = f"predict, compensate and export with {one.words}"
        edit = Edit("study", "set", ("estimate", "use"), "auto")
        yield Action(
            USE, ("the model",), change, "unseen error", one.before, one.after, one.se, one.share, True,
            (edit,), one.blocks,
        )  # fmt: skip


__all__ = ["Action", "Advice", "advise"]
