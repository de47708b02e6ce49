"""The joints that move: links fixed to each other merged, joints held or left out, loops opened at closing joints."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.errors import suggestion
from haptid.robot_files.balls import with_ball_hinges
from haptid.robot_files.tree import (
    ClosingJoint,
    Follows,
    Inertial,
    Note,
    RobotLink,
    RobotTree,
    Tendon,
    TreeJoint,
    merged,
    motion,
    ordered,
)
from haptid.robot_files.xml import refused


@dataclass(frozen=True, eq=False)
class Moving:
    """A joint that moves, and all that is fixed to its link.

    Attributes:
        joint: of the source.
        parent: index of the moving joint that carries it, -1 for the base.
        placement: in that joint's link frame, (4, 4).
        body: of its link and all links fixed to it, in its link frame; None if the source knows none of them.
        massless: none of these links is a body of the source.
    """

    joint: TreeJoint
    parent: int
    placement: Array
    body: Inertial | None
    massless: bool


@dataclass(frozen=True, eq=False)
class MovingTree:
    """The moving part of a tree.

    Attributes:
        tree: with `joints` in order, and `notes` of what was held or left out.
        root: link that is the base.
        base: pose of the base link in the source's root frame at the held positions, (4, 4).
        moving: joints that move, parents first.
        held: positions of the joints that do not, by name.
        frames: for every link that is kept, the index of its moving joint (-1: base) and its pose there, (4, 4).
        follows: relations between moving joints.
        closing: closing joints whose links are kept.
        tendons: those of moving joints, held ones as constants.
        spinning: held hinges of ball joints, about which a symmetric rod may spin.
    """

    tree: RobotTree
    root: str
    base: Array
    moving: tuple[Moving, ...]
    held: Mapping[str, float]
    frames: Mapping[str, tuple[int, Array]]
    follows: tuple[Follows, ...]
    closing: tuple[ClosingJoint, ...]
    tendons: tuple[Tendon, ...] = ()
    spinning: frozenset[str] = frozenset()

    def with_bodies(self, bodies: Mapping[str, Inertial]) -> MovingTree:
        """The same tree with these bodies by link, and no others."""
        links = {name: replace(link, inertial=bodies.get(name)) for name, link in self.tree.links.items()}
        return replace(self, tree=replace(self.tree, links=links))


def moving_tree(
    tree: RobotTree,
    root: str | None = None,
    tip: str | None = None,
    hold: Mapping[str, float] | None = None,
    spinning: Collection[str] = (),
) -> MovingTree:
    """The moving part below a root link, up to a tip link where one is given.

    Args:
        tree: of a reader.
        root: link that becomes the base; the source's root link if None.
        tip: last link of a chain: joints that are not on the way from the root to it are held at zero.
        hold: positions at which joints are held, by name, rad or m.
        spinning: hinges of ball joints that nothing determines: they are held at zero.

    Raises:
        RobotFileError: a name is unknown, nothing moves, or the tree is wrong (see `ordered`).
    """
    hold = dict(hold or {})
    tree = with_ball_hinges(tree, hold)
    joints = ordered(tree)
    by_name = {joint.name: joint for joint in joints}
    above = {joint.child: joint for joint in joints}
    for name in hold:
        if name not in by_name:
            raise refused(tree.file, f"it has no joint {name!r} to hold", suggestion(name, by_name))
    for role, link in (("root", root), ("tip", tip)):
        if link is not None and link not in tree.links:
            raise refused(tree.file, f"it has no link {link!r} to be the {role}", suggestion(link, tree.links))
    roots = [link for link in tree.links if link not in above]
    if root is None and len(roots) > 1:
        root = _only_root(tree, roots, joints)
    root = root if root is not None else roots[0]
    chain = None if tip is None else _chain(tree, root, tip, above)
    held = _held(joints, tree, hold | dict.fromkeys(spinning, 0.0), chain)
    notes = [*tree.notes, *_said(joints, held, hold, chain, spinning)]
    base = _pose_of(root, above, held)
    moving: list[Moving] = []
    frames: dict[str, tuple[int, Array]] = {root: (-1, np.eye(4))}
    fixed: list[list[RobotLink]] = []
    for joint in joints:
        if joint.parent not in frames or joint.child == root:
            continue
        at, frame = frames[joint.parent]
        placement = frame @ joint.placement
        if joint.name in held:
            frames[joint.child] = (at, placement @ motion(joint, held[joint.name]))
            if at >= 0:
                fixed[at].append(tree.links[joint.child])
            continue
        moving.append(Moving(joint, at, placement, None, False))
        fixed.append([tree.links[joint.child]])
        frames[joint.child] = (len(moving) - 1, np.eye(4))
    if not moving:
        raise refused(tree.file, f'no joint moves below link "{root}"', "Name another root, or hold fewer joints.")
    made = tuple(_with_body(one, links, frames) for one, links in zip(moving, fixed, strict=True))
    kept = {one.joint.name for one in made}
    outside = [joint.name for joint in joints if joint.child not in frames and joint.moves]
    if outside:
        notes.append(Note("left out", f"joints that link {root} does not carry: {', '.join(outside)}"))
    follows, more = _relations(tree.follows, kept, held)
    closing = tuple(cut for cut in tree.closing if cut.link_a in frames and cut.link_b in frames)
    notes += more
    if closing:
        bent = [relation for relation in follows if relation.powers]
        follows = tuple(relation for relation in follows if not relation.powers)
        text = "joint {} follows by a polynomial beside loops; it moves by itself here"
        notes += [Note("left out", text.format(relation.joint), relation.line) for relation in bent]
    notes += [
        Note("left out", f"loop {cut.name}: link {root} does not carry both its ends", cut.line)
        for cut in tree.closing
        if cut not in closing
    ]
    notes += [
        Note(
            "approximate",
            f"link {one.joint.child}: the source has no inertia of it; its body is unknown",
            one.joint.line,
        )
        for one in made
        if one.body is None and not one.massless
    ]
    tree = replace(tree, joints=joints, notes=tuple(notes))
    tendons = tuple(_pulling(tendon, kept, held) for tendon in tree.tendons if kept & set(tendon.factors))
    return MovingTree(tree, root, base, made, held, frames, follows, closing, tendons, frozenset(spinning))


def _pulling(tendon: Tendon, kept: set[str], held: Mapping[str, float]) -> Tendon:
    """A tendon as one of moving joints."""
    constant = sum(factor * held.get(name, 0.0) for name, factor in tendon.factors.items() if name not in kept)
    factors = {name: factor for name, factor in tendon.factors.items() if name in kept}
    return replace(tendon, factors=factors, rest=tendon.rest - constant)


def _only_root(tree: RobotTree, roots: Sequence[str], joints: Sequence[TreeJoint]) -> str:
    """The one root below which anything moves; a description with several such roots is ambiguous."""
    with_joints = list(dict.fromkeys(joint.parent for joint in joints if joint.parent in roots))
    if len(with_joints) == 1:
        return with_joints[0]
    names = ", ".join(repr(name) for name in (with_joints or roots)[:5])
    raise refused(
        tree.file, f"it has {len(with_joints or roots)} root links, such as {names}", "Choose one as the root."
    )


def _chain(tree: RobotTree, root: str, tip: str, above: Mapping[str, TreeJoint]) -> set[str]:
    """Names of the joints from the root to the tip."""
    made: set[str] = set()
    link = tip
    while link != root:
        joint = above.get(link)
        if joint is None:
            found = f'link "{tip}" is not carried by link "{root}"'
            raise refused(tree.file, found, "Name a root and a tip of one chain.")
        made.add(joint.name)
        link = joint.parent
    return made


def _held(
    joints: Sequence[TreeJoint], tree: RobotTree, hold: Mapping[str, float], chain: set[str] | None
) -> dict[str, float]:
    """Positions of all joints that do not move, with followers of joints that are all held."""
    held = dict(hold)
    for joint in joints:
        if not joint.moves or (chain is not None and joint.name not in chain):
            held.setdefault(joint.name, 0.0)
    changed = True
    while changed:
        changed = False
        for relation in tree.follows:
            if all(name in held for name in relation.factors):
                value = relation.at(held)
                changed |= held.get(relation.joint) != value and relation.joint not in hold
                if relation.joint not in hold:
                    held[relation.joint] = value
    return held


def _said(
    joints: Sequence[TreeJoint],
    held: Mapping[str, float],
    hold: Mapping[str, float],
    chain: set[str] | None,
    spinning: Collection[str],
) -> list[Note]:
    made = [
        Note("approximate", f"{joint.kind} joint {joint.name} is held as the source places it", joint.line)
        for joint in joints
        if joint.kind in ("floating", "planar") and joint.name not in hold
    ]
    made += [
        Note("approximate", f"joint {joint.name} is held at {held[joint.name]:g}, as asked for", joint.line)
        for joint in joints
        if joint.name in hold
        or (joint.name in held and joint.moves and chain is not None and joint.name not in spinning)
    ]
    return made


def _pose_of(link: str, above: Mapping[str, TreeJoint], held: Mapping[str, float]) -> Array:
    """Pose of a link in its root's frame, joints above it at their held positions, or zero."""
    made = np.eye(4)
    while link in above:
        joint = above[link]
        made = joint.placement @ motion(joint, held.get(joint.name, 0.0)) @ made
        link = joint.parent
    return made


