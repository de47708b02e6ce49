"""Initial values of elastic motors from the motors' positions alone: a fit of short segments that do not meet.

Links are simulated along the motors for a period and a half at a time, and each segment begins at a state of its own,
which is estimated too. Over so short a time a wrong stiffness cannot lead the simulation far away, so that the fit
converges from any frequency near the motion's and needs no knowledge of the device (multiple shooting: Bock 1981,
Springer Series in Chemical Physics 18; the steps are Marquardt's). Links that inertia couples are fitted together.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.dynamics.model import DynamicModel
from haptid.errors import SimulationError
from haptid.estimation import Estimate
from haptid.estimation.methods.simulation_based import base_columns
from haptid.motion.motion import Motion
from haptid.simulation import smooth
from haptid.simulation.driven import MOST_PARTS, DrivenJoints, SegmentCourses

# Frequencies of the links on their springs that a fit begins with, over the motion's bandwidth; the first two that end
# at one misfit are enough.
_TRIED = (1.0, 2.0, 4.0, 0.5)
_SAME = 0.02
# Logarithm of a fit's frequency over the measured one that it began with, up to which it has stayed there.
_STAYS = 0.4
# Damping ratio to begin with, and the rotors' inertia over that of the links.
_DAMPING, _ROTOR = 0.03, 0.1
# Least eigenvalue of the links' mass matrix, over the largest: that of a rigid fit need not be positive.
_LEAST_MASS = 1e-2
# Length of a segment, periods of the bandwidth, and its fewest steps. Steps in a period of the bandwidth, at least: ten
# in one of the second frequency that a fit begins with, and five in one of the highest.
_PERIODS, _LEAST, _PER_PERIOD = 1.5, 20, 20
# Most steps, the least relative fall of the misfit in one, and how Marquardt's parameter begins, falls, rises and ends.
_STEPS, _FALL = 40, 1e-3
_MARQUARDT, _LOWER, _RAISE, _LARGEST = 1e-2, 0.2, 10.0, 1e6


@dataclass(frozen=True, eq=False)
class SpringStart:
    """Parameters to begin with.

    Attributes:
        beta: base parameters, (p,), SI.
        misfit: mean square of the torque's error, over the torque's variance.
        frequencies: of the links on their springs, (elastic motors,), Hz; nan where a stiffness is negative.
    """

    beta: Array
    misfit: float
    frequencies: Array


@dataclass(frozen=True, eq=False)
class _Fit:
    """Normal equations of the segments, their beginnings eliminated.

    Attributes:
        beta, begin: where they are linearised.
        misfit: there.
        G, g: of the parameters, (p, p) and (p,).
        parts: of each segment: rows by beginning, by parameters, and their error.
    """

    beta: Array
    begin: Array
    misfit: float
    G: Array
    g: Array
    parts: list[tuple[Array, Array, Array]]

    def step(self, marquardt: float) -> tuple[Array, Array]:
        """Parameters and beginnings of the next simulation."""
        size = np.diag(self.G)
        damping = marquardt * np.maximum(size, np.finfo(float).eps * size.max())
        change = np.linalg.solve(self.G + np.diag(damping), self.g)
        begin = self.begin.copy()
        for k, (by_begin, by_beta, error) in enumerate(self.parts):
            begin[k] += np.linalg.lstsq(by_begin, error - by_beta @ change, rcond=None)[0]
        return self.beta + change, begin


def spring_start(
    rigid: Estimate,
    model: DynamicModel,
    motion: Motion,
    bandwidth: float,
    friction: float,
    measured: Array | None = None,
    most_parts: int = MOST_PARTS,
) -> SpringStart:
    """Parameters of an elastic model to begin with.

    Args:
        rigid: estimate of the same device with rigid motors whose rotors have no inertia.
        model: the dynamic model, with elastic motors.
        motion: of the motors; links follow them as if rigid.
        bandwidth: of the motion, Hz.
        friction: dry friction is smoothed within this share of a joint's root mean square speed.
        measured: frequencies of the links on their springs by a frequency response, (elastic motors,), Hz: they are
            tried first, and are enough where the fit stays near them.
        most_parts: smaller steps in one of the simulation, at most, where dry friction is stiff.

    Raises:
        SimulationError: the links cannot be simulated from any of the frequencies.
    """
    every = max(1, int(1 / (_PER_PERIOD * bandwidth * motion.dt)))
    length = max(_LEAST, round(_PERIODS / bandwidth / (every * motion.dt)))
    length = min(length, -(-len(motion) // every))
    joints = DrivenJoints(smooth(model, [motion], friction), motion, length, base_columns(model), every, most_parts)
    best: _Fit | None = None
    failed: SimulationError | None = None
    starts = [np.full(len(model.device.elastic), times * bandwidth) for times in _TRIED]
    for frequencies in starts if measured is None else [measured, *starts]:
        try:
            fit = _fitted(joints, _rigid_links(joints, rigid, frequencies), best)
        except SimulationError as error:
            failed = error
            continue
        same = best is not None and abs(fit.misfit - best.misfit) < _SAME * best.misfit
        best = fit if best is None or fit.misfit < best.misfit else best
        if same:
            break
        if frequencies is measured:
            away = np.abs(np.log(_frequencies(joints, fit.beta) / measured))
            if bool((away < _STAYS).all()):
                break
    if best is None:
        assert failed is not None
        raise failed
    return SpringStart(best.beta, best.misfit, _frequencies(joints, best.beta))


def _rigid_links(joints: DrivenJoints, rigid: Estimate, frequencies: Array) -> Array:
    """Base parameters with bodies of a rigid fit, springs of these frequencies, and friction that is not negative."""
    model = joints.model
    parameters, names = model.device.parameters, rigid.model.device.parameters.names
    chi = np.zeros(len(parameters.names))
    for place, value in zip(rigid.model.base.independent_columns, rigid.beta, strict=True):
        # A term on motorised joints is on the rotors of the elastic device, and has other names there.
        if names[place] in parameters.index:
            chi[parameters.index[names[place]]] = value
    for term in model.terms:
        if term.resists:
            chi[parameters.index[term.name]] = max(chi[parameters.index[term.name]], 0.0)
    for (name, inertia, own), frequency in zip(_springs(joints, model.base.of(chi)), frequencies, strict=True):
        w = 2 * np.pi * float(frequency)
        start = {"spring": inertia * w**2, "viscous": 2 * _DAMPING * inertia * w}
        for k, nature in own:
            chi[k] = start.get(nature, 0.0)
        for term in model.terms:
            if term.on == f"motor {name}" and term.nature == "rotor" and term.name in parameters.index:
                chi[parameters.index[term.name]] = _ROTOR * inertia
    return model.base.of(chi)


def _frequencies(joints: DrivenJoints, beta: Array) -> Array:
    """Of the links on each spring, the other links free, Hz."""
    base, made = joints.model.base, []
    raw = dict(zip((joints.model.device.parameters.names[k] for k in base.independent_columns), beta, strict=True))
    names = joints.model.device.parameters.names
    for _, inertia, own in _springs(joints, beta):
        stiffness = sum(raw.get(names[k], 0.0) for k, nature in own if nature == "spring")
        made.append(np.sqrt(stiffness / inertia) / (2 * np.pi) if stiffness > 0 else np.nan)
    return np.array(made)


def _springs(joints: DrivenJoints, beta: Array) -> Iterator[tuple[str, float, list[tuple[int, str]]]]:
    """Of each elastic motor: its name, inertia of the links that its spring feels, places and natures of its terms."""
    model = joints.model
    device, index = model.device, model.device.parameters.index
    values, vectors = np.linalg.eigh(joints.inertia(beta))
    M = (vectors * np.maximum(values, _LEAST_MASS * np.abs(values).max())) @ vectors.T
    for drive in device.elastic:
        rates = ((drive.row - drive.torsion) @ device.closure.constant)[joints.unknown]
        own = [
            (index[term.name], term.nature)
            for term in model.terms
            if term.on == f"elastic {drive.name}" and term.name in index
        ]
        yield drive.name, float(1 / (rates @ np.linalg.solve(M, rates))), own


def _fitted(joints: DrivenJoints, beta: Array, known: _Fit | None) -> _Fit:
    """Parameters and beginnings with the least misfit, by Marquardt's steps from these parameters.

    It ends where steps come to a fit that is known: with nearly its misfit, and frequencies of the links.
    """
    size = np.maximum(joints.measured[joints.motors].std(axis=1), np.finfo(float).tiny)
    best = _normal(joints, joints.apart(beta), beta, size)
    marquardt = _MARQUARDT
    for _ in range(_STEPS):
        beta, begin = best.step(marquardt)
        try:
            fit = _normal(joints, joints.apart(beta, begin), beta, size)
        except SimulationError:
            fit = None
        if fit is None or not fit.misfit < best.misfit:
            marquardt *= _RAISE
            if marquardt > _LARGEST:
                break
            continue
        small, best, marquardt = fit.misfit > (1 - _FALL) * best.misfit, fit, marquardt * _LOWER
        if (small and marquardt < _MARQUARDT) or (known and _reaches(joints, best, known)):
            break
    return best


def _reaches(joints: DrivenJoints, fit: _Fit, known: _Fit) -> bool:
    """Whether a fit is near one that is known."""
    if not abs(fit.misfit - known.misfit) < _SAME * known.misfit:
        return False
    away = np.log(_frequencies(joints, fit.beta) / _frequencies(joints, known.beta))
    return bool((np.abs(away) < _SAME).all())


def _normal(joints: DrivenJoints, made: SegmentCourses, beta: Array, size: Array) -> _Fit:
    """Normal equations at a simulation.

    Args:
        made: the simulation.
        size: standard deviation of each motor's torque, (motors,).
    """
    rows = joints.motors
    error = (joints.measured - made.torque)[rows] / size[:, None]
    p = len(beta)
    G, g, parts = np.zeros((p, p)), np.zeros(p), []
    for sample in joints.begins:
        part = slice(sample, sample + joints.length)
        by_begin, by_beta = (
            (x[:, :, part] / size[:, None, None]).transpose(0, 2, 1).reshape(-1, x.shape[1])
            for x in (made.by_begin, made.by_beta)
        )
        e = error[:, part].ravel()
        Q = np.linalg.qr(by_begin)[0]
        free, left = by_beta - Q @ (Q.T @ by_beta), e - Q @ (Q.T @ e)
        G += free.T @ free
        g += free.T @ left
        parts.append((by_begin, by_beta, e))
    return _Fit(beta, made.begin, float(np.mean(error**2)), G, g, parts)
