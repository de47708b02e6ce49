"""Actions of an advice with their proofs, as values, sentences and JSON."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Literal

import numpy as np

from haptid._internal.late import dataclass
from haptid.advice.coarse import COARSER, RISES
from haptid.advice.coarse import KIND as COARSE
from haptid.advice.columns import ELASTIC, GIVES_WAY
from haptid.advice.contact import BY_RESIDUAL
from haptid.advice.edits import Edit
from haptid.advice.more_motion import MoreMotion
from haptid.inference.diagnosis.finding import joined_names
from haptid.uncertainty.figures import per_cent

Proof = Literal["unseen error", "consistent fit", "possible bodies", "prior bodies"]
# Actions that are shown.
SHOWN = 6
# Factor by which the first action lowers the error where it explains the rest, and by which the others leave more.
_EXPLAINS = 3.0
# Changes of a whole log: where one of them is to be made, no other change can be judged before it is.
WHOLE_LOG = ("side", "mounting", "joint order", "joint zeros", ELASTIC, GIVES_WAY)
# A gain of next to nothing that explains nothing of the channel.
NO_TORQUE = "no torque"
# Kinds that leave rows out.
MASKS = ("dead torque", "noise alone", "stuck position", *BY_RESIDUAL, "slip", "limit cycle", "other log")
# Kind of what changes the fit for use, and not the rows or the free model.
USE = "model for use"
# What to do, by the kind of the change: an instruction, as verdicts say that it is not followed.
CHANGES: Mapping[str, str] = {
    "coulomb": "add Coulomb friction on {where}",
    "viscous": "add viscous friction on {where}",
    "offset": "add a constant torque (direction-dependent dry friction, or an amplifier's offset) on {where}",
    "viscosity by direction": "let viscous friction depend on the direction on {where}",
    "bent viscosity": "add friction that grows with the square of the speed on {where}",
    "stribeck": "add Stribeck friction on {where}",
    "degressive friction": "let dry friction reach its size at some speed only (degressive friction) on {where}",
    "presliding": "let dry friction build up over a distance after reversals (Dahl friction) on {where}",
    "spring": "add a spring on {where}",
    "torque by position": "add a torque that depends on the position of {where}",
    "load friction": "add load-dependent dry friction on {where}",
    "rotor inertia": "add the rotor's inertia on {where}",
    "ripple": "add a torque periodic in the position of {where}",
    "time shift": "shift the torque channel of {where} in time",
    "common delay": "shift {where} in time, as a delay that they share",
    "drift": "split the log, or record at one temperature, as the friction or offset of {where} drifts with time",
    "payload": "split the log, and estimate with `haptid payload` what is on {where} for part of the log",
    "gain": "correct the gain of the torque channel of {where}",
    "torque sign": "reverse the torque channel of {where}",
    "unit": "correct the unit of the torque channel of {where}",
    "torque swap": "exchange the torque channels of {where}",
    "position sign": "reverse the position channel of {where}",
    "position swap": "exchange the position channels of {where}",
    "joint order": "put the channels into the device's order of joints: give {where}",
    "position unit": "read the positions in {where}",
    "zero offset": "correct the zero of the position of {where}",
    "length": "correct {where} in the device file",
    "gravity direction": "correct the direction of gravity in the device file",
    "dead torque": "leave out the torque channel of {where}, which is dead: check its wiring, and record again",
    "noise alone": (
        "leave out the torque channel of {where}, which shows noise alone: check that it is connected and of this "
        "motor, and record again"
    ),
    NO_TORQUE: (
        "leave out the torque channel of {where}, of which the model explains nothing: check that it is connected and "
        "of this motor, and record again"
    ),
    "coarse torque": "record the torque of {where} with a finer resolution",
    "clipped torque": "leave out the parts in which the torque of {where} is clipped",
    "stuck position": "leave out the parts in which the position of {where} is stuck",
    "contact": "leave out the parts in which something touches {where}",
    "rest": "leave out the parts in which {where} rests, where dry friction is anything up to its size",
    "start": "leave out the parts in which {where} sets off after it has stood still",
    "slip": "leave out all but the longest part between slips of the transmission of {where}",
    "limit cycle": "leave out the parts in which {where}, held, goes back and forth",
    "other log": "leave out {where}, which is not of the device that the other logs are of",
    ELASTIC: "make {where} elastic",
    GIVES_WAY: "record the positions on both sides of the drives of {where}, which give way like springs",
    "filter": "set the cut-off of the position filter to {where}",
}
# Limits of the proof of each kind.
_OPEN: Mapping[str, str] = {
    "offset": "whether it is friction or the amplifier's offset",
    "degressive friction": "whether lubrication makes it, or something else that is less in slow motion",
    "torque by position": "what exerts it: a cable, a spring, or gravity of a link",
    "ripple": "whether it is cogging, gear teeth or an eccentric pulley",
    "time shift": "which of the two channels is late",
    "common delay": "whether the torques are late, or friction that the model lacks makes them seem so",
    "drift": "whether it is warmth, wear or an amplifier",
    "payload": "when it was fixed, to better than a twelfth of the log",
    "gain": "whether the channel's gain or the model's lengths and gear ratios are wrong",
    "unit": "whether the channel's gain or the prior bodies are wrong",
    "zero offset": "whether the sensor's zero or the device file's angle is wrong",
    "gravity direction": "whether the base is tilted or several zeros are wrong",
    "mounting": "whether the base is tilted from that axis",
    ELASTIC: "whether the drives bend or the structure behind them",
    GIVES_WAY: "how stiff they are: this log's positions do not show it",
    "dead torque": "what the channel would have shown",
    "noise alone": "what the channel would have shown",
    NO_TORQUE: "what the channel would have shown",
    "stuck position": "whether it is held there on purpose: logs of poses that are held are for `haptid poses`",
    "contact": "what touched it, and lighter contacts elsewhere",
    "start": "whether dry friction that breaks away makes it, cold grease or a brake",
    "slip": "the sizes of slips that are smaller than what the encoders show",
    "limit cycle": "whether play or dry friction with a controller that integrates makes it",
    "other log": "what differs in it: a payload, a setting, another device",
    "filter": "the effect in faster motion than the log's",
}


def told_apart(before: float, after: float) -> tuple[str, str]:
    """Two errors, per cent, in as many digits as show their difference: three at least, and six at most."""
    for digits in range(3, 7):
        first, second = f"{before:.{digits}g}", f"{after:.{digits}g}"
        shown = abs(float(first) - float(second))
        if abs(shown - abs(before - after)) <= 0.1 * abs(before - after):
            break
    return first, second


def _plain(ratio: float) -> str:
    """A ratio to three digits, without an exponent where it is of thousands."""
    return f"{round(ratio, 0):.0f}" if 1e3 <= abs(ratio) < 1e6 else f"{ratio:.3g}"


@dataclass(frozen=True)
class Action:
    """A change that was carried out on the data.

    Attributes:
        kind: such as "stribeck".
        places: where.
        change: what to do, and by how much.
        proof: kind of the proof.
        before, after: error of torque on unseen rows, per cent, for "consistent fit" that of this fit; for "possible
            bodies" the distance of the parameters from bodies that can exist, in standard errors; for "prior bodies"
            the ratio of the torque to theirs.
        se: paired standard error of before - after, None where the error is not the proof.
        share: of the weighted squared unseen error that goes away.
        adds: whether it belongs to the best combination.
        edits: of study and device file; empty where files cannot say it.
        blocks: unseen time blocks on which the errors are stated.
        rivals: other changes whose gain is the same within a paired standard error, mountings within three.
        motor: whose error is stated; empty for that of all.
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
    blocks: int = 0
    rivals: tuple[str, ...] = ()
    motor: str = ""

    @property
    def falls(self) -> float:
        """By how much the error falls, per cent of the torque."""
        return self.before - self.after

    @property
    def sentence(self) -> str:
        """The change, its proof, and the limits of the proof."""
        return " ".join([f"{self.change[0].upper()}{self.change[1:]}{self._proof}", *self._open])

    @property
    def _proof(self) -> str:
        on = f"the error{f' of {self.motor}' if self.motor else ''} on {self.blocks} unseen time blocks"
        if self.kind in MASKS:
            rows = f"{per_cent(self.before, 3)} of all rows, {per_cent(self.after, 3)} of the others without them"
            return f": {on} is {rows}."
        if self.kind == COARSE:
            coarser = float(np.sqrt(self.after**2 + (RISES + 1) * (self.before**2 - self.after**2)))
            steps = f"with steps {COARSER} times as coarse {on} rises from {self.before:.3g} to {coarser:.3g} %"
            return f": {steps}; with none it would be {self.after:.3g} % or less (paired standard error {self.se:.2g})."
        if self.proof == "unseen error":
            before, after = told_apart(self.before, self.after)
            return f": {on} falls from {before} to {after} % (paired standard error {self.se:.2g})."
        if self.proof == "consistent fit":
            size = f"falls from {self.before:.3g} to {self.after:.3g} %"
            return f": on {self.blocks} unseen time blocks the error of the fit with bodies that can exist {size}."
        if self.proof == "possible bodies":
            return f": without it they are {self.before:.3g} standard errors below zero or more."
        return f": the torque is {_plain(self.before)} times that of the prior bodies, and then {_plain(self.after)}."

    @property
    def _open(self) -> Iterator[str]:
        if self.rivals:
            yield f"Not distinguishable from it by paired block errors: {joined_names(self.rivals)}."
        if self.kind in _OPEN:
            yield f"Not known: {_OPEN[self.kind]}."

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
            "blocks": self.blocks,
            "rivals": list(self.rivals),
            "motor": self.motor,
            "sentence": self.sentence,
            "edits": [edit.to_dict() for edit in self.edits],
        }