def _with_body(one: Moving, links: Sequence[RobotLink], frames: Mapping[str, tuple[int, Array]]) -> Moving:
    bodies = [link.inertial.moved(frames[link.name][1]) for link in links if link.inertial is not None]
    bodies = [body for body in bodies if body.mass > 0 or body.inertia.any()]
    return replace(one, body=merged(bodies) if bodies else None, massless=all(link.massless for link in links))


def _relations(
    follows: Sequence[Follows], kept: set[str], held: Mapping[str, float]
) -> tuple[tuple[Follows, ...], list[Note]]:
    """Relations of moving joints, held ones as constants."""
    made: list[Follows] = []
    notes: list[Note] = []
    for relation in follows:
        if relation.joint in held and any(name in kept for name in relation.factors):
            if relation.joint in kept or not all(name in held for name in relation.factors):
                text = f"joint {relation.joint} is held, though it follows {', '.join(relation.factors)}"
                notes.append(Note("approximate", text, relation.line))
        elif relation.joint in kept:
            outside = [name for name in relation.factors if name not in kept and name not in held]
            if outside:
                text = f"joint {relation.joint} follows {', '.join(outside)}, which the device does not have"
                notes.append(Note("left out", text, relation.line))
                continue
            constant = sum(factor * held[name] for name, factor in relation.factors.items() if name in held)
            factors = {name: factor for name, factor in relation.factors.items() if name in kept}
            made.append(Follows(relation.joint, factors, relation.offset + constant, relation.line, relation.powers))
    return tuple(made), notes
