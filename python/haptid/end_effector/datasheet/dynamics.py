"""Rows of a data sheet that need parameters: inertia, friction, weight and forces."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cached_property

import numpy as np

from haptid._internal.arrays import Array
from haptid.dynamics.inverse import inverse_dynamics
from haptid.end_effector.characterisation.characterise import Characterisation, characterise
from haptid.end_effector.characterisation.friction import force_at_handle
from haptid.end_effector.characterisation.jacobian import LINEAR
from haptid.end_effector.characterisation.model import IdentifiedModel, changing
from haptid.end_effector.datasheet.instruments import DeviceInstruments
from haptid.end_effector.datasheet.rows import SheetRow, over
from haptid.end_effector.datasheet.z_rows import z_width
from haptid.end_effector.force import WORST_CONDITION
from haptid.uncertainty.quantities import Field

# A direction in which the handle moves: this share of it is in the range of the Jacobian.
_WITHIN = 0.99
# Worst condition of a Jacobian with rows in m and in rad, whose sizes differ by a tenth of a metre or so besides.
_WORST_OF_BOTH = 10 * WORST_CONDITION


class Dynamics:
    """Figures that need parameters, along the base axes in which the handle can move.

    With more than three joints, principal masses and forces in the worst direction are those of the handle's point with
    rotations free, and of its rotation with the point free; figures along and about axes have the others held.
    """

    def __init__(self, known: IdentifiedModel, qa: Array, tools: DeviceInstruments) -> None:
        self.known, self.model, self.tools, self.qa = known, known.model, tools, qa
        self.rotating = len(self.model.measured_rows) > 3
        self.found = characterise(known, qa, *((tuple(range(6)), _WORST_OF_BOTH) if self.rotating else (LINEAR,)))
        J = self.found.handle.jacobian[self.found.handle.usable]
        inside = np.einsum("pij,pji->pi", J, np.linalg.pinv(J)).mean(axis=0) if len(J) else np.zeros(0)
        self.axes = [k for k in range(len(inside)) if inside[k] > _WITHIN]

    @cached_property
    def parts(self) -> list[tuple[str, Characterisation, tuple[str, str, str, str]]]:
        """Of the point and of the rotation: what is free besides, the handle, words and units of mass and force."""
        made = [(", rotations free" if self.rotating else "", self.found, ("effective mass", "kg", "force", "N"))]
        if self.rotating:
            point, turned = (characterise(self.known, self.qa, rows) for rows in (LINEAR, (3, 4, 5)))
            words = ("rotational inertia", "kg m^2", "moment", "N m")
            made = [(made[0][0], point, made[0][2]), (", the handle's point free", turned, words)]
        return made

    def rows(self) -> Iterator[SheetRow]:
        """All rows."""
        yield from self._inertia()
        yield from self._friction()
        yield from self._forces()
        if self.axes:
            yield from z_width(self.found, self.axes, self.tools)

    def _unit(self, k: int) -> Array:
        made: Array = np.eye(len(self.found.handle.rows))[k]
        return made

    @staticmethod
    def _named(what: str, k: int) -> str:
        return f"{what} {'along' if k < 3 else 'about'} {'xyz'[k % 3]}"

    def _inertia(self) -> Iterator[SheetRow]:
        group = "Inertia"
        for free, found, (word, unit, _, _) in self.parts:
            mass = found.apparent_mass
            for name, k in (("largest", 0), ("smallest", mass.values.shape[1] - 1)):
                part = Field(mass.values[:, k], None if mass.se is None else mass.se[:, k], mass.dof, unit)
                yield over(group, f"{name} {word}", part, f"principal value of (J A^-1 J^T)^-1{free}")
            isotropy = replace(found.isotropy, unit="")
            yield over(group, f"isotropy of the {word.split()[-1]}", isotropy, f"smallest over largest {word}{free}")
        for k in self.axes:
            made = replace(self.found.mass_along(self._unit(k)), unit="kg" if k < 3 else "kg m^2")
            what = "effective mass" if k < 3 else "rotational inertia"
            yield over(group, self._named(what, k), made, "none across: other components held")

    def _friction(self) -> Iterator[SheetRow]:
        group = "Friction and weight"
        rubs = any(self.found.coulomb_friction(self._unit(k)).values.any() for k in self.axes)
        if not rubs:
            yield SheetRow(group, "back-drive friction", None, "N", "no dry friction among the parameters")
        for k in self.axes if rubs else ():
            force = self._rubbing(k)
            yield over(group, self._named("back-drive friction", k), force, "dry friction of slow motion, J^-T Fc sign")
        yield over(group, "weight at the handle", self._weight(), "gravity, springs and offsets")

    def _rubbing(self, k: int) -> Field:
        """Back-drive friction along an axis, (poses,)."""
        force = self.found.coulomb_friction(self._unit(k))
        se = None if force.se is None else force.se[:, k]
        return Field(force.values[:, k], se, force.dof, "N" if k < 3 else "N m")

    def _weight(self) -> Field:
        """Length of the force that carries the device, (poses,), N."""
        known, found, still = self.known, self.found, np.zeros_like(self.qa)

        def force(beta: Array) -> Array:
            static = inverse_dynamics(self.model, beta, self.qa, still, still)
            return force_at_handle(found.handle, found.inverse, static)[:, :3]

        at = force(known.beta)
        size = np.linalg.norm(at, axis=1)
        along = at / np.where(size > 0, size, 1.0)[:, None]
        return changing(known, size, lambda change: np.einsum("pi,pi->p", along, force(change)), "N")

    def _forces(self) -> Iterator[SheetRow]:
        group = "Force"
        for what in ("peak", "continuous"):
            limits = self.tools.of(self.model, what)
            if limits is None:
                yield SheetRow(group, f"{what} force", None, "N", f"{what}_torque of the motors is not known")
                continue
            for free, found, (_, _, word, unit) in self.parts:
                force = replace(found.greatest_force(limits)[0], unit=unit)
                method = f"worst direction, motors carry the weight{free.replace('free', 'without load')}"
                yield over(group, f"{what} {word}", force, method)
            for k in self.axes:
                along = replace(self.found.force_along(self._unit(k), limits), unit="N" if k < 3 else "N m")
                name = self._named(f"{what} {'force' if k < 3 else 'moment'}", k)
                yield over(group, name, along, "until the first motor is at its limit")
        yield from self._dynamic_range()
        yield from self._force_resolution()

    def _dynamic_range(self) -> Iterator[SheetRow]:
        group, limits = "Force", self.tools.of(self.model, "peak")
        if limits is None:
            return
        found = self.parts[0][1]
        peak, mass = found.greatest_force(limits)[0], found.apparent_mass
        rubbing = [self._rubbing(k) for k in self.axes if k < 3]
        worst = np.max([field.values for field in rubbing], axis=0) if rubbing else np.zeros(0)
        if worst.any():
            which = np.argmax([field.values for field in rubbing], axis=0)
            ses = [field.se for field in rubbing if field.se is not None]
            se = np.choose(which, ses) if ses else None
            method = "peak force over largest back-drive friction"
            made = _ratio(peak, Field(np.where(worst > 0, worst, np.nan), se, rubbing[0].dof, "N"), "")
            yield over(group, "dynamic range", made, method)
        largest = Field(mass.values[:, 0], None if mass.se is None else mass.se[:, 0], mass.dof, "kg")
        yield over(group, "peak acceleration", _ratio(peak, largest, "m/s^2"), "peak force over largest mass")

    def _force_resolution(self) -> Iterator[SheetRow]:
        group, steps = "Force", self.tools.of(self.model, "torque_step")
        if steps is None:
            yield SheetRow(group, "force resolution", None, "N", "torque_step of the motors is not known")
            return
        torque = np.array([steps[motor.name] for motor in self.model.device.motors])
        B = self.model.device.drive_jacobian(self.model.device.row_map @ self.qa)
        rows = np.swapaxes(B, -1, -2)[..., list(self.found.handle.moving), :][..., self.model.device.driven] * torque
        wrench = np.swapaxes(self.found.inverse, 1, 2) @ rows
        for _, _, (_, _, word, unit) in self.parts:
            part = wrench[:, 3:] if word == "moment" else wrench[:, :3]
            size = Field(np.linalg.norm(part, axis=1).max(axis=1), None, np.inf, unit)
            yield over(group, f"{word} resolution", size, "J^-T B^T times one step of a motor")


def _ratio(top: Field, bottom: Field, unit: str) -> Field:
    """A quotient; its standard error takes both as independent, which is wider where both depend on the same."""
    value = top.values / bottom.values
    if top.se is None or bottom.se is None:
        return Field(value, None, top.dof, unit)
    # Not by relative errors: the top is zero where the motors do not carry the weight.
    se = np.hypot(top.se, value * bottom.se) / np.abs(bottom.values)
    return Field(value, se, min(top.dof, bottom.dof), unit)
