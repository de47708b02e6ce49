"""Base parameters of general loops by an independent method: a hundred digits, from Newton's law in the base frame.

Loops are closed by Newton's method, torques are the projected rates of the links' momenta, and the rank is that of an
elimination whose dropped columns are forty orders of magnitude below those kept. Nothing is shared with the library
but the reading of the file and the order in which columns would rather be kept.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pytest
from mpmath import mp, mpf

import haptid
from haptid.device.toml.reader import resized
from haptid.dynamics.base_parameters import preference

DIGITS = 100
# Step of the central differences in time, s: their error is about its square.
STEP = "1e-25"
# Kept columns are above this, dropped ones below that, of their length.
KEPT, DROPPED = mpf("1e-6"), mpf("1e-40")
STATES = 2  # more than there are columns
SYMMETRIC = {"XX": (0, 0), "XY": (0, 1), "XZ": (0, 2), "YY": (1, 1), "YZ": (1, 2), "ZZ": (2, 2)}


@pytest.fixture(autouse=True)
def digits():
    with mp.workdps(DIGITS):
        yield


def exact(values: np.ndarray) -> np.ndarray:
    """Entries of rotations by multiples of thirty degrees, without their rounding."""
    known = [mpf(0), mpf(1), mpf(1) / 2, mp.sqrt(3) / 2]
    near = [[(abs(abs(x) - float(k)), k) for k in known] for x in values.ravel()]
    made = [min(pairs)[1] * (1 if x >= 0 else -1) for pairs, x in zip(near, values.ravel(), strict=True)]
    assert max(float(min(pairs)[0]) for pairs in near) < 1e-14
    return np.array(made, dtype=object).reshape(values.shape)


def placed(rotation: np.ndarray, translation: np.ndarray) -> np.ndarray:
    """A pose, (4, 4); lengths are those of the file, but for rounding about zero."""
    made = np.full((4, 4), mpf(0))
    made[:3, :3], made[3, 3] = exact(rotation), mpf(1)
    made[:3, 3] = [mpf(float(x)) if abs(x) > 1e-15 else mpf(0) for x in translation]
    return made


def cross(a: np.ndarray) -> np.ndarray:
    return np.array([[mpf(0), -a[2], a[1]], [a[2], mpf(0), -a[0]], [-a[1], a[0], mpf(0)]])


def solved(A: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Least squares of equations that do not contradict each other, (unknowns, right sides)."""
    n = A.shape[1]
    pivots, echelon = eliminate(np.hstack([A.T @ A, A.T @ b]), list(range(n)))
    assert len(pivots) == n
    return echelon[:, n:]


