"""Whether loops close for all values of their lengths: the two frames of every cut meet at random states, exactly."""

from __future__ import annotations

import numpy as np

from haptid.dynamics.symbolic.chain import ExactChain
from haptid.dynamics.symbolic.residues import PRIMES, Field, Residues
from haptid.dynamics.symbolic.symbols import LENGTH, draw
from haptid.dynamics.symbolic.tree import all_placed, frame_pose, poses
from haptid.errors import SymbolicClosureError

# States at which closure is tested: one that closes by chance has odds of a few in a billion.
STATES = 3


def check_closure(chain: ExactChain, names: tuple[str, ...], seed: int) -> None:
    """Raise unless every loop closes identically.

    Args:
        chain: the mechanism.
        names: of its joints, for the error.
        seed: of states and lengths.

    Raises:
        SymbolicClosureError: a cut's frames do not meet.
    """
    if not chain.cuts:
        return
    field, rng = Field(PRIMES[0]), np.random.default_rng(seed)
    values = draw(chain.symbols, field, rng, STATES)
    states = chain.motion.states(field, rng, values, STATES)
    placed = all_placed(chain.joints, field, values, STATES)
    links = poses(chain.joints, field, placed, (states.cos, states.sin, states.slide))
    for cut in chain.cuts:
        frame, twin = (frame_pose(at, field, links, values, STATES) for at in (cut.frame, cut.twin))
        if _gap(field, frame, twin, cut.prismatic).any():
            on, other = (names[at.link] if at.link >= 0 else "base" for at in (cut.frame, cut.twin))
            lengths = [f"{s.name} = {s.value:.6g}" for s in chain.symbols if s.grade == LENGTH]
            raise SymbolicClosureError(on, other, lengths)


def _gap(field: Field, frame: Residues, twin: Residues, prismatic: bool) -> Residues:
    """What must vanish: origins and z axes apart; of a sliding joint, orientations apart and the gap across z."""
    apart = field.reduce(frame - twin)
    if not prismatic:
        return apart[:, :3, 2:]
    across = field.product(np.swapaxes(twin[:, :3, :2], 1, 2), apart[:, :3, 3:])
    return np.concatenate([apart[:, :3, :3], np.concatenate([across, across[:, :1]], axis=1)], axis=2)
