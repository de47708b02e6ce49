"""Three-dimensional drawing of the mechanism, moved by its joints, with the apparent mass at the handle."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.device import Frame, NewtonClosure
from haptid.device.loops.formula import AnyClosure, FormulaClosure
from haptid.dynamics.inverse import raw_parameters, rigid
from haptid.dynamics.kinematics import handle_motion
from haptid.dynamics.model import DynamicModel
from haptid.end_effector.force import WORST_CONDITION
from haptid.report.chart import Chart, even, packed, quantised
from haptid.report.section import Section
from haptid.report.source import ReportSource

# A slider of a joint without limits extends the motion by this share at both ends.
_MARGIN = 0.2


@dataclass(frozen=True)
class MechanismSection(Section):
    """The device in three dimensions.

    Attributes:
        joints: for each active joint its name, unit and slider: low, high, start.
        relations: of the other joints, such as "q3 = pi/2 - q2 + q7", where they are constant.
        source_of_geometry: as the device file states it.
        apparent_mass: whether the apparent mass of a handle is shown.
    """

    key: ClassVar[str] = "mechanism"
    title: ClassVar[str] = "Mechanism"
    joints: list[dict[str, Any]]
    relations: list[str]
    source_of_geometry: str
    apparent_mass: bool

    @classmethod
    def of(cls, source: ReportSource) -> MechanismSection:
        made = cls.drawn(source.estimate.model, source.identification.use.beta, poses_of(source))
        (chart,) = made.charts
        drawing = {**chart.drawing, "logs": [_along(source, k) for k in range(len(source.tracks))]}
        caption = f"{chart.caption} It follows the cursor in the curves of the torque."
        return replace(made, charts=(replace(chart, drawing=drawing, caption=caption),))

    @classmethod
    def undriven(cls, model: DynamicModel) -> MechanismSection:
        """The section of a device of which nothing was identified: no masses, and the reach of the sliders is its own.

        A joint without limits moves by half a turn, or 0.2 m, either way from the pose at which the loops close.
        """
        joints = [model.device.joints[k] for k in model.device.active]
        closure = model.device.closure
        start = closure.at if isinstance(closure, NewtonClosure) else np.zeros(len(joints))
        qa = np.empty((len(joints), 3))
        for row, joint, middle in zip(qa, joints, start, strict=True):
            reach = 0.2 if joint.prismatic else np.pi
            low, high = joint.position_limits or (middle - reach, middle + reach)
            row[:] = low, np.clip(middle, low, high), high
        return cls.drawn(model, None, qa)

    @classmethod
    def drawn(cls, model: DynamicModel, beta: Array | None, qa: Array) -> MechanismSection:
        """The section of any device.

        Args:
            beta: its base parameters, (p,), SI; None where they are unknown, and no mass is shown.
            qa: a motion of its active joints, (active, samples), rad or m, for the ranges of the sliders.
        """
        sliders = sliders_of(model, qa, _MARGIN if beta is not None else 0.0)
        return cls(
            charts=(scene(model, beta, qa, sliders),),
            joints=sliders,
            relations=[] if isinstance(model.device.closure, NewtonClosure) else list(model.device.closure.relations),
            source_of_geometry=model.device.source,
            apparent_mass=beta is not None and model.device.handle is not None and model.device.handle.link >= 0,
        )


def poses_of(source: ReportSource, log: int = 0) -> Array:
    """Positions of the active joints along a log, (active, samples), thinned."""
    return np.linalg.inv(source.estimate.model.device.row_map) @ source.tracks[log].trail


def _along(source: ReportSource, log: int) -> dict[str, Any]:
    """Positions along a log, over the times of its curves."""
    track, qa = source.tracks[log], poses_of(source, log)
    each = max(1, round(track.rows / qa.shape[1]))
    times = even(track.t0, each * track.step, qa.shape[1])
    return {"group": f"log-{log}", "t": times, "q": [quantised(q) for q in qa]}


def sliders_of(model: DynamicModel, qa: Array, margin: float = _MARGIN) -> list[dict[str, Any]]:
    """One slider for each active joint, from its positions along a motion, (active, samples)."""
    return [_slider(model, k, q, margin) for k, q in enumerate(qa)]


def _slider(model: DynamicModel, k: int, q: Array, margin: float) -> dict[str, Any]:
    joint = model.device.joints[model.device.active[k]]
    low, high = float(q.min()), float(q.max())
    reach = max(high - low, 0.1 if joint.prismatic else 0.5)
    ends = joint.position_limits or (low - margin * reach, high + margin * reach)
    ends = (min(ends[0], low), max(ends[1], high))
    return {
        "name": joint.name,
        "unit": "m" if joint.prismatic else "rad",
        "low": ends[0],
        "high": ends[1],
        "start": float(q[len(q) // 2]),
        "limits": "at the limits of the device file"
        if joint.position_limits
        else ("slightly beyond the motion of the log" if margin else "half a turn or 0.2 m from the start pose"),
    }


def scene(
    model: DynamicModel,
    beta: Array | None,
    qa: Array,
    sliders: list[dict[str, Any]],
    swept: tuple[Array, Array] | None = None,
    nearest: Sequence[Array] = (),
) -> Chart:
    """Data for the page's script: kinematics, and the inertia for the apparent mass at the handle.

    Args:
        qa: a motion of the active joints, (active, samples), rad or m: the path of the handle.
        swept: bars at other instants, their ends, (bars, 2, 3), and widths, (bars,), m.
        nearest: pairs of points, each (2, 3), m.
    """
    drawing = {
        "kind": "scene",
        "joints": [
            {
                "name": j.name,
                "parent": j.parent,
                "R": j.rotation.ravel().tolist(),
                "p": j.translation.tolist(),
                "slides": j.prismatic,
            }
            for j in model.device.joints
        ],
        "active": list(model.device.active),
        "sliders": sliders,
        "closure": _closure(model.device.closure),
        "cuts": [
            {"kind": cut.kind, "frame_a": _frame(cut.frame_a), "frame_b": _frame(cut.frame_b)}
            for cut in model.device.closure.cuts
        ],
        "handle": None if model.device.handle is None else _frame(model.device.handle),
        "trail": None if beta is None else _trail(model, qa),
        "mass": None if beta is None else _mass(model, beta),
        "swept": None if swept is None else {"ends": packed(swept[0]), "widths": packed(swept[1])},
        "nearest": [ends.tolist() for ends in nearest],
        "height": 420,
    }
    moving = ", ".join(slider["name"] for slider in sliders)
    joints, loops = len(model.device.joints), len(model.device.closure.cuts)
    caption = (
        f"{joints} {'joint' if joints == 1 else 'joints'}, {len(model.device.active)} of them independent ({moving}), "
        f"{loops or 'no'} closed {'loop' if loops == 1 else 'loops'}. Drag to rotate, zoom with the buttons, move the "
        f"joints with the sliders."
    )
    alt = f"Three-dimensional drawing of {model.device.name}: links as bars, joints as discs, the handle as a ring."
    return Chart("scene", model.device.name, alt, caption, drawing)


def _frame(frame: Frame) -> dict[str, Any]:
    return {"link": frame.link, "R": frame.rotation.ravel().tolist(), "p": frame.translation.tolist()}


def _closure(closure: AnyClosure) -> dict[str, Any]:
    """Loop closure for the page's script: constant rates and polynomials, or Newton's method from a closed pose."""
    base: dict[str, Any] = {"G": closure.constant.ravel().tolist(), "offset": closure.offset.tolist()}
    if isinstance(closure, FormulaClosure):
        base["polynomials"] = [
            [j, [[factor, [closure.symbols.index(x) for x in product]] for product, factor in polynomial.terms.items()]]
            for j, polynomial in closure.polynomials.items()
        ]
    if not isinstance(closure, NewtonClosure):
        return {"way": "direct", **base}
    start = {"at": closure.at.tolist(), "start": closure.start.tolist()}
    return {"way": "newton", **base, **start, "unknown": list(closure.unknown), "size": closure.chain.size}


def _trail(model: DynamicModel, qa: Array) -> dict[str, Any] | None:
    """Path of the handle along the first log, in the base frame."""
    if model.device.handle is None:
        return None
    return packed(handle_motion(model, qa).position)


def _mass(model: DynamicModel, beta: Array) -> dict[str, Any] | None:
    """Bodies and rotors with the model's inertia, for the apparent mass; None without a moving handle."""
    if model.device.handle is None or model.device.handle.link < 0:
        return None
    raw, links = rigid(model, raw_parameters(model, beta)), 10 * len(model.device.joints)
    rotors = [(k, term) for k, term in enumerate(model.terms) if term.kind == "rotor" and term.joint is None]
    if any(term.kind == "rotor" and term.joint is not None for term in model.terms):
        return None
    return {
        "bodies": raw[:links].tolist(),
        "rotors": [{"weights": term.weights.tolist(), "value": float(raw[links + k])} for k, term in rotors],
        "frame": model.device.row_map.ravel().tolist(),
        "moving": list(model.measured_rows),
        "worst": WORST_CONDITION,
    }
