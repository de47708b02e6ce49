"""Workspace of a device: limits of joints, of their combinations, and of the handle's position."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from numbers import Real

import numpy as np
from numpy.typing import ArrayLike

from haptid._internal.arrays import Array, expect, freeze, freeze_fields
from haptid._internal.late import dataclass
from haptid.dynamics.kinematics import handle_motion, handle_of, tree_positions
from haptid.dynamics.model import DynamicModel
from haptid.errors import IncompleteDeviceError, WorkspaceError

_Range = tuple[float, float]
# Cells of a grid over the joints' limits, including those outside other limits.
_POSES = 120_000


@dataclass(frozen=True)
class Box:
    """Limits of the handle's origin in the base frame.

    Attributes:
        low, high: corners, (3,), m.
    """

    low: tuple[float, float, float]
    high: tuple[float, float, float]

    def __post_init__(self) -> None:
        for name in ("low", "high"):
            if np.shape(getattr(self, name)) != (3,):
                raise _workspace_limit(f"box {name}", getattr(self, name), "three numbers: x, y, z in m")
        for axis, low, high in zip("xyz", self.low, self.high, strict=True):
            _ascending(f"box {axis}", (low, high))


@dataclass(frozen=True, eq=False)
class Workspace:
    """Poses of a device inside all of its limits; see `workspace`.

    Attributes:
        limits: of every active joint, (active, 2), rad or m.
        coupled: indices of the passive joints that have limits.
        ranges: of their positions, (couplings, 2), rad or m.
        box: of the handle's origin, None for no limit.
    """

    model: DynamicModel
    limits: Array
    coupled: tuple[int, ...]
    ranges: Array
    box: Box | None

    def __post_init__(self) -> None:
        freeze_fields(self, limits=(len(self.model.device.active), 2), ranges=(len(self.coupled), 2))
        if self.box is not None:
            handle_of(self.model)

    @property
    def couplings(self) -> tuple[str, ...]:
        """Names of the passive joints that have limits."""
        return tuple(self.model.device.joint_names[j] for j in self.coupled)

    def slack(self, qa: ArrayLike) -> Array:
        """Distance of every pose from each limit, negative outside, (limits, samples), rad or m.

        -inf at poses where loops do not close.

        Args:
            qa: positions of the active joints, (active, samples), rad or m.
        """
        qa = np.asarray(qa, dtype=float)
        expect("qa", qa.shape, (len(self.model.device.active), None))
        closed = self.model.device.closure.closes(qa)
        q = qa[:, closed]
        pairs = [(q, self.limits), (tree_positions(self.model, q)[list(self.coupled)], self.ranges)]
        if self.box is not None:
            position = handle_motion(self.model, q).position.T
            pairs.append((position, np.column_stack([self.box.low, self.box.high])))
        slack = np.full((2 * sum(len(x) for x, _ in pairs), qa.shape[1]), -np.inf)
        slack[:, closed] = np.concatenate([side for x, r in pairs for side in (x - r[:, :1], r[:, 1:] - x)])
        return slack

    def holds(self, qa: ArrayLike) -> np.ndarray:
        """Whether each pose is inside all limits, (samples,)."""
        return np.asarray((self.slack(qa) >= 0).all(axis=0))

    def grid(self, poses: int = _POSES) -> Array:
        """Poses inside all limits, at the centres of equal cells over the joints' limits, (active, samples), rad or m.

        Args:
            poses: most cells.

        Raises:
            WorkspaceError: no cell's centre is inside.
        """
        per_joint = max(1, int(poses ** (1 / len(self.limits)) + 1e-9))
        centres = (np.arange(per_joint) + 0.5) / per_joint
        axes = [low + (high - low) * centres for low, high in self.limits]
        every = np.array([axis.ravel() for axis in np.meshgrid(*axes, indexing="ij")])
        inside = every[:, self.holds(every)]
        if not inside.size:
            raise WorkspaceError(
                f"none of {every.shape[1]} grid poses over the joints' limits is inside all limits of the workspace.",
                found=every.shape[1],
                advice="Widen the coupling limits or the box of the handle, or check their signs and units (rad, m).",
            )
        return freeze(np.ascontiguousarray(inside))


def workspace(
    model: DynamicModel, limits: Mapping[str, Sequence[float] | None] | None = None, box: Box | None = None
) -> Workspace:
    """The workspace of a device: the limits of its file, some of them replaced.

    Args:
        limits: of joints by name, active or passive, rad or m; None for no limit. Limits of a passive joint are limits
            of a combination of active ones, such as a parallelogram's coupling.
        box: of the handle's origin, if any.

    Raises:
        WorkspaceError: limits of an unknown joint, or limits that do not ascend.
        IncompleteDeviceError: a sliding active joint without limits (a turning one has a whole turn), or a box for a
            device without handle.
    """
    known = _limits(model, limits or {})
    for j in model.device.active:
        if known[model.device.joint_names[j]] is None and model.device.joints[j].prismatic:
            raise IncompleteDeviceError(
                f"joint {model.device.joint_names[j]} slides and has no limits, so its workspace is unbounded.",
                where=model.device.joint_names[j],
                advice="Give it limits in the device file, or to the workspace.",
            )
    active = [known[model.device.joint_names[j]] or (-np.pi, np.pi) for j in model.device.active]
    passive = [
        j
        for j, joint in enumerate(model.device.joints)
        if j not in model.device.active and known[joint.name] is not None
    ]
    return Workspace(
        model=model,
        limits=np.array(active, dtype=float),
        coupled=tuple(passive),
        ranges=np.array([known[model.device.joints[j].name] for j in passive], dtype=float).reshape(-1, 2),
        box=box,
    )


def _limits(model: DynamicModel, limits: Mapping[str, Sequence[float] | None]) -> dict[str, _Range | None]:
    """Limits of every joint by name: those given, else the file's."""
    known = {joint.name: joint.position_limits for joint in model.device.joints}
    for name, pair in limits.items():
        if name not in known:
            raise _workspace_limit(name, pair, f"limits of one of the joints {', '.join(known)}")
        known[name] = None if pair is None else _ascending(name, pair)
    return known


def _ascending(name: str, pair: Sequence[float]) -> _Range:
    """Two limits, the lower one first."""
    ends = tuple(pair) if isinstance(pair, Iterable) else ()
    if len(ends) != 2 or not all(isinstance(x, Real) and np.isfinite(x) for x in ends) or ends[0] >= ends[1]:
        raise _workspace_limit(name, pair, "two finite numbers, the lower one first")
    return float(ends[0]), float(ends[1])


def _workspace_limit(name: str, value: object, wanted: str) -> WorkspaceError:
    return WorkspaceError(
        f"workspace limit {name} is {value!r}; write {wanted}.", where=name, found=value, limit=wanted
    )
