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
    most = {kind: max((x for x, own in zip(travels, straight, strict=True) if own == kind), default=0.0)
            for kind in (False, True)}  # fmt: skip
    return [
        k
        for k, (travel, kind) in enumerate(zip(travels, straight, strict=True))
        if travel < min(_SHARE * most[kind], _TRAVEL[kind])
    ]
