"""Torques, mass matrices, accelerations, simulation, maps and condition numbers beside peers: see `kernel.py`.

Ours are for all samples in one call: the public functions, and what simulated estimators call. A simulation step is
torque held, velocity first, then position with the new velocity: what MuJoCo does.
"""

from __future__ import annotations

import json

import numpy as np

import haptid
from arm import Arm
from compare_peers import alone, compared
from haptid.dynamics.forward import ForwardDynamics, sets_of
from haptid.end_effector.characterisation import GivenParameters, apparent_mass
from haptid.experiment.bench.trajectories import Trajectory
from haptid.experiment.excitation import Limits, RawCondition, motion_condition
from haptid.experiment.excitation.gradients import Gradients
from haptid.experiment.excitation.limits import MotionBounds
from stopwatch import Work

# As `peers/common.py` has them.
MANY, STEPS, STEP, TRAJECTORY = 2048, 10, 1e-4, 200
# How sharp a search's stand-in is, and how much its limits weigh, half way down.
POWER, WEIGHT = 2.0, 1e3
PEERS = ("Pinocchio C++", "Pinocchio Python", "MuJoCo", "iDynTree", "figaroh")


def run() -> dict[str, float]:
    """Microseconds per sample, disagreements and ratios; one thread."""
    return alone(__file__, 1)


def works(arm: Arm) -> dict[str, Work]:
    """Ours."""
    model, beta = arm.model, arm.beta
    q, qd, qdd, tau = (np.ascontiguousarray(x[:, :MANY]) for x in (arm.q, arm.qd, arm.qdd, arm.tau))
    direct, identified = ForwardDynamics(model, sets_of(model, beta)), GivenParameters(model, beta)

    def simulated() -> tuple[np.ndarray, np.ndarray]:
        c, cd = q, qd
        for _ in range(STEPS):
            cd = cd + STEP * direct.acceleration(c, cd, tau)
            c = c + STEP * cd
        return c, cd

    return {
        "inverse dynamics": Work(MANY, lambda: haptid.inverse_dynamics(model, beta, q, qd, qdd), np.transpose),
        "mass matrix": Work(MANY, lambda: haptid.dynamics.mass_matrix(model, beta, q)),
        "forward dynamics": Work(MANY, lambda: direct.acceleration(q, qd, tau), np.transpose),
        "simulation step": Work(MANY * STEPS, simulated, lambda end: np.concatenate(end).T),
        "apparent masses": Work(
            MANY, lambda: apparent_mass(identified, q, worst_condition=1e9), lambda found: found.mass.values
        ),
    }


def search(arm: Arm, motion: Trajectory) -> tuple[Work, Work]:
    """What a search for a motion asks: the smooth stand-in for the condition number, and the same with its slopes."""
    slopes = Gradients.of(
        MotionBounds.of(arm.model, Limits(((-3.0, 3.0),) * arm.n, (9.0,), (99.0,)), arm.beta),
        RawCondition(),
        tuple(range(len(arm.beta))),
        np.ones(arm.n),
    )
    states = np.array([motion.q.T, motion.qd.T, motion.qdd.T])
    return Work(1, lambda: slopes.at(states).cost()), Work(1, lambda: slopes(states, POWER, WEIGHT))


def searched(taken: float, sloped: float, figures: dict[str, float]) -> dict[str, float]:
    """The time of a try of a search, beside the peers' of a condition number: they have no smooth stand-in."""
    made, work = {"cost of a motion in a search: haptid, us": taken}, "condition number of a motion"
    made["cost of a motion and its slopes by all states: haptid, us"] = sloped
    for peer in PEERS:
        theirs = figures.get(f"{work}: {peer}, us")
        if theirs is not None:
            made[f"cost of a motion in a search: {peer} over haptid"] = theirs / taken
    return made


def main() -> None:
    """JSON."""
    arm = Arm()
    motion = Trajectory(0.01, *(np.ascontiguousarray(x[:, :TRAJECTORY].T) for x in (arm.q, arm.qd, arm.qdd)))
    ours = works(arm)
    ours["condition number of a motion"] = Work(1, lambda: motion_condition(arm.model, motion))
    figures = compared(arm.case(), ours, PEERS)
    figures |= searched(*(work.microseconds() for work in search(arm, motion)), figures)
    print(json.dumps(figures))


if __name__ == "__main__":
    main()
