"""The way in which loops that are not linear close: chosen once, at the start pose of the device file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from haptid._internal.arrays import Array
from haptid.device.loops.assembly import Chain, solve
from haptid.device.loops.newton import CLOSED, SINGULAR, NewtonClosure, openness
from haptid.errors import LoopBranchError, LoopOpenError, SingularLoopError

# Starts of the passive joints at the start pose, beside the guess.
STARTS = 256
# Two ways of closing are one where no joint differs by more, rad (or mechanism sizes).
SAME = 1e-3
# Poses at which it is looked at which rates vary, and how large one must be to count.
POSES, EFFECT = 24, 1e-9

# Passive joints guessed, and the active joints' start pose, (active,).
Start = tuple[Mapping[int, float], Array]


def newton_closure(
    chain: Chain, G: Array, offset: Array, unknown: list[int], told: Mapping[int, str], start: Start, where: str
) -> NewtonClosure:
    """The closure of loops that are not linear.

    Args:
        chain: the tree and its cuts.
        G, offset: motion of the joints already settled; rows of the unknown ones are ignored.
        unknown: indices of the joints that the cuts settle.
        told: relations of the passive joints already settled.
        start: roughly where the passive joints are at the start pose, and that pose.
        where: place of the loops in the file.

    Raises:
        LoopOpenError: the loops do not close at the start pose.
        LoopBranchError: they close in several ways, and the guess does not choose.
        SingularLoopError: the start pose is singular.
    """
    guess, at = start
    constant, constants = G.copy(), offset.copy()
    constant[unknown], constants[unknown] = 0.0, 0.0
    q = _chosen(chain, _ways(chain, constant @ at + constants, unknown, guess, at, where), unknown, guess, at, where)
    open_by = float(openness(chain.residual(q[None])[1][:, :, unknown])[0])
    if open_by < SINGULAR:
        raise SingularLoopError(f"{where}: at the start pose", chain.active_text(at), open_by, SINGULAR)
    varying = np.zeros(G.shape, dtype=bool)
    varying[unknown] = True
    followers = ", ".join(f"q{chain.joints[k].name}" for k in chain.active)
    relations = {**told, **{j: f"q{chain.joints[j].name} by closing, from {followers}" for j in unknown}}
    texts = tuple(relations[j] for j in sorted(relations))
    made = NewtonClosure(chain, constant, constants, tuple(unknown), at, q, varying, 0.0, texts)
    return _measured(made)


def _measured(made: NewtonClosure) -> NewtonClosure:
    """With the rates that never have an effect left out, and the closure error."""
    rng = np.random.default_rng(0)
    followed = made.follow(made.draw(rng, POSES))
    gap = float(np.abs(made.chain.residual(followed.q.T)[0]).max())
    varying = made.varying & (np.abs(followed.G).max(axis=0) > EFFECT * made.chain.units.min())
    return replace(made, varying=varying, error=gap)


def _ways(chain: Chain, q: Array, unknown: list[int], guess: Mapping[int, float], at: Array, where: str) -> list[Array]:
    """All poses found in which the loops close, turning joints within half a turn of the guess, or of zero."""
    tried = np.repeat(q[None], STARTS + 1, axis=0)
    tried[:, unknown] = chain.random_starts(unknown, STARTS + 1, seed=0)
    tried[0, unknown] = [guess.get(j, 0.0) for j in unknown]
    tried = solve(chain, tried, unknown)
    gaps = np.abs(chain.residual(tried)[0]).max(axis=1)
    if not (gaps < CLOSED * chain.size).any():
        how = f"at the start pose ({chain.active_text(at)}), from {STARTS + 1} starts,"
        raise LoopOpenError(where, float(gaps.min()), CLOSED * chain.size, how)
    found: list[Array] = []
    for pose in tried[gaps < CLOSED * chain.size]:
        for j in unknown:
            if not chain.joints[j].prismatic:
                centre = guess.get(j, 0.0)
                pose[j] = centre + np.remainder(pose[j] - centre + np.pi, 2 * np.pi) - np.pi
        if not any(_distance(chain, pose, other, unknown) < SAME for other in found):
            found.append(pose)
    return found


def _distance(chain: Chain, one: Array, other: Array, joints: list[int]) -> float:
    """Greatest difference of some joints, whole turns left out of account, rad (or mechanism sizes)."""
    apart = (one - other) / chain.units
    turning = [not joint.prismatic for joint in chain.joints]
    apart[turning] = np.angle(np.exp(1j * apart[turning]))
    return float(np.abs(apart[joints]).max(initial=0.0))


def _chosen(
    chain: Chain, ways: list[Array], unknown: list[int], guess: Mapping[int, float], at: Array, where: str
) -> Array:
    """The way nearest to the guess."""
    wanted = np.zeros(len(chain.joints))
    guessed = [j for j in guess if j in unknown]
    wanted[guessed] = [guess[j] for j in guessed]
    away = np.array([_distance(chain, pose, wanted, guessed) for pose in ways])
    nearest = [way for way, distance in zip(ways, away, strict=True) if distance < away.min() + SAME]
    if len(nearest) > 1:
        texts = [", ".join(f"{chain.joints[j].name} = {way[j]:.4g}" for j in unknown) for way in nearest]
        raise LoopBranchError(where, chain.active_text(at), texts)
    return nearest[0]
