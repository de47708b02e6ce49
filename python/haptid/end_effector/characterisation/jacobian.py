"""Poses of a characterisation, the handle's Jacobian at each, and which of them are left out."""

from __future__ import annotations

import numpy as np

from haptid._internal.arrays import Array, expect, freeze, freeze_fields, positive
from haptid._internal.late import dataclass
from haptid.dynamics.kinematics import handle_motion, handle_of
from haptid.dynamics.model import DynamicModel
from haptid.errors import RedundancyError, setting_error

LINEAR = (0, 1, 2)
# Poses evaluated at a time.
_CHUNK = 50_000


@dataclass(frozen=True, eq=False)
class HandleJacobian:
    """Poses, and the handle's Jacobian by the coordinates with measured torque; the others are constrained.

    Attributes:
        qa: positions of the active joints, (active, poses), rad or m.
        rows: components of the handle's velocity in the base frame: 0 to 2 linear, 3 to 5 angular, (m,).
        moving: coordinates that move, (n,).
        position: of the handle, (poses, 3), m.
        jacobian: (poses, m, n).
        condition: number of the Jacobian, infinite where it is singular, (poses,).
        worst: condition number beyond which a pose is left out.
    """

    model: DynamicModel
    qa: Array
    rows: tuple[int, ...]
    moving: tuple[int, ...]
    position: Array
    jacobian: Array
    condition: Array
    worst: float

    def __post_init__(self) -> None:
        poses, m, n = self.qa.shape[1], len(self.rows), len(self.moving)
        freeze_fields(self, "qa", position=(poses, 3), jacobian=(poses, m, n), condition=(poses,))

    def __len__(self) -> int:
        return int(self.qa.shape[1])

    @property
    def usable(self) -> np.ndarray:
        """Whether the Jacobian of each pose is invertible within the limit, (poses,)."""
        return np.asarray(self.condition <= self.worst)

    @property
    def redundancy(self) -> int:
        """Degree of redundancy: more coordinates than rows, so the handle's motion does not determine theirs."""
        return max(0, len(self.moving) - len(self.rows))

    def inverse(self, quantity: str) -> Array:
        """Rates of the moving coordinates from the handle's velocity, (poses, n, m); NaN at poses left out.

        With fewer coordinates than rows it takes the part of a velocity that the handle can have.

        Raises:
            RedundancyError: more coordinates than rows, so that `quantity` is not determined.
        """
        if self.redundancy:
            raise RedundancyError(
                f"{quantity} is not determined: {len(self.moving)} joints move {len(self.rows)} components of the "
                "handle's velocity.",
                where=quantity,
                found=len(self.moving),
                limit=len(self.rows),
                advice="Choose more rows; apparent mass and force capability are determined all the same.",
            )
        made = np.full((len(self), len(self.moving), len(self.rows)), np.nan)
        made[self.usable] = np.linalg.pinv(self.jacobian[self.usable])
        return freeze(made)

    def all_rates(self, rates: Array) -> Array:
        """Rates of all coordinates, (coordinates, poses), from those of the moving ones, (poses, n)."""
        made = np.zeros((len(self.model.device.active), len(self)))
        made[list(self.moving)] = rates.T
        return made


def handle_jacobian(model: DynamicModel, qa: Array, rows: tuple[int, ...], worst: float) -> HandleJacobian:
    """The handle at these poses.

    Raises:
        IncompleteDeviceError: the device has no handle.
        SettingError: a setting out of range.
        ShapeError: the poses do not fit the device.
    """
    check_pose_settings(model, qa, rows, worst)
    moving = model.measured_rows
    parts = [handle_motion(model, qa[:, k : k + _CHUNK]) for k in range(0, max(qa.shape[1], 1), _CHUNK)]
    jacobian = np.concatenate([part.row_jacobian[:, list(rows)][:, :, list(moving)] for part in parts])
    singular = np.linalg.svd(jacobian, compute_uv=False)
    with np.errstate(divide="ignore", invalid="ignore"):
        condition = np.where(singular[:, -1] > 0, singular[:, 0] / singular[:, -1], np.inf)
    position = np.concatenate([part.position for part in parts])
    return HandleJacobian(model, qa, rows, moving, position, jacobian, condition, worst)


def check_pose_settings(model: DynamicModel, qa: Array, rows: tuple[int, ...], worst: float) -> None:
    """Check the settings of a characterisation.

    Raises:
        IncompleteDeviceError: the device has no handle.
        SettingError: a setting out of range, or a position that is not finite.
        ShapeError: the poses do not fit the device.
    """
    expect("qa", qa.shape, (len(model.device.active), None))
    if not np.isfinite(qa).all():
        raise setting_error("qa", float("nan"), "finite positions")
    if handle_of(model).link < 0:
        raise setting_error("handle.link", "base", "a link that moves")
    for term in model.terms:
        if term.kind == "rotor" and term.joint is not None:
            wanted = "rotors on joints with constant rates; a rotor elsewhere may be part of its link's ZZ"
            raise setting_error(f"term {term.name}", term.on, wanted)
    if not rows or len(set(rows)) < len(rows) or not set(rows) <= set(range(6)):
        raise setting_error("rows", rows, "different numbers of 0 to 5")
    if not (positive(worst) and worst > 1):
        raise setting_error("worst_condition", worst, "a finite number above 1")
