"""Apparent mass, isotropy, viscous friction and weight at the handle, as slices of the workspace."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any, ClassVar

import numpy as np

from haptid._internal.arrays import Array, freeze_fields
from haptid._internal.late import dataclass
from haptid.end_effector.characterisation import Characterisation, GivenParameters, characterise
from haptid.errors import RedundancyError, SettingError
from haptid.report.chart import Chart, figure, packed
from haptid.report.section import Section
from haptid.report.sections.mechanism import poses_of, sliders_of
from haptid.report.source import ReportSource

# Cells of a slice along each joint, and slices through the third joint.
CELLS, SLICES = 25, 5
# Poses along each joint alone, to rank the joints.
ALONG = 15
# Above this ratio of maximum to minimum the colour scale is logarithmic.
WIDE = 20.0

Pick = Callable[[Characterisation], Array]
_FIGURES: tuple[tuple[str, str, str, Pick], ...] = (
    ("mass", "Largest apparent mass", "kg", lambda made: made.apparent_mass.values[:, 0]),
    ("isotropy", "Isotropy: smallest over largest mass", "", lambda made: made.isotropy.values),
    ("viscous", "Largest viscous friction", "N s/m", lambda made: made.viscous_friction.values[:, 0]),
    ("weight", "Weight at the handle", "N", lambda made: np.linalg.norm(made.weight.values, axis=1)),
)


@dataclass(frozen=True)
class MapsSection(Section):
    """Maps.

    Attributes:
        about: sentences on what is shown and what is unknown.
    """

    key: ClassVar[str] = "maps"
    title: ClassVar[str] = "End-effector maps"
    about: list[str]

    @classmethod
    def of(cls, source: ReportSource) -> MapsSection | None:
        model = source.estimate.model
        if model.device.handle is None or model.device.handle.link < 0 or len(model.device.active) < 2:
            return None
        try:
            slices = slices_of(source.model, sliders_of(model, poses_of(source)))
        except SettingError:  # friction or rotors whose rates vary with the pose
            return None
        charts = tuple(_charts(model.device.name, slices))
        return cls(charts=charts, about=[slices.about]) if charts else None


@dataclass(frozen=True, eq=False)
class Slices:
    """Poses over two joints, at some positions of a third.

    Attributes:
        labels: of the two joints, with units.
        x, y: their positions, (CELLS,).
        third: name of the third joint, empty where there is none.
        names: of the slices.
        known: characterisation of each slice, at poses where the loops close.
        closes: which poses of a slice those are, y changing slowest, (CELLS^2,) each.
        about: a sentence.
    """

    labels: tuple[str, str]
    x: Array
    y: Array
    third: str
    names: tuple[str, ...]
    known: tuple[Characterisation, ...]
    closes: tuple[np.ndarray, ...]
    about: str

    def __post_init__(self) -> None:
        freeze_fields(self, x=(CELLS,), y=(CELLS,))

    def values(self, pick: Pick) -> list[Array]:
        """A figure on each slice, NaN where it is unknown, (CELLS^2,) each.

        Raises:
            RedundancyError: the figure is not determined at the handle.
        """
        made = []
        for characterisation, closes in zip(self.known, self.closes, strict=True):
            values = np.full(CELLS**2, np.nan)
            values[closes] = pick(characterisation)
            made.append(values)
        return made


def slices_of(identified: GivenParameters, sliders: Sequence[dict[str, Any]]) -> Slices:
    """Slices over the two joints that change the mass most, the first of them upwards, through the third.

    Raises:
        SettingError: the device cannot be characterised.
    """
    order = ranked(identified, sliders)
    y, x = (sliders[k] for k in order[:2])
    third = sliders[order[2]] if len(order) > 2 else None
    ends = [(third["low"], third["high"])] if third else []
    depths = [np.linspace(low, high, SLICES + 2)[1:-1] for low, high in ends] or [np.array([np.nan])]
    axes = [np.linspace(s["low"], s["high"], CELLS) for s in (x, y)]
    grids = [_grid(sliders, order, axes, float(depth)) for depth in depths[0]]
    closes = [np.asarray(identified.model.device.closure.closes(qa)) for qa in grids]
    known = [characterise(identified, qa[:, ok]) for qa, ok in zip(grids, closes, strict=True)]
    rest = [f"{sliders[k]['name']} = {sliders[k]['start']:.3g} {sliders[k]['unit']}" for k in sorted(order[3:])]
    usable, poses = (
        sum(int(characterisation.handle.usable.sum()) for characterisation in known),
        sum(len(qa.T) for qa in grids),
    )
    return Slices(
        labels=(f"joint {x['name']}, {x['unit']}", f"joint {y['name']}, {y['unit']}"),
        x=axes[0],
        y=axes[1],
        third=f"joint {third['name']}" if third else "",
        names=tuple(f"joint {third['name']} = {depth:.3g} {third['unit']}" if third else "all" for depth in depths[0]),
        known=tuple(known),
        closes=tuple(closes),
        about=f"{usable} of {poses} poses are shown: at the others loops do not close, or the handle's Jacobian is "
        f"nearly singular." + (f" The other joints stay at {', '.join(rest)}." if rest else ""),
    )


def ranked(identified: GivenParameters, sliders: Sequence[dict[str, Any]]) -> list[int]:
    """Joints by the change of the largest apparent mass along each alone, largest change first."""
    start = np.array([s["start"] for s in sliders])
    changes = []
    for k, slider in enumerate(sliders):
        qa = np.repeat(start[:, None], ALONG, axis=1)
        qa[k] = np.linspace(slider["low"], slider["high"], ALONG)
        mass = characterise(identified, qa[:, identified.model.device.closure.closes(qa)]).apparent_mass.values[:, 0]
        known = np.log(mass[np.isfinite(mass)])
        changes.append(round(float(np.ptp(known)), 9) if known.size else 0.0)
    return sorted(range(len(sliders)), key=lambda k: -changes[k])


def _grid(sliders: Sequence[dict[str, Any]], order: Sequence[int], axes: list[Array], depth: float) -> Array:
    """Poses of one slice, the upward joint's position changing slowest, (active, CELLS^2)."""
    qa = np.repeat(np.array([s["start"] for s in sliders])[:, None], CELLS**2, axis=1)
    vertical, across = np.meshgrid(axes[1], axes[0], indexing="ij")
    qa[order[0]], qa[order[1]] = vertical.ravel(), across.ravel()
    if len(order) > 2:
        qa[order[2]] = depth
    return qa


