"""Springs that are no straight line: a counterbalance between a link and its parent, a transmission with play."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.device.expressions import CustomColumn, column

if TYPE_CHECKING:
    from haptid.device.geometry import Reader
    from haptid.device.terms.build import Target, TermTargets
    from haptid.device.toml.errors_at import Place
    from haptid.device.toml.terms import CounterbalanceTerm


@dataclass(frozen=True)
class Counterbalance:
    """A strut between link and parent that pulls on a crank: torque per unit of its parameter.

    With delta = q + angle, the strut is sqrt(base^2 + crank^2 - 2 base crank cos delta) long, has lengthened
    by dl from its shortest, and pulls with the lever arm base crank sin(delta) / length.

    Attributes:
        joint: index of the joint about whose axis it pulls.
        crank, base: distances of its two ends from the joint axis, m.
        angle: added to the joint position, rad.
        sign: 1 or -1.
        force: "constant" (parameter N), "linear" in dl (N/m), or "gas", 1 / (1 - dl / stroke) (N).
        stroke: lengthening at which the gas volume would vanish, m.
    """

    joint: int
    crank: float
    base: float
    angle: float
    sign: float
    force: str
    stroke: float = np.inf

    def values(self, q: Array) -> Array:
        """The column, (samples,), from the positions of all joints, (joints, samples)."""
        delta = q[self.joint] + self.angle
        length = np.sqrt(self.base**2 + self.crank**2 - 2 * self.base * self.crank * np.cos(delta))
        lengthening = length - abs(self.base - self.crank)
        lever = self.sign * self.base * self.crank * np.sin(delta) / length
        if self.force == "linear":
            return np.asarray(lever * lengthening)
        if self.force == "gas":
            return np.asarray(lever / (1 - lengthening / self.stroke))
        return np.asarray(lever)


def read_counterbalance(
    table: CounterbalanceTerm, target: Target, force: str, reader: Reader, place: Place
) -> Counterbalance:
    """The strut of a [[terms]] table on a revolute joint.

    Raises:
        DeviceFileError: another target, or lengths that no strut has.
    """
    if target.joint is None or target.prismatic:
        raise place.error(f"a counterbalance cannot act on {target.on}", "Name one revolute joint in joints.")
    crank, base = (reader.positive(getattr(table, key), place.at(key)) for key in ("crank", "base"))
    if crank == base:
        found = f"crank and base are both {crank:g} m"
        raise place.at("crank").error(found, "Make them differ: the strut would have zero length at one angle.")
    stroke = np.inf
    if table.law == "gas":
        if table.stroke is None:
            raise place.at("stroke").error("this key is missing", "Write stroke = ... (m) for a gas law.")
        stroke, most = reader.number(table.stroke, place.at("stroke")), 2 * min(crank, base)
        if stroke <= most:
            found = f"found {stroke:g} m, but the strut lengthens by up to {most:g} m"
            raise place.at("stroke").error(found, f"Write a stroke above {most:g}.")
    elif table.stroke is not None:
        raise place.at("stroke").error("stroke has no meaning for a spring", 'Remove it, or write law = "gas".')
    angle = reader.angle(table.angle, place.at("angle"))
    return Counterbalance(target.joint, crank, base, angle, float(table.sign), force, float(stroke))


def beyond_play(target: Target, targets: TermTargets, place: Place) -> CustomColumn:
    """The torsion x of an elastic motor beyond the dead zone of its play: x - sgn(x) min(|x|, play / 2).

    Source: Nordin and Gutman (2002), Automatica 38(10), section 3.1, the dead-zone model of backlash.
    """
    x, constants = f"{target.position} - rest", {"play": 0.0, "rest": 0.0}
    joints = [joint.name for joint in targets.joints]
    made = column(f"{x} - 0.5*abs({x} + 0.5*play) + 0.5*abs({x} - 0.5*play)", joints, constants, place)
    return replace(made, nature="spring")
