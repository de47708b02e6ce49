"""A characterisation as columns of figures: what a table of it has, pose by pose."""

from __future__ import annotations

import csv
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from haptid._internal.arrays import Array
from haptid.end_effector.characterisation.characterise import Characterisation
from haptid.end_effector.characterisation.model import Figure
from haptid.errors import IncompleteDeviceError

# Names of the components of the handle's velocity.
COMPONENTS = ("x", "y", "z", "rx", "ry", "rz")


@dataclass(frozen=True)
class Asked:
    """What figures need beside the model.

    Attributes:
        along: direction of the handle's motion, (rows,), for friction, back-drive force and mass along it.
        speed: of the handle, for the force that a mass-friction-stiffness model leaves out, m/s.
        stiffness: of the coordinates that torque rows belong to, N m/rad or N/m.
        torque: greatest torque of each motor's coordinate by name, N m or N; the device's where left out.
    """

    along: tuple[float, ...] | None = None
    speed: float | None = None
    stiffness: tuple[float, ...] | None = None
    torque: Mapping[str, float] | None = None


@dataclass(frozen=True, eq=False)
class Column:
    """One quantity at all poses.

    Attributes:
        name: such as "apparent mass 1".
        figure: its values, (poses,), NaN where it is not known, with deviations where there are any.
    """

    name: str
    figure: Figure

    @property
    def heading(self) -> str:
        """Name and unit."""
        return self.name if self.figure.unit == "1" else f"{self.name} [{self.figure.unit}]"


def columns(found: Characterisation, asked: Asked | None = None) -> tuple[Column, ...]:
    """Every figure that the model and the device determine, (poses,) each.

    Raises:
        CharacterisationSettingError, ShapeError: a direction, or stiffnesses, that do not fit.
        TorqueLimitError: a torque limit that is asked for, of a motor that is not there.
    """
    return tuple(_columns(found, asked or Asked()))


def _columns(found: Characterisation, asked: Asked) -> Iterator[Column]:
    yield from _numbered("apparent mass", found.apparent_mass)
    yield Column("isotropy", found.isotropy)
    if found.grasp.spare:  # friction and weight at the handle are not determined
        return
    yield from _numbered("viscous friction", found.viscous_friction)
    names = [COMPONENTS[k] for k in found.grasp.rows]
    yield from _named("weight", found.weight, names)
    if asked.along is not None:
        yield from _along(found, asked.along, names)
    if asked.speed is not None:
        yield Column(f"neglected force at {asked.speed:g} m/s", found.neglected_force(asked.speed))
    if asked.stiffness is not None:
        yield from _numbered("stiffness", _plain(found.stiffness(asked.stiffness)[0], "N/m"))
    yield from _strength(found, asked)


def _along(found: Characterisation, along: ArrayLike, names: Sequence[str]) -> Iterator[Column]:
    yield Column("mass along", found.mass_along(along))
    yield Column("viscous friction along", found.viscous_along(along))
    yield from _named("Coulomb friction along", found.coulomb_friction(along), names)
    yield Column("back-drive force along", found.backdrive_force(along))


def _strength(found: Characterisation, asked: Asked) -> Iterator[Column]:
    """Greatest force of the motors, where their limits are known."""
    try:
        force = found.greatest_force(asked.torque)[0]
    except IncompleteDeviceError:
        if asked.torque is not None:
            raise
        return
    yield Column("greatest force in its worst direction", force)
    if asked.along is not None:
        yield Column("greatest force along", found.force_along(asked.along, asked.torque))


def _plain(values: Array, unit: str) -> Figure:
    """Figures without deviation: given stiffnesses and geometry alone, nothing that was identified."""
    return Figure(values, None, float("inf"), unit)


def _numbered(name: str, figure: Figure) -> Iterator[Column]:
    return _named(name, figure, [str(k + 1) for k in range(figure.value.shape[1])])


def _named(name: str, figure: Figure, names: Sequence[str]) -> Iterator[Column]:
    for k, one in enumerate(names):
        se = None if figure.se is None else figure.se[:, k]
        yield Column(f"{name} {one}", Figure(figure.value[:, k], se, figure.dof, figure.unit))


def write_columns(found: Characterisation, made: Sequence[Column], path: Path) -> None:
    """Write a CSV: a row for each pose; positions of joints and handle, condition number, figures with intervals."""
    model, grasp = found.model, found.grasp
    joints = [model.device.joints[j] for j in model.device.active]
    heads = [f"{joint.name} [{'m' if joint.prismatic else 'rad'}]" for joint in joints]
    heads += [*(f"handle {axis} [m]" for axis in "xyz"), "condition"]
    values = [*grasp.qa, *grasp.position.T, grasp.condition]
    for column in made:
        heads.append(column.heading)
        values.append(column.figure.value)
        if (interval := column.figure.interval95) is not None:
            heads += [f"{column.heading} low95", f"{column.heading} high95"]
            values += [*interval.T]
    with path.open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow(heads)
        table.writerows([repr(x) if np.isfinite(x) else "" for x in row] for row in np.array(values).T.tolist())
