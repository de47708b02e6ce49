"""Motors whose torque channels are reversed, by what cannot be negative and by the error with them reversed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from haptid.advice.action import Action
from haptid.advice.bodies import SHOWS, Impossible
from haptid.advice.edits import gain_edits
from haptid.advice.search import LARGE_GAIN, LEAST_SE, Proven, Trials, large_enough, paired, unseen_percent
from haptid.advice.trial import Bench, Setting, Trial, gain
from haptid.inference.diagnosis.finding import joined_names

# Share of the squared error that rounding changes.
_SAME_ERROR = 1e-6
# Trials on rows of which some motors' torques are reversed.
_REVERSED = Setting(rows="reversed")


def reversed_motors(search: Trials, base: Trial, negative: Sequence[Impossible]) -> list[tuple[Impossible, ...]]:
    """Motors whose torque is reversed, one by one, or all of them where their coupling tells only that of all."""
    alone: list[tuple[Impossible, ...]] = [(one,) for one in negative if _reversible(search, base, (one,))]
    if alone or len(negative) < 2:
        return alone
    return [tuple(negative)] if _reversible(search, base, negative) else []


def _reversible(search: Trials, base: Trial, group: Sequence[Impossible]) -> bool:
    """Whether the motors' torques reversed leave no greater error, and nothing clearly negative that must be positive.

    A reversed motor has all of its torque reversed: where only a trace of it is negative, as in slow motion or where a
    hand moves the device, that says nothing of the channel.
    """
    if max(one.share for one in group) < SHOWS:
        return False
    trial = _with_reversed(search, group).run(_REVERSED)
    made = gain(base, trial)
    beta = search.bench.base_parameters(trial)
    positive = all(bool((one.combinations @ beta > one.least).all()) for one in group)
    return made.share > -min(max(LEAST_SE * made.se, _SAME_ERROR), LARGE_GAIN) and positive


def without_complements(
    search: Trials, signs: Sequence[tuple[Impossible, ...]], made: Sequence[Proven]
) -> list[Proven]:
    """Changes without signs that are worth nothing once these motors are reversed: those of all the other motors."""
    bench = _with_reversed(search, [impossible for group in signs for impossible in group])
    base = bench.run(_REVERSED) if signs else None

    def helps(one: Proven) -> bool:
        if base is None or one.candidate.kind != "torque sign":
            return True
        return large_enough(gain(base, bench.run(_REVERSED.plus(one.trial.setting))))

    return [one for one in made if helps(one)]


def sign_actions(
    search: Trials, base: Trial, found: Sequence[tuple[Impossible, ...]], known: set[tuple[str, str]]
) -> Iterator[Action]:
    """Actions of these motors, but for those whose sign, or a position's, is among what is known."""
    for group in found:
        labels = tuple(one.label for one in group)
        if any(("torque sign", label) in known for label in labels) or any(
            kind == "position sign" for kind, _ in known
        ):
            continue
        names = list(dict.fromkeys(name for one in group for name in one.names))
        channel = "channel" if len(group) == 1 else "channels"
        change = (
            f"reverse the torque or the position {channel} of {joined_names(labels)}, "
            f"whose {joined_names(names)} cannot be negative"
        )
        edits = tuple(edit for one in group for edit in gain_edits(search, one.motor, -1.0))
        bench, model = _with_reversed(search, group), search.model
        trial = bench.run(_REVERSED)
        made = gain(base, trial)
        if made.share > LARGE_GAIN and large_enough(made):
            before, after = (unseen_percent(model, bench, one) for one in (base, trial))
            yield Action(
                "torque sign", labels, change, "unseen error", before, after,
                paired(model, bench, base, trial), made.share, True, edits, bench.blocks,
            )  # fmt: skip
        else:
            least = min(one.t for one in group)
            yield Action("torque sign", labels, change, "possible bodies", least, 0.0, None, 1.0, True, edits)


def _with_reversed(search: Trials, group: Sequence[Impossible]) -> Bench:
    """The bench with rows on which these motors' torques are reversed, those of `_REVERSED`."""
    grams = search.bench.grams["used"]
    for one in group:
        grams = grams.reversed(one.motor)
    return search.bench.with_rows(_REVERSED.rows, grams)
