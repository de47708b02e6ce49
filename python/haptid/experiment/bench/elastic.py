"""Elastic motors on the bench: motion is planned as if they were rigid, and springs are in balance at the start."""

from __future__ import annotations

import numpy as np

from haptid._internal.arrays import Array
from haptid.device import Device
from haptid.device.elastic import rotors, torsion_places
from haptid.dynamics.forward import INVERTIBLE, ForwardDynamics
from haptid.dynamics.inverse import inverse_dynamics
from haptid.dynamics.model import DynamicModel
from haptid.errors import ExperimentError

# Fastest motion over the rate of the simulator's steps: the fourth-order Runge-Kutta method is stable up to 2.78.
_FASTEST = 2.5


def planned_torque(device: Device, c: Array, tau: Array) -> Array:
    """Torques of the motors' coordinates on a motion without torsion, (motors, samples), N m or N.

    Args:
        device: the device.
        c: positions of the torque rows' coordinates, (active, samples), rad or m.
        tau: torques of the rows, (active, samples), N m or N.
    """
    if not device.elastic:
        return device.drive_torque(c, tau)
    held = np.delete(np.arange(len(c)), torsion_places(device))
    B = device.drive_jacobian(c)[..., device.driven, :][..., held]
    shares = device.law.of(device.driven).shares(B)
    return np.asarray(np.einsum("...dr,r...->d...", shares, tau[held]) if B.ndim == 3 else shares @ tau[held])


def balanced_start(model: DynamicModel, chi: Array, q: Array) -> Array:
    """Positions of the active joints, (active,), with links moved from q so that springs balance gravity.

    Raises:
        ExperimentError: a spring without stiffness.
    """
    device, start = model.device, np.array(q)
    if not device.elastic:
        return start
    pose, rest = start[:, None], np.zeros((len(q), 1))
    motors = [drive.name for drive in device.motors]
    tau = inverse_dynamics(model, model.base.of(chi), pose, rest, rest)
    torque = planned_torque(device, device.row_map @ pose, tau)[:, 0]
    bent = [torque[motors.index(d.name)] / stiffness(model, chi, d.name) for d in device.elastic]
    own = rotors(device)
    links = np.delete(np.arange(len(q)), own)
    moved = np.array([d.row - d.torsion for d in device.elastic]) @ device.closure.constant[:, links]
    start[links] -= np.linalg.pinv(moved) @ bent
    return start


def stiffness(model: DynamicModel, chi: Array, motor: str) -> float:
    """Stiffness of an elastic motor's spring, N m/rad or N/m.

    Raises:
        ExperimentError: it is not positive.
    """
    raw = (model.device.parameters.S @ chi)[10 * len(model.device.joints) :]
    on = f"elastic {motor}"
    name, found = next(
        (term.name, float(value))
        for term, value in zip(model.terms, raw, strict=True)
        if term.on == on and term.nature == "spring"
    )
    if found <= 0:
        raise ExperimentError(
            f"motor {motor} is elastic, and its stiffness {name} is {found:g}; the bench requires a positive one.",
            where=name,
            found=found,
            limit=0.0,
            advice=f"Give {name} under [parameters] in the experiment, N m/rad or N/m.",
        )
    return found


def check_springs(model: DynamicModel, chi: Array, q: Array, step: float) -> None:
    """Raise ExperimentError where springs are unstable by themselves, or too fast for the simulator's step.

    Args:
        q: positions of the active joints, (active,).
        step: of the simulator, s.
    """
    if not model.device.elastic:
        return
    raw = model.device.parameters.S @ chi
    for k, (term, value) in enumerate(zip(model.terms, raw[10 * len(model.device.joints) :], strict=True)):
        own = term.on.startswith("elastic ")
        if not own and term.nature != "rotor":
            raw[10 * len(model.device.joints) + k] = 0.0  # friction is the simulator's own
        if own and term.nature == "viscous" and value < 0:
            raise ExperimentError(
                f"the damping {term.name} of the spring of {term.on.replace('elastic', 'motor')} is {value:g}; "
                "with a negative one the simulation is unstable.",
                where=term.name,
                found=float(value),
                limit=0.0,
                advice=f"Give {term.name} = 0 or more under [parameters] in the experiment.",
            )
    c = (model.device.row_map @ q)[:, None]
    c[torsion_places(model.device)] = 1.0  # beyond any play
    still, forward = np.zeros_like(c), ForwardDynamics(model, raw)
    stiff, damped = (part[0] for part in forward.gradients(c, still, still))
    M, n = forward.mass(c)[0], len(c)
    if np.linalg.cond(M) > 1 / INVERTIBLE:
        return  # a body without inertia has an error of its own
    flow = np.block([[np.zeros((n, n)), np.eye(n)], [-np.linalg.solve(M, stiff), -np.linalg.solve(M, damped)]])
    fastest = float(np.abs(np.linalg.eigvals(flow)).max())
    if fastest * step > _FASTEST:
        raise ExperimentError(
            f"springs of this stiffness and damping move at {fastest / (2 * np.pi):.3g} Hz, too fast for the "
            f"simulator's step of {step:g} s (limit {_FASTEST / (2 * np.pi * step):.3g} Hz).",
            where="physics.step",
            found=fastest * step,
            limit=_FASTEST,
            advice=f"Give [physics] step = {0.5 * _FASTEST / fastest:.1g}, or make this motor rigid.",
        )
