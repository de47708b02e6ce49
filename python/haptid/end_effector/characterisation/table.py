"""A characterisation as a table: its quantities pose by pose, and their CSV file."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from haptid._internal.escaping import write_csv
from haptid._internal.late import dataclass
from haptid.end_effector.characterisation.characterise import Characterisation
from haptid.errors import IncompleteDeviceError
from haptid.uncertainty.quantities import Field

# Names of the components of the handle's velocity.
_COMPONENTS = ("x", "y", "z", "rx", "ry", "rz")


@dataclass(frozen=True)
class TableRequest:
    """Settings of quantities that depend on more than the model.

    Attributes:
        along: direction of the handle's motion, (rows,), for friction, back-drive force and mass along it.
        speed: of the handle, for the force that a mass-friction-stiffness model neglects, m/s.
        stiffness: of the torque rows' coordinates, N m/rad or N/m.
        torque: torque limit of each motor's coordinate by name, N m or N; the device's where left out.
    """

    along: tuple[float, ...] | None = None
    speed: float | None = None
    stiffness: tuple[float, ...] | None = None
    torque: Mapping[str, float] | None = None


@dataclass(frozen=True, eq=False)
class TableColumn:
    """One quantity at all poses.

    Attributes:
        name: such as "apparent mass 1".
        figure: its values, (poses,), NaN where unknown, with standard errors where there are any.
    """

    name: str
    figure: Field

    @property
    def heading(self) -> str:
        """Name and unit."""
        return self.name if self.figure.unit == "1" else f"{self.name} [{self.figure.unit}]"


def table_columns(found: Characterisation, request: TableRequest | None = None) -> tuple[TableColumn, ...]:
    """Every quantity that the model and the device determine, (poses,) each.

    Raises:
        SettingError, ShapeError: a direction, or stiffnesses, that do not fit.
        IncompleteDeviceError, UnknownNameError: a torque limit is not positive, or of an unknown motor.
    """
    return tuple(_columns(found, request or TableRequest()))


def _columns(found: Characterisation, request: TableRequest) -> Iterator[TableColumn]:
    yield from _numbered("apparent mass", found.apparent_mass)
    yield TableColumn("isotropy", found.isotropy)
    if found.handle.redundancy:  # friction and weight at the handle are not determined
        return
    yield from _numbered("viscous friction", found.viscous_friction)
    names = [_COMPONENTS[k] for k in found.handle.rows]
    yield from _named("weight", found.weight, names)
    if request.along is not None:
        yield from _along(found, request.along, names)
    if request.speed is not None:
        yield TableColumn(f"neglected force at {request.speed:g} m/s", found.neglected_force(request.speed))
    if request.stiffness is not None:
        yield from _numbered("stiffness", Field(found.stiffness(request.stiffness)[0], None, np.inf, "N/m"))
    yield from _force_capability(found, request)


def _along(found: Characterisation, along: ArrayLike, names: Sequence[str]) -> Iterator[TableColumn]:
    yield TableColumn("mass along", found.mass_along(along))
    yield TableColumn("viscous friction along", found.viscous_along(along))
    yield from _named("Coulomb friction along", found.coulomb_friction(along), names)
    yield TableColumn("back-drive force along", found.backdrive_force(along))


def _force_capability(found: Characterisation, request: TableRequest) -> Iterator[TableColumn]:
    """Largest force of the motors, where their limits are known."""
    try:
        force = found.greatest_force(request.torque)[0]
    except IncompleteDeviceError:
        if request.torque is not None:
            raise
        return
    yield TableColumn("greatest force in its worst direction", force)
    if request.along is not None:
        yield TableColumn("greatest force along", found.force_along(request.along, request.torque))


def _numbered(name: str, figure: Field) -> Iterator[TableColumn]:
    return _named(name, figure, [str(k + 1) for k in range(figure.values.shape[1])])


def _named(name: str, figure: Field, names: Sequence[str]) -> Iterator[TableColumn]:
    for k, one in enumerate(names):
        se = None if figure.se is None else figure.se[:, k]
        yield TableColumn(f"{name} {one}", Field(figure.values[:, k], se, figure.dof, figure.unit))


def write_columns(found: Characterisation, made: Sequence[TableColumn], path: Path) -> None:
    """Write a CSV, a row for each pose: joint and handle positions, condition number, quantities with intervals."""
    model, handle = found.model, found.handle
    joints = [model.device.joints[j] for j in model.device.active]
    heads = [f"{joint.name} [{'m' if joint.prismatic else 'rad'}]" for joint in joints]
    heads += [*(f"handle {axis} [m]" for axis in "xyz"), "condition"]
    values = [*handle.qa, *handle.position.T, handle.condition]
    for column in made:
        heads.append(column.heading)
        values.append(column.figure.values)
        if (interval := column.figure.conf_int()) is not None:
            heads += [f"{column.heading} ci_low", f"{column.heading} ci_high"]
            values += [*interval.T]
    rows = ([repr(x) if np.isfinite(x) else "" for x in row] for row in np.array(values).T.tolist())
    write_csv(path, [heads, *rows])
