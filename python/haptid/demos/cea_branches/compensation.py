"""Inertia compensation on the bench: apparent mass with and without the control law, and the stable share."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from haptid._internal.arrays import Array
from haptid.demos.cea_branches.plan import Compensating, Sweep
from haptid.dynamics.inverse import mass_matrix
from haptid.dynamics.kinematics import handle_motion
from haptid.end_effector.characterisation import apparent_mass
from haptid.end_effector.characterisation.velocity_forces import velocity_product_acceleration
from haptid.end_effector.compensation import Compensation, stable_share
from haptid.estimation import Estimate
from haptid.experiment.bench.setup import Controller, Push, Setup
from haptid.experiment.bench.simulation import simulate
from haptid.experiment.bench.trajectories import Trajectory

# The motors apply the torque of the law alone; the hand moves the device freely.
OFF = Controller((0.0,), (0.0,), tracking_limit=1.0)
# Linear components of the handle's velocity.
_LINEAR = slice(0, 3)


@dataclass(frozen=True, eq=False)
class Compensated:
    """Effect of compensation at some poses.

    Attributes:
        degrees: of the sweep's joint, as plotted, (poses,).
        estimated: largest apparent mass of the model, kg.
        before, after: largest apparent mass on the bench with the weight compensated, and with the law, kg.
        promised: `after` as predicted from the model and the law's delay, kg.
        target: apparent mass towards which a law with a pose-dependent share goes, kg.
        even: largest apparent mass with that law, kg.
        bound: share below which the loop is stable with the assumed hand, least of the poses.
        lag: delay of the law, s.
    """

    degrees: Array
    estimated: Array
    before: Array
    after: Array
    promised: Array
    target: float
    even: Array
    bound: float
    lag: float


def compensated(plan: Compensating, sweep: Sweep, estimated: Estimate, bench: Setup) -> Compensated:
    """Shake the handle at every pose: without the law, with it, and with a pose-dependent share."""
    made = without_friction(bench)
    angles = {"degrees": (plan.degrees[0], plan.degrees[-1]), "poses": len(plan.degrees)}
    qa = sweep.model_copy(update=angles).along(estimated.model)
    mass = apparent_mass(estimated, qa)
    target = (1 - plan.share) * float(mass.mass.values.max())
    laws = [Compensation(estimated, share) for share in (0.0, plan.share)]
    laws.append(Compensation(estimated, plan.share, towards=target))
    masses = np.array(
        [
            [shaken(plan, made, pose, direction, law) for law in laws]
            for pose, direction in zip(qa.T, mass.directions[:, 0], strict=True)
        ]
    )
    left = 1 - plan.share * laws[1].passed(plan.shaken_hz, made.dt).real
    lag = laws[1].lag(made.dt)
    return Compensated(
        degrees=np.array(plan.degrees),
        estimated=mass.mass.values[:, 0],
        before=masses[:, 0],
        after=masses[:, 1],
        promised=left * mass.mass.values[:, 0],
        target=target,
        even=masses[:, 2],
        bound=min(bound(plan, estimated, pose, lag) for pose in qa.T),
        lag=lag,
    )


def without_friction(setup: Setup) -> Setup:
    """The same without friction, and with motors that apply the torque of a law alone."""
    model = setup.model
    rubbing = {term.name for term in model.terms if term.resists}
    chi = np.where([name in rubbing for name in model.device.parameters.names], 0.0, setup.chi)
    return replace(setup, chi=chi, controller=replace(OFF, rate_hz=setup.controller.rate_hz))


def shaken(plan: Compensating, made: Setup, pose: Array, direction: Array, law: Compensation) -> float:
    """Apparent mass along a direction, from the hand's force and the handle's exact motion, kg.

    The hand's force is a cosine, so that the handle moves to and fro about its start.
    """
    model = made.model
    x, y, z = plan.newtons * direction
    push = Push((x, y, z), plan.shaken_hz, start=-0.25 / plan.shaken_hz)
    setup = replace(made, hand=(push,), law=law)
    q = np.tile(pose, (round(plan.seconds / setup.dt), 1))
    found = simulate(setup, Trajectory(setup.dt, q, 0 * q, 0 * q), np.random.default_rng(0))
    late = round(plan.settled / setup.dt)
    qa, qda, qdda = (x[late:, list(model.device.active)].T for x in (found.q, found.qd, found.qdd))
    J = handle_motion(model, qa).jacobian[:, _LINEAR]
    speed = np.einsum("pij,jp->pi", J, qda) @ direction
    acceleration = (
        np.einsum("pij,jp->pi", J, qdda) + velocity_product_acceleration(model, qa, qda)[:, _LINEAR]
    ) @ direction
    columns = np.column_stack([acceleration, speed, np.ones_like(speed)])
    return float(np.linalg.lstsq(columns, found.hand[late:] @ direction, rcond=None)[0][0])


def bound(plan: Compensating, estimated: Estimate, pose: Array, lag: float) -> float:
    """Share below which the loop is stable while a hand holds the handle."""
    J = handle_motion(estimated.model, pose[:, None]).jacobian[0, _LINEAR]
    inertia = mass_matrix(estimated.model, estimated.beta, pose[:, None])[0]
    return stable_share(inertia, plan.hand_damping * J.T @ J, plan.hand_stiffness * J.T @ J, lag)