@dataclass(frozen=True)
class Mechanism:
    """A device in many digits: its tree, and the cuts that close it."""

    model: haptid.Device

    @cached_property
    def placements(self) -> list[np.ndarray]:
        return [placed(joint.rotation, joint.translation) for joint in self.model.device.joints]

    @cached_property
    def cuts(self) -> list[list[tuple[int, np.ndarray]]]:
        cuts = self.model.device.closure.cuts
        assert all(cut.kind == "revolute" for cut in cuts)
        return [[(f.link, placed(f.rotation, f.translation)) for f in (cut.frame_a, cut.frame_b)] for cut in cuts]

    @property
    def active(self) -> list[int]:
        return list(self.model.device.active)

    @property
    def passive(self) -> list[int]:
        return [j for j in range(len(self.model.device.joints)) if j not in self.model.device.active]

    def poses(self, q: np.ndarray) -> list[np.ndarray]:
        made: list[np.ndarray] = []
        for joint, at, x in zip(self.model.device.joints, self.placements, q, strict=True):
            turn = np.array(mp.eye(4).tolist(), dtype=object)
            if joint.prismatic:
                turn[2, 3] = x
            else:
                turn[:2, :2] = [[mp.cos(x), -mp.sin(x)], [mp.sin(x), mp.cos(x)]]
            here = at @ turn
            made.append(made[joint.parent] @ here if joint.parent >= 0 else here)
        return made

    def twists(self, links: list[np.ndarray], link: int) -> np.ndarray:
        """Velocity of the point at the base's origin that moves with a link, and its turn, by joint rate, (6, n)."""
        made = np.full((6, len(links)), mpf(0))
        while link >= 0:
            axis, origin = links[link][:3, 2], links[link][:3, 3]
            if self.model.device.joints[link].prismatic:
                made[:3, link] = axis
            else:
                made[:3, link], made[3:, link] = cross(origin) @ axis, axis
            link = self.model.device.joints[link].parent
        return made

    def gap(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What must vanish, and its Jacobian: a pin's origins apart, and one axis across the other frame's."""
        links = self.poses(q)
        values, slopes = [], []
        for (on, frame), (other, twin) in self.cuts:
            a, b = (links[k] @ f if k >= 0 else f for k, f in ((on, frame), (other, twin)))
            J, K = self.twists(links, on), self.twists(links, other)
            values += [a[:3, 3] - b[:3, 3], a[:3, :2].T @ b[:3, 2]]
            slopes += [J[:3] - cross(a[:3, 3]) @ J[3:] - K[:3] + cross(b[:3, 3]) @ K[3:]]
            slopes += [a[:3, :2].T @ cross(b[:3, 2]) @ (J[3:] - K[3:])]
        return np.concatenate(values), np.concatenate(slopes)

    def closed(self, q: np.ndarray, qa: np.ndarray) -> np.ndarray:
        """Passive joints to all digits, from a few of them."""
        q = q.copy()
        q[self.active] = qa
        for _ in range(12):
            value, slope = self.gap(q)
            if max(abs(x) for x in value) < mpf(10) ** (5 - DIGITS):
                return q
            q[self.passive] -= solved(slope[:, self.passive], value[:, None])[:, 0]
        raise AssertionError("no closure")

    def rates(self, q: np.ndarray) -> np.ndarray:
        """Joint rates by active ones, (n, active)."""
        _, slope = self.gap(q)
        G = np.full((len(q), len(self.active)), mpf(0))
        G[self.active, range(len(self.active))] = mpf(1)
        G[self.passive] = solved(slope[:, self.passive], -slope[:, self.active])
        return G

    def momenta(self, q: np.ndarray, qd: np.ndarray) -> np.ndarray:
        """Linear momentum, and the angular one about the base's origin, by each link's parameters, (6, columns)."""
        links, made = self.poses(q), []
        for k, joint in enumerate(self.model.device.joints):
            twist = self.twists(links, k) @ qd
            made += _momenta(links[k], twist) if joint.body else []
        return np.array(made).T

    def weights(self, q: np.ndarray) -> np.ndarray:
        """Gravity's force, and its moment about the base's origin, by the same, (6, columns)."""
        links, g, made = self.poses(q), [mpf(float(x)) for x in self.model.device.gravity], []
        for at, joint in zip(links, self.model.device.joints, strict=True):
            if joint.body:
                none = np.full(6, mpf(0))
                first = [np.concatenate([none[:3], cross(at[:3, k]) @ g]) for k in range(3)]
                made += [*[none] * 6, *first, np.concatenate([g, cross(at[:3, 3]) @ g])]
        return np.array(made).T

    def rows(self, q: np.ndarray, qda: np.ndarray, qdda: np.ndarray) -> np.ndarray:
        """Torques of the active joints by standard parameter, (active, columns)."""
        G = self.rates(q)
        terms = [self._term(term, G, qda, qdda) for term in self.model.terms]
        return np.hstack([self.bodies(q, qda, qdda), *terms])

    def bodies(self, q: np.ndarray, qda: np.ndarray, qdda: np.ndarray) -> np.ndarray:
        """The same by parameters of links alone."""
        h, G = mpf(STEP), self.rates(q)
        ahead, behind = (self._later(s * h, q, qda, qdda) for s in (1, -1))
        wrench, links = (ahead - behind) / (2 * h) - self.weights(q), self.poses(q)
        bodies = [k for k, joint in enumerate(self.model.device.joints) if joint.body]
        made = [G.T @ self.twists(links, k).T @ wrench[:, 10 * i : 10 * i + 10] for i, k in enumerate(bodies)]
        return np.hstack(made)

    def _later(self, t: mpf, q: np.ndarray, qda: np.ndarray, qdda: np.ndarray) -> np.ndarray:
        """The links' momenta after a time, s."""
        there = self.closed(q, q[self.active] + t * qda + t * t / 2 * qdda)
        return self.momenta(there, self.rates(there) @ (qda + t * qdda))

    def _term(self, term, G: np.ndarray, qda: np.ndarray, qdda: np.ndarray) -> np.ndarray:
        side, name = term.on.split()
        weights = np.array([mpf(float(x)) for x in term.weights])
        row = G[self.model.device.joint_names.index(name)] if side == "joint" else weights
        rate = row @ qda
        size = {"rotor": row @ qdda, "viscous": rate, "coulomb": mp.sign(rate)}[term.kind]
        return (row * size)[:, None]


def _momenta(at: np.ndarray, twist: np.ndarray) -> list[np.ndarray]:
    """By XX XY XZ YY YZ ZZ MX MY MZ M of a link in its frame."""
    R, p, w = at[:3, :3], at[:3, 3], twist[3:]
    v = twist[:3] + cross(w) @ p
    none, made = np.full(3, mpf(0)), []
    for i, j in SYMMETRIC.values():
        inertia = np.full((3, 3), mpf(0))
        inertia[i, j] = inertia[j, i] = mpf(1)
        made.append(np.concatenate([none, R @ inertia @ R.T @ w]))
    for k in range(3):
        s = R[:, k]
        force = cross(w) @ s
        made.append(np.concatenate([force, cross(s) @ v + cross(p) @ force]))
    return [*made, np.concatenate([v, cross(p) @ v])]


def regressor(model: haptid.Device, count: int = 0, terms: bool = True) -> np.ndarray:
    """At random states, more than there are columns or a number of them, (rows, standard parameters), all digits."""
    mechanism, rng = Mechanism(model), np.random.default_rng(5)
    count = count or len(model.device.parameters.names) // len(model.device.active) + STATES
    rows = mechanism.rows if terms else mechanism.bodies
    c = model.device.closure.draw(rng, count)
    starts = model.device.closure.positions(c).T
    made = []
    for start in starts:
        q = np.array([mpf(float(x)) for x in start], dtype=object)
        q = mechanism.closed(q, q[mechanism.active])
        qda, qdda = ([mpf(float(x)) for x in rng.uniform(-2, 2, len(model.device.active))] for _ in range(2))
        made.append(rows(q, np.array(qda), np.array(qdda)))
    return np.vstack(made)


def eliminate(W: np.ndarray, order: list[int]) -> tuple[list[int], np.ndarray]:
    """Pivots among the columns in order, and the reduced echelon form."""
    W, sizes = W.copy(), np.abs(W).max(axis=0)
    pivots: list[int] = []
    for k in order:
        top = len(pivots)
        row = top + int(np.argmax(np.abs(W[top:, k])))
        rest = abs(W[row, k]) / sizes[k] if sizes[k] else mpf(0)
        if rest < DROPPED:
            continue
        assert rest > KEPT
        W[[top, row]] = W[[row, top]]
        W[top] = W[top] / W[top, k]
        others = [i for i in range(len(W)) if i != top]
        W[others] = W[others] - W[others][:, [k]] * W[top]
        pivots.append(k)
    return pivots, W[: len(pivots)]


@pytest.mark.parametrize(("name", "count"), [("slider_crank", 10), ("four_bar", 12), ("five_bar", 15), ("delta", 40)])
def test_base_parameters_of_loops_in_many_digits(name: str, count: int) -> None:
    model = haptid.DynamicModel(haptid.read_device(name))
    W = regressor(model)
    idle = np.abs(W).max(axis=0) < DROPPED * np.abs(W).max()
    W[:, idle] = mpf(0)
    pivots, echelon = eliminate(W, preference(model))
    assert len(pivots) == count
    assert sorted(pivots) == list(model.base.independent_columns)
    assert tuple(np.array(model.device.parameters.names)[idle]) == model.base.no_effect
    relations = np.array(echelon[np.argsort(pivots)], dtype=float)
    np.testing.assert_allclose(relations, model.base.regrouping, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("name", ["slider_crank", "delta", "cea_medical_interface"])
def test_formulas_of_loops_that_are_not_planar_hold_at_other_lengths(name: str) -> None:
    """Recognised at other lengths from fifteen digits, they hold to forty here."""
    device = haptid.read_device(name)
    formulas = haptid.DynamicModel(device).regroupings
    lengths = {name: x for name, x in device.tables.lengths.items() if isinstance(x, float)}
    lengths = {name: x * (1 + 0.06 * np.sin(3 + k)) for k, (name, x) in enumerate(lengths.items())}
    W = regressor(haptid.DynamicModel(resized(device, lengths)), count=1, terms=False)
    bodies = W.shape[1]
    left, at = W.copy(), {name: mpf(x) for name, x in lengths.items()}
    for kept, row in zip(formulas.independent_columns, formulas.coefficients, strict=True):
        for k, coefficient in row.items():
            if k < bodies:
                assert kept < bodies
                left[:, k] = left[:, k] - W[:, kept] * sum(
                    mpf(c.numerator) / c.denominator * mp.fprod(at[name] ** e for name, e in powers)
                    for powers, c in coefficient.numerator.terms
                )
    assert not coefficient.is_ratio
    assert np.abs(left).max() < DROPPED * np.abs(W).max()
