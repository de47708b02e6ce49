"""Joints that are held while others move: what their encoders show is trembling, and their friction any torque."""

from __future__ import annotations

from collections.abc import Sequence

# Share of the farthest joint's travel, and travel, rad and m, below which a joint is held: where dry friction holds it
# or breaks loose is not told from so little.
_SHARE, _TRAVEL = 0.02, {False: 0.05, True: 0.005}


def held_joints(travels: Sequence[float], straight: Sequence[bool]) -> list[int]:
    """Joints, by number, that hardly move where another one of their kind does.

    Args:
        travels: largest less smallest position of each joint, rad or m.
        straight: whether each is prismatic.
    """
    found: list[int] = []
    for kind, least in _TRAVEL.items():
        own = [k for k, one in enumerate(straight) if one == kind]
        farthest = max((travels[k] for k in own), default=0.0)
        found += [k for k in own if travels[k] < min(_SHARE * farthest, least)]
    return sorted(found)