def _charts(model: str, slices: Slices) -> Iterator[Chart]:
    """A map for each figure that is defined for this device."""
    for key, title, unit, pick in _FIGURES:
        try:
            layers = slices.values(pick)
        except RedundancyError:
            continue
        if np.isfinite(layers).any():
            yield _map(model, key, title, unit, slices, layers)


def _map(model: str, key: str, title: str, unit: str, slices: Slices, layers: list[Array]) -> Chart:
    every = np.concatenate(layers)
    low, high = float(np.nanmin(every)), float(np.nanmax(every))
    middle = float(np.nanmedian(every))
    caption = (
        f"From {figure(low)} {unit} ({_place(slices, int(np.nanargmin(every)))}) to {figure(high)} {unit} "
        f"({_place(slices, int(np.nanargmax(every)))}), {figure(middle)} {unit} at the median. Grey: unknown."
    ).replace("  ", " ")
    drawing = {
        "kind": "heat",
        "rows": [f"{value:.2f}" for value in slices.y],
        "columns": [f"{value:.2f}" for value in slices.x],
        "x": slices.labels[0],
        "y": slices.labels[1],
        "upwards": True,
        "ramp": "sequential",
        "log": low > 0 and high > WIDE * low,
        "low": low,
        "high": high,
        "unit": unit,
        "layers": [
            {"name": name, "values": packed(values), "marks": _marks(values)}
            for name, values in zip(slices.names, layers, strict=True)
        ],
        "slice": slices.third,
    }
    alt = f"Map of the {title.lower()} of {model} over {' and '.join(slices.labels)}, {len(layers)} slices."
    return Chart(f"map-{key}", title, alt, caption, drawing)


def _marks(values: Array) -> list[dict[str, Any]]:
    """Minimum and maximum of a slice."""
    if not np.isfinite(values).any():
        return []
    picks = (("least", int(np.nanargmin(values))), ("greatest", int(np.nanargmax(values))))
    return [{"name": name, "row": k // CELLS, "column": k % CELLS} for name, k in picks]


def _place(slices: Slices, k: int) -> str:
    """Position of a cell, as text."""
    cell, name = k % CELLS**2, slices.names[k // CELLS**2]
    x, y = (label.split(", ")[0] for label in slices.labels)
    place = f"{x} = {slices.x[cell % CELLS]:.2f}, {y} = {slices.y[cell // CELLS]:.2f}"
    return f"{place}, {name}" if slices.third else place
