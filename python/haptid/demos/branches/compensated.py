"""Compensation on the bench: the mass that a hand feels with the law and without, and the share that is stable."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from haptid._internal.arrays import Array, freeze
from haptid.demos.branches.plan import Compensating, Sweep
from haptid.dynamics.inverse import mass_matrix
from haptid.dynamics.kinematics import handle_motion
from haptid.end_effector.characterisation import apparent_mass
from haptid.end_effector.characterisation.velocity_forces import drift
from haptid.end_effector.compensation import Compensation, stable_share
from haptid.estimation import Estimate
from haptid.experiment.bench.experiment import read_experiment
from haptid.experiment.bench.setup import Controller, Push, Setup
from haptid.experiment.bench.simulation import simulate
from haptid.experiment.bench.trajectories import Trajectory

# Motors do nothing but what the law asks for; the device is free to go where the hand moves it.
OFF = Controller((0.0,), (0.0,), tracking_limit=1.0)
# Components of the handle's velocity that count: linear ones.
LINEAR = slice(0, 3)
# Terms that are off in this trial.


@dataclass(frozen=True, eq=False)
class Compensated:
    """What compensation does at some poses.

    Attributes:
        degrees: of the sweep's joint, as plotted, (poses,).
        model: largest mass, kg.
        before, after: largest mass that the hand feels, with the weight carried, and with the law, kg.
        promised: after, from the model and the law's lags, kg.
        target: mass that a law whose share depends on the pose goes towards, kg; at the heaviest pose it has the share.
        even: largest mass that the hand feels with that law, kg.
        bound: share below which the loop is stable with the assumed hand, least of the poses.
        lag: of the law, s.
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


def compensated(
    settings: Compensating, sweep: Sweep, estimated: Estimate, folder: Path, experiment: str
) -> Compensated:
    """Shake the handle at every pose, without the law, with it, and with a share that depends on the pose."""
    model, made = estimated.model, smooth(read_experiment(folder / experiment).setup(estimated.model))
    qa = replace_poses(sweep, settings.degrees).along(model)
    felt = apparent_mass(estimated, qa)
    target = (1 - settings.share) * float(felt.mass.values.max())
    laws = [Compensation(estimated, share) for share in (0.0, settings.share)]
    laws.append(Compensation(estimated, settings.share, towards=target))
    shaken_masses = np.array(
        [
            [shaken(settings, made, pose, direction, law) for law in laws]
            for pose, direction in zip(qa.T, felt.directions[:, 0], strict=True)
        ]
    )
    left = 1 - settings.share * laws[1].passed(settings.shaken_hz, made.dt).real
    lag = laws[1].lag(made.dt)
    return Compensated(
        degrees=np.array(settings.degrees),
        estimated=felt.mass.values[:, 0],
        before=freeze(shaken_masses[:, 0].copy()),
        after=freeze(shaken_masses[:, 1].copy()),
        promised=freeze(left * felt.mass.values[:, 0]),
        target=target,
        even=freeze(shaken_masses[:, 2].copy()),
        bound=min(bound(settings, estimated, pose, lag) for pose in qa.T),
        lag=lag,
    )


def replace_poses(sweep: Sweep, degrees: tuple[float, ...]) -> Sweep:
    """The same sweep over evenly spaced angles, as many as given."""
    return sweep.model_copy(update={"degrees": (degrees[0], degrees[-1]), "poses": len(degrees)})


def smooth(setup: Setup) -> Setup:
    """The same without friction, and with motors that do nothing but what a law asks for."""
    model = setup.model
    rubbing = {term.name for term in model.terms if term.resists}
    chi = np.where([name in rubbing for name in model.device.parameters.names], 0.0, setup.chi)
    return replace(setup, chi=chi, controller=replace(OFF, rate_hz=setup.controller.rate_hz))


def shaken(settings: Compensating, made: Setup, pose: Array, direction: Array, law: Compensation) -> float:
    """Mass along a direction, from the hand's force and the handle's exact motion, kg.

    The hand's force is a cosine: it moves the handle to and fro about where it is.
    """
    model = made.model
    x, y, z = settings.newtons * direction
    push = Push((x, y, z), settings.shaken_hz, start=-0.25 / settings.shaken_hz)
    setup = replace(made, hand=(push,), law=law)
    q = np.tile(pose, (round(settings.seconds / setup.dt), 1))
    found = simulate(setup, Trajectory(setup.dt, q, 0 * q, 0 * q), np.random.default_rng(0))
    late = round(settings.settled / setup.dt)
    qa, qda, qdda = (x[late:, list(model.device.active)].T for x in (found.q, found.qd, found.qdd))
    J = handle_motion(model, qa).jacobian[:, LINEAR]
    speed = np.einsum("pij,jp->pi", J, qda) @ direction
    acceleration = (np.einsum("pij,jp->pi", J, qdda) + drift(model, qa, qda)[:, LINEAR]) @ direction
    columns = np.column_stack([acceleration, speed, np.ones_like(speed)])
    return float(np.linalg.lstsq(columns, found.hand[late:] @ direction, rcond=None)[0][0])


def bound(settings: Compensating, estimated: Estimate, pose: Array, lag: float) -> float:
    """Share below which the loop is stable while a hand holds the handle."""
    J = handle_motion(estimated.model, pose[:, None]).jacobian[0, LINEAR]
    inertia = mass_matrix(estimated.model, estimated.beta, pose[:, None])[0]
    return stable_share(inertia, settings.hand_damping * J.T @ J, settings.hand_stiffness * J.T @ J, lag)