@dataclass(frozen=True)
class Advice:
    """Actions by what the error falls by, and questions that the log leaves open.

    Attributes:
        actions: those with proof, sorted.
        before, after: unseen error without changes and with the best combination, per cent, on the same rows.
        undetermined: sentences on what cannot be determined from this log.
        tried: number of candidates.
        motion: further motion that would make wide intervals narrow; None where none would, or none is wide.
        kinds: of the candidates; none where what is proven keeps the others from being judged.
    """

    actions: tuple[Action, ...]
    before: float
    after: float
    undetermined: tuple[str, ...]
    tried: int
    motion: MoreMotion | None = None
    kinds: frozenset[str] = frozenset()

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
        """The first actions, further motion, then open questions."""
        listed = [action for action in self.actions if not self._far_behind(action)]
        shown = [
            f"{k}. {action.sentence}{'' if action.adds else ' It adds nothing to the best combination.'}"
            for k, action in enumerate(listed[:SHOWN], 1)
        ]
        together = [action.kind for action in self.combination if action.kind != USE and action.falls > 0]
        if len(together) > 1 and self.after < self.before:
            before, after = told_apart(self.before, self.after)
            shown.append(f"Together ({joined_names(together)}): unseen error {before} to {after} %.")
        if behind := len(self.actions) - len(listed):
            others = "One other change lowers" if behind == 1 else f"{behind} other changes lower"
            shown.append(f"{others} the error by less, which the first explains; `haptid advise --json` lists all.")
        return (*shown, *((self.motion.sentence,) if self.motion else ()), *self.undetermined)

    def _far_behind(self, action: Action) -> bool:
        """Whether an action is left out of the sentences: the first leaves little, and this one several times as much.

        A wrong channel makes many changes help a little.
        """
        first = self.actions[0]
        explains = first.adds and first.proof == "unseen error" and not first.motor and first.kind not in MASKS
        if action.adds or action.proof != "unseen error" or not explains or first.after > first.before / _EXPLAINS:
            return False
        return bool(action.motor) or action.after > _EXPLAINS * first.after

    def to_dict(self) -> dict[str, Any]:
        """As JSON values."""
        return {
            "tried": self.tried,
            "unseen_error_percent": self.before,
            "combined_error_percent": self.after,
            "actions": [action.to_dict() for action in self.actions],
            "undetermined": list(self.undetermined),
            "more_motion": None if self.motion is None else self.motion.to_dict(),
        }
