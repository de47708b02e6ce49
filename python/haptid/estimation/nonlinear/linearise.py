"""A device whose columns depend on what is estimated, made linear: its constants searched, its loads settled."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from haptid.device import Device
from haptid.estimation import Intervals, Method
from haptid.estimation.nonlinear.load_friction import settled_loads
from haptid.estimation.nonlinear import Projection, variable_projection
from haptid.estimation.nonlinear.copies import Sought

Progress = Callable[[str, float], None]


def unsettled(device: Device) -> bool:
    """Whether columns of the device depend on what an estimate alone can tell."""
    return bool(device.searched) or device.has_loads


def settled(
    device: Device,
    motions: Sequence[Sought],
    method: Method | None = None,
    intervals: Intervals | None = None,
    tell: Progress | None = None,
) -> tuple[Device, Projection | None]:
    """The device, linear in all that is left to estimate, and its constants as found.

    Loads are settled with the constants where their search starts, so that it sees them about right, and once more
    with the constants that it finds.

    Args:
        device: as its file has it.
        motions: treated, or every other block of one.
        method: of estimation, `WLS()` where None.
        intervals: of the constants, `Clustered()` where None.
        tell: called with what is being done and the share of it done.

    Raises:
        HaptidError: as `settled_loads` and `variable_projection`.
    """
    tell = tell or (lambda _what, _share: None)
    device = _loaded(device, motions, method, tell)
    if not device.searched:
        return device, None
    tell("searching constants", 0.0)
    projection = variable_projection(
        device, motions, method, intervals, lambda share: tell("searching constants", share)
    )
    device = _loaded(projection.device, motions, method, tell)
    return device, replace(projection, device=device)


def _loaded(device: Device, motions: Sequence[Sought], method: Method | None, tell: Progress) -> Device:
    """With its loads settled, where it has some."""
    if not device.has_loads:
        return device
    tell("settling loads", 0.0)
    device = settled_loads(device, motions, method)
    tell("settling loads", 1.0)
    return device
