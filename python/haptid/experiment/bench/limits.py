"""Limits of a planned motion, checked before the simulation: joints, motors, and distance from loop singularities."""

from __future__ import annotations

import numpy as np

from haptid._internal.arrays import Array
from haptid.device import Frame, NewtonClosure
from haptid.device.loops.newton import conditioning
from haptid.device.loops.pins import Pins
from haptid.dynamics.inverse import inverse_dynamics
from haptid.dynamics.model import DynamicModel
from haptid.errors import TrajectoryError
from haptid.experiment.bench.elastic import planned_torque
from haptid.experiment.bench.trajectories import Trajectory

# Minimum distance of a loop from its singular (flat) configuration: about four degrees of a parallelogram's angle.
FLAT = 0.05
# Step at which loops and torques are checked, s.
_LOOK = 5e-3


def check_trajectory(model: DynamicModel, trajectory: Trajectory, chi: Array, saturation: Array | None = None) -> None:
    """Check a planned motion against the limits of joints, loops and motors.

    Args:
        trajectory: the planned motion.
        chi: free standard parameters, (p,), SI.
        saturation: maximum torque of each drive coordinate, (active,), N m or N; None for no limit.

    Raises:
        TrajectoryError: a joint, active or passive, exceeds its range or speed, a motor its torque, or a loop comes
            close to a singular configuration.
    """
    q, qd, _ = model.tree(trajectory.q.T, trajectory.qd.T, trajectory.qdd.T)
    for joint, position, velocity in zip(model.device.joints, q, qd, strict=True):
        unit = "m" if joint.prismatic else "rad"
        if joint.position_limits is not None:
            for side, limit in zip((-1, 1), joint.position_limits, strict=True):
                less = "Move the centre, or lower the amplitude."
                _within(
                    "the position", f"joint {joint.name}", trajectory, side * position, side * limit, unit, less, side
                )
        if joint.velocity_limit is not None:
            less = "Lower the amplitude or the frequencies."
            limit = joint.velocity_limit
            _within("the speed", f"joint {joint.name}", trajectory, np.abs(velocity), limit, f"{unit}/s", less)
    _check_loops(model, trajectory, q)
    _check_torques(model, trajectory, chi, saturation)


def _within(
    what: str, name: str, trajectory: Trajectory, values: Array, limit: float, unit: str, instead: str, side: int = 1
) -> None:
    worst = int(np.argmax(values))
    if values[worst] > limit:
        step = trajectory.dt * len(trajectory) / len(values)
        found = side * float(values[worst])
        raise TrajectoryError(
            f"{what} of {name} reaches {found:.4g} {unit} at {worst * step:.3f} s of the planned motion; the limit is "
            f"{side * limit:.4g} {unit}.",
            where=(name, worst * step),
            found=found,
            limit=side * limit,
            advice=instead,
        )


def _check_loops(model: DynamicModel, trajectory: Trajectory, q: Array) -> None:
    every = max(1, round(_LOOK / trajectory.dt))
    open_by = loop_conditioning(model, q[:, ::every].T)
    worst = int(np.argmin(open_by))
    closure = model.device.closure
    limit = closure.least_conditioning(FLAT) if isinstance(closure, NewtonClosure) else FLAT
    if open_by[worst] < limit:
        passive = [joint.name for j, joint in enumerate(model.device.joints) if j not in model.device.active]
        time, found = worst * every * trajectory.dt, float(open_by[worst])
        raise TrajectoryError(
            f"the loop of {', '.join(passive)} is close to its singular (flat) configuration at {time:.3f} s of the "
            f"planned motion: {found:.3f} on a scale from 0, singular, to 1; the limit is {limit:.2g}.",
            where=time,
            found=found,
            limit=limit,
            advice="Move the centre, or lower the amplitudes.",
        )


def loop_conditioning(model: DynamicModel, q: Array) -> Array:
    """Distance of the loops from singularity, (samples,): 0 where passive joints are not determined, 1 at best.

    The smallest singular value of the constraint Jacobian of the pins (of the cut joints where loops are not linear)
    with respect to the passive joints, its columns scaled to unit length.

    Args:
        q: positions of all joints, (samples, joints).
    """
    closure = model.device.closure
    if isinstance(closure, NewtonClosure):
        return closure.conditioning(q)
    pins = Pins.of(model.device)
    return np.ones(len(q)) if pins is None else pins.at(q.T[list(model.device.active)]).conditioning


def frame_origin(at: Array, frame: Frame) -> Array:
    """Origin of a frame in the base frame, (samples, 3), from the poses of all links."""
    if frame.link < 0:
        return np.broadcast_to(frame.translation, (len(at), 3))
    return np.asarray(at[:, frame.link, :3, :3] @ frame.translation + at[:, frame.link, :3, 3])


def cuts_of_unknown(closure: NewtonClosure) -> np.ndarray:
    """Whether each cut closes a loop whose rates vary, (cuts,); the others of the mechanism are linear."""
    J = closure.chain.residual(closure.start[None])[1][0][:, list(closure.unknown)]
    return np.array([bool(J[rows].any()) for rows in _rows_of(closure)])


def determined_by_pins(closure: NewtonClosure) -> bool:
    """Whether coincident origins of the cut frames alone determine the passive joints, as in a planar mechanism."""
    rows = [row for rows in _rows_of(closure) for row in rows[:3]]
    A = closure.chain.residual(closure.start[None])[1][:, rows][:, :, list(closure.unknown)]
    return bool(A.shape[1] >= A.shape[2] and conditioning(A)[0] > FLAT)


def _check_torques(model: DynamicModel, trajectory: Trajectory, chi: Array, saturation: Array | None) -> None:
    """Check the torques of the motion against the limits of joints and amplifiers."""
    every = max(1, round(_LOOK / trajectory.dt))
    q, qd, qdd = (np.ascontiguousarray(x[::every].T) for x in (trajectory.q, trajectory.qd, trajectory.qdd))
    tau = inverse_dynamics(model, model.base.of(chi), q, qd, qdd)
    joints = model.device.row_map.T @ tau
    less = "Lower the amplitude or the frequencies, or raise the limit."
    for j, torque in zip(model.device.active, joints, strict=True):
        joint = model.device.joints[j]
        if joint.torque_limit is not None:
            unit = "N" if joint.prismatic else "N m"
            _within("the torque", f"joint {joint.name}", trajectory, np.abs(torque), joint.torque_limit, unit, less)
    if saturation is not None:
        motors = planned_torque(model.device, model.device.row_map @ q, tau)
        for k, torque in zip(model.device.driven.tolist(), motors, strict=True):
            drive, limit, unit = model.device.drives[k], saturation[k], model.device.drive_units[k]
            _within("the torque", f"motor {drive.name}", trajectory, np.abs(torque), float(limit), unit, less)


def _rows_of(closure: NewtonClosure) -> list[range]:
    """Rows of every cut in the residual; the first three are the distance of the origins, but of prismatic cuts."""
    counts = [{"revolute": 6, "prismatic": 8, "spherical": 3}[cut.kind] for cut in closure.cuts]
    ends = np.cumsum(counts).tolist()
    return [range(end - count, end) for end, count in zip(ends, counts, strict=True)]
