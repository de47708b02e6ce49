"""Signs, assignments and unit of the position channels as changes that are tried: each is a pass over the log."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from haptid.advice.rows import trial_rows
from haptid.advice.search import Trials, TriedChange
from haptid.advice.trial import Setting
from haptid.errors import HaptidError
from haptid.motion.motion import Motion, with_delay

# The unit that an angle may be in instead, and the factor.
_OTHER_UNIT = {"deg": ("rad", 180 / np.pi), "rad": ("deg", np.pi / 180)}


def positions(search: Trials, signs_only: bool = False) -> Iterator[TriedChange]:
    """Signs, assignments and unit of the position channels; each is a pass over the log, stored with the trials."""
    model, motions = search.model, search.motions
    names = [model.device.joints[k].name for k in model.device.active]
    units = [model.device.joints[k].prismatic for k in model.device.active]
    changes: list[tuple[str, tuple[int, ...]]] = [("position sign", (k,)) for k in range(len(names))]
    pairs = () if signs_only else combinations(range(len(names)), 2)
    changes += [("position swap", pair) for pair in pairs if units[pair[0]] == units[pair[1]]]
    own = set() if signs_only or motions[0].log is None else set(motions[0].log.channels.position.each_unit)
    unit = own.pop() if len(own) == 1 else ""
    if unit in _OTHER_UNIT and not all(units):
        changes.append(("position unit", ()))
    # The delay of a wrong model is none: that of a command that is held.
    plain = [m if m.log is None else with_delay(m, 0.5 * m.dt) for m in motions]
    grams = dict(search.bench.grams)
    for kind, which in changes:
        try:
            moved = [_repositioned(m, which) if which else _in_other_unit(m, unit, units) for m in plain]
            there = trial_rows(model, moved, search.beta, (), motions)
        except HaptidError:
            continue
        if there.blocks == search.rows.blocks:
            key = f"{kind} {which}"
            grams[key] = there.grams()
            places = tuple(f"joint {names[k]}" for k in which) or (f"{_OTHER_UNIT[unit][0]} and not in {unit}",)
            yield TriedChange(kind, places, Setting(rows=key), indices=which)
    object.__setattr__(search.bench, "grams", grams)


def _repositioned(motion: Motion, which: tuple[int, ...]) -> Motion:
    """The motion with the sign of one position channel changed, or with two of them exchanged."""
    q = np.array(motion.q)
    if len(which) == 1:
        q[:, which[0]] *= -1
    else:
        q[:, list(which)] = q[:, list(which[::-1])]
    return replace(motion, q=q)


def _in_other_unit(motion: Motion, unit: str, prismatic: Sequence[bool]) -> Motion:
    """The motion with its angles read in the other unit, and as many times the speed that counts as slow."""
    factor = np.where(prismatic, 1.0, _OTHER_UNIT[unit][1])
    slow = np.asarray(motion.treatment.reversal_speed) * _OTHER_UNIT[unit][1]
    treatment = replace(motion.treatment, reversal_speed=tuple(slow.tolist()) if slow.ndim else float(slow))
    return replace(motion, q=np.array(motion.q) * factor, treatment=treatment)
