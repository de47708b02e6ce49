"""Rows of a data sheet on the Z-width: the passive bound over the workspace, and what is stable at its median pose."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cached_property

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.dynamics.inverse import mass_matrix
from haptid.dynamics.kinematics import handle_motion
from haptid.dynamics.model import DynamicModel
from haptid.end_effector.characterisation import friction
from haptid.end_effector.characterisation.characterise import Characterisation
from haptid.end_effector.characterisation.model import GivenParameters, changing, covariance_factor
from haptid.end_effector.compensation import TYPICAL_HAND, Compensation, Feedback, HandModel, SampledLoop
from haptid.end_effector.datasheet.instruments import DeviceInstruments
from haptid.end_effector.datasheet.rows import SheetRow, over
from haptid.end_effector.datasheet.z_width import PUSH, StepDevice, stable_stiffness, stepped_stiffness
from haptid.uncertainty.quantities import Field, Quantities, covariance_root, half_width

_GROUP = "Z-width"
# Step of a difference quotient, in standard errors of the parameter that moves most.
_STEP = 0.5
# Change of a stiffness in a difference quotient, a share of it.
_SHARE = 1e-4


def z_width(found: Characterisation, axes: list[int], tools: DeviceInstruments) -> Iterator[SheetRow]:
    """The rows.

    Args:
        found: of the handle's point, or of point and rotation of a device with more than three joints.
        axes: components of `found` in which the handle can move.
        tools: rate, delay, encoders.
    """
    turning = [k for k in axes if k > 2]
    if len(found.handle.rows) > 3 and len(axes) < len(found.handle.rows):
        yield SheetRow(_GROUP, "passive stiffness", None, "N/m", f"the handle moves in {len(axes)} of 6 components")
        return
    if not found.viscous_friction.values.any():
        yield SheetRow(_GROUP, "passive stiffness", None, "N/m", "no viscous friction among the parameters")
        return
    dt, delay = 1 / tools.rate_hz, tools.delay
    yield SheetRow(_GROUP, "control period", dt, "s", f"and a delay of {delay:g} s; the rest at the median pose")
    factor = 1 / (dt / 2 + delay)
    law = "b / (T / 2 + delay), Colgate and Schenkel (1997)"
    free = ", rotations free" if turning else ""
    least = _scaled(least_damping(found, axes, [k for k in axes if k < 3]), factor, "N/m")
    yield over(_GROUP, "passive stiffness", least, law + free)
    if turning:
        about = _scaled(least_damping(found, axes, turning), factor, "N m/rad")
        yield over(_GROUP, "passive rotational stiffness", about, f"{law}, the handle's point free")
    order = np.argsort(np.where(np.isfinite(least.values), least.values, np.inf))
    at = int(order[int(np.isfinite(least.values).sum()) // 2])
    pose = _Pose(found, at, dt, delay)
    yield from pose.linear(least)
    yield from pose.stepped(tools, least)


def least_damping(found: Characterisation, axes: list[int], part: list[int]) -> Field:
    """Least damping b in some components while the other ones are free, (poses,), N s/m or N m s/rad; 0 at least.

    A spring k in the components E is passive with damping D of all where k (T / 2 + delay) E E' <= D, that is up to the
    least eigenvalue of (E' D^-1 E)^-1.

    Args:
        found: the handle.
        axes: components in which the handle can move.
        part: those of the spring.
    """
    usable, inside = found.handle.usable, [axes.index(k) for k in part]
    moving = list(found.handle.moving)

    def damping(beta: Array) -> Array:
        B = friction.viscous_matrix(found.model, beta, found.handle.qa[:, usable])[:, moving][:, :, moving]
        inverse = found.inverse[usable][:, :, axes]
        return np.asarray(inverse.mT @ B @ inverse)

    D = damping(found.identified.beta)
    definite = np.linalg.eigvalsh(D)[:, 0] > 0
    # Where D is not positive definite nothing is passive; the others are held, for an interval about zero.
    safe = np.where(definite[:, None, None], D, np.eye(len(axes)))
    E = np.eye(len(axes))[:, inside]
    S = np.linalg.inv((np.linalg.inv(safe))[:, inside][:, :, inside])
    S = np.where(definite[:, None, None], S, D[:, inside][:, :, inside])
    values, vectors = np.linalg.eigh(S)
    carried = np.where(definite[:, None, None], np.linalg.solve(safe, E @ S), E) @ vectors[:, :, :1]
    b = np.full(len(usable), np.nan)
    b[usable] = np.where(definite, values[:, 0], 0.0)

    def slope(change: Array) -> Array:
        made = np.full(len(usable), np.nan)
        made[usable] = (carried.mT @ damping(change) @ carried)[:, 0, 0]
        return made

    return changing(found.identified, b, slope, "")


def _scaled(field: Field, factor: float, unit: str) -> Field:
    return Field(field.values * factor, None if field.se is None else field.se * factor, field.dof, unit)


@dataclass(frozen=True, eq=False)
class _Pose:
    """Virtual springs at one pose.

    Attributes:
        found: the handle over the workspace.
        at: index of the pose.
        dt, delay: of the controller, s.
    """

    found: Characterisation
    at: int
    dt: float
    delay: float

    @cached_property
    def qa(self) -> Array:
        """The pose, (active, 1)."""
        return self.found.handle.qa[:, [self.at]]

    def loop(self, beta: Array) -> SampledLoop:
        """The sampled device without a spring, with other parameters."""
        known = GivenParameters(self.found.model, beta)
        loop = Compensation(known, 0.0, weight=0.0).loop(self.qa[:, 0], self.dt, self.delay)
        return replace(loop, stiffness=np.zeros_like(loop.stiffness))

    def linear(self, least: Field) -> Iterator[SheetRow]:
        """Of the device without dry friction: the passive bound again, by eigenvalues, and what is stable in a hand."""
        loop, damping = self.loop(self.found.identified.beta), float(least.values[self.at]) * (self.dt / 2 + self.delay)
        if damping > 0:
            # A wall of all components at once that is shaped like B reaches the passive bound in all directions.
            value = stable_stiffness(replace(loop, jacobian=np.eye(len(loop.inertia))), None, loop.viscous / damping)
            method = "of the sampled device without dry friction, wall shaped like B"
            ratio, ends = value / float(least.values[self.at]), least.conf_int()
            interval = None if ends is None else (float(ratio * ends[self.at, 0]), float(ratio * ends[self.at, 1]))
            yield SheetRow(_GROUP, "passive stiffness, simulated", value, "N/m", method, conf_int=interval)
        method = "no dry friction, a typical hand, Fu and Cavusoglu (2012)"
        value = stable_stiffness(loop, TYPICAL_HAND)
        row = SheetRow(_GROUP, "stable stiffness, linear, in a hand", value, "N/m", method)
        yield replace(row, conf_int=self._interval(value, TYPICAL_HAND)) if 0 < value < np.inf else row

    def _interval(self, value: float, hand: HandModel) -> tuple[float, float] | None:
        """Interval of the stiffest stable wall: dK = -(d radius / d beta) / (d radius / dK) at the bound."""
        known, J = self.found.identified, self.loop(self.found.identified.beta).jacobian
        if known.covariance is None:
            return None
        errors = np.sqrt(np.diag(known.covariance))

        def radius(beta: Array, K: float) -> float:
            loop = self.loop(beta)
            return replace(loop, feedback=(*loop.feedback, Feedback(K * J.T @ J, (1.0,)))).spectral_radius(hand)

        nominal, up = radius(known.beta, value), radius(known.beta, value * (1 + _SHARE))
        by_stiffness = (up - radius(known.beta, value * (1 - _SHARE))) / (2 * _SHARE * value)

        def slope(change: Array) -> Array:
            moved = change[errors > 0] / errors[errors > 0]
            h = _STEP / np.abs(moved).max() if moved.any() else 0.0
            return np.array([-(radius(known.beta + h * change, value) - nominal) / (h * by_stiffness) if h else 0.0])

        return _ends(changing(known, np.array([value]), slope, "N/m"), 0)

    def stepped(self, tools: DeviceInstruments, least: Field) -> Iterator[SheetRow]:
        """Along the direction of the largest mass, with dry friction and encoder steps, by time steps."""
        found = self.found
        inverse, moving = found.inverse[self.at], list(found.handle.moving)
        M = mass_matrix(found.model, found.identified.beta, self.qa)[0][moving][:, moving]
        direction = np.zeros(len(found.handle.rows))
        direction[:3] = np.linalg.eigh((inverse.T @ M @ inverse)[:3, :3])[1][:, -1]
        felt = self._felt(inverse @ direction)
        step = self._encoder_step(tools, direction)
        if step and felt.values[2] > 0:
            yield self._quantised(felt, step, least)
        held = ", rotation held" if len(found.handle.rows) > 3 else ""
        noise = " and encoder steps" if step else ""
        what = f"stepped with dry friction{noise}, a push of {PUSH:g} N{held}"
        for name, hand in (("free", None), ("in a hand", TYPICAL_HAND)):
            value = stepped_stiffness(self._device(felt.values, step), hand)
            row = SheetRow(_GROUP, f"stable stiffness, {name}", value, "N/m", what)
            if value == 0:
                yield row
            elif np.isfinite(value):
                yield replace(row, conf_int=self._stepped_interval(felt, step, hand, value))
            else:
                yield replace(row, value=None, method=f"above 1e6 N/m: {what}")

    def _felt(self, rates: Array) -> Quantities:
        """Mass, damping and dry friction along a line of the handle, from rates of the moving coordinates, (n,)."""
        model, known, moving = self.found.model, self.found.identified, list(self.found.handle.moving)
        whole = self.found.handle.all_rates(np.broadcast_to(rates, (len(self.found.handle), len(rates))))[:, :1]

        def of(beta: Array) -> Array:
            M, B = mass_matrix(model, beta, self.qa)[0], friction.viscous_matrix(model, beta, self.qa)[0]
            dry = friction.dry_torque(model, beta, self.qa, whole)[moving, 0]
            parts = (x[moving][:, moving] for x in (M, B))
            return np.array([*(float(rates @ part @ rates) for part in parts), float(rates @ dry)])

        spread = changing(known, of(known.beta), of, "")
        factor = covariance_factor(known)
        covariance = np.zeros((3, 3))
        if factor is not None:
            columns = np.array([of(column) for column in factor.T]).T
            covariance = columns @ columns.T
        names, units = ("mass", "damping", "dry friction"), ("kg", "N s/m", "N")
        unbounded = (0, 1, 2) if known.single_block else ()
        return Quantities(names, units, spread.values, covariance, np.full(3, spread.dof), unbounded)

    def _encoder_step(self, tools: DeviceInstruments, direction: Array) -> float:
        """Largest step of the handle along a direction by one step of an encoder, m; 0 where these are not known."""
        steps = handle_steps(self.found.model, tools, self.qa)
        return 0.0 if steps is None else float(np.abs(direction[:3] @ steps[0, :3]).max())

    def _quantised(self, felt: Quantities, step: float, least: Field) -> SheetRow:
        bounds = float(least.values[self.at]), float(2 * felt.values[2] / step)
        known = self.found.identified.covariance is not None
        by_friction = (float(2 * end / step) for end in felt.conf_int()[2])
        ends = _ends(least, self.at) if bounds[0] < bounds[1] else (next(by_friction), next(by_friction))
        method = "and at most 2 Fc / step, Abbott and Okamura (2005)"
        name = "passive stiffness, quantised"
        return SheetRow(_GROUP, name, min(bounds), "N/m", method, conf_int=ends if known else None)

    def _device(self, felt: Array, step: float) -> StepDevice:
        mass, damping, dry = felt.tolist()
        return StepDevice(mass, max(damping, 0.0), max(dry, 0.0), step, self.dt, self.delay)

    def _stepped_interval(
        self, felt: Quantities, step: float, hand: HandModel | None, value: float
    ) -> tuple[float, float] | None:
        """From the stiffness at both ends of each direction of the covariance, half of their difference at a time."""
        if self.found.identified.covariance is None or felt.unbounded:
            return None
        changes = covariance_root(felt.covariance) * float(half_width(1.0, felt.dof[0]))
        ends = [
            [stepped_stiffness(self._device(felt.values + sign * change, step), hand, value) for sign in (-1.0, 1.0)]
            for change in changes.T
            if felt.values[0] > abs(change[0])
        ]
        half = float(np.sqrt(np.sum([((high - low) / 2) ** 2 for low, high in ends])))
        return (value - half, value + half) if np.isfinite(half) else None


def handle_steps(model: DynamicModel, tools: DeviceInstruments, qa: Array) -> Array | None:
    """Motion of the handle by one step of each encoder, (poses, 6, motors), m and rad; None where one is not known.

    Of redundant motors the positions of the joints are the least squares of all encoders.
    """
    steps = tools.position_steps(model)
    if steps is None:
        return None
    jacobian = handle_motion(model, qa).jacobian
    if not model.device.redundant:
        return np.asarray(jacobian @ model.device.active_from_drives[:, model.device.driven] * steps)
    B = model.device.drive_jacobian(model.device.row_map @ qa)
    B = np.broadcast_to(B if B.ndim == 3 else B[None], (qa.shape[1], *B.shape[-2:]))[:, model.device.driven]
    return np.asarray(jacobian @ np.linalg.pinv(B) * steps)


def _ends(field: Field, at: int) -> tuple[float, float] | None:
    ends = field.conf_int()
    return None if ends is None else (float(ends[at, 0]), float(ends[at, 1]))
