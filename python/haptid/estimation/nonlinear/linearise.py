"""A device whose columns depend on what is estimated, made linear: its constants searched, its loads settled."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from haptid.dynamics.model import DynamicModel
from haptid.estimation import Intervals, Method
from haptid.estimation.nonlinear import VariableProjection, variable_projection
from haptid.estimation.nonlinear.copies import Sought
from haptid.estimation.nonlinear.load_friction import fit_load_friction

Progress = Callable[[str, float], None]


def unsettled(model: DynamicModel) -> bool:
    """Whether columns of the device depend on what an estimate alone can tell."""
    return bool(model.device.searched) or model.has_loads


def settled(
    model: DynamicModel,
    motions: Sequence[Sought],
    method: Method | None = None,
    intervals: Intervals | None = None,
    tell: Progress | None = None,
) -> tuple[DynamicModel, VariableProjection | None]:
    """The device, linear in all that is left to estimate, and its constants as found.

    Loads are settled with the constants where their search starts, so that it sees them about right, and once more
    with the constants that it finds.

    Args:
        model: as its file has it.
        motions: treated, or every other block of one.
        method: of estimation, `WLS()` where None.
        intervals: of the constants, `ClusterRobust()` where None.
        tell: called with what is being done and the share of it done.

    Raises:
        HaptidError: as `fit_load_friction` and `variable_projection`.
    """
    tell = tell or (lambda _what, _share: None)
    model = _loaded(model, motions, method, tell)
    if not model.device.searched:
        return model, None
    tell("searching constants", 0.0)
    projection = variable_projection(
        model, motions, method, intervals, lambda share: tell("searching constants", share)
    )
    model = _loaded(projection.model, motions, method, tell)
    return model, replace(projection, model=model)


def _loaded(model: DynamicModel, motions: Sequence[Sought], method: Method | None, tell: Progress) -> DynamicModel:
    """With its loads settled, where it has some."""
    if not model.has_loads:
        return model
    tell("settling loads", 0.0)
    model = fit_load_friction(model, motions, method)
    tell("settling loads", 1.0)
    return model
