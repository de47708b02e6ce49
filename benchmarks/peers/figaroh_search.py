"""Run figaroh's own search for an exciting trajectory and keep its progress; in an interpreter with its packages.

Called by `benchmarks/beside_figaroh.py`: python figaroh_search.py URDF CONFIG SEED OUT.npz

The released base class leaves one method to its users, which makes the problem for IPOPT: it is made from the class of
the same package that is meant for it. Its settings lack the indices of the joints in the regressor (`act_idxv`).
"""

import sys
import time

import numpy as np
from figaroh.optimal.base_optimal_trajectory import BaseOptimalTrajectory, BaseTrajectoryIPOPTProblem
from figaroh.tools.load_robot import load_robot

urdf, config, seed, out = sys.argv[1:]
best, found, spent = [np.inf], [], [0]
begun = time.process_time()


def save():
    """Write the motions so far, and the processor time."""
    np.savez(
        out,
        seconds=[one[0] for one in found],
        evaluations=[one[1] for one in found],
        objective=[one[2] for one in found],
        whole=time.process_time() - begun,
        **{f"states{k}": one[3] for k, one in enumerate(found)},
        **{f"times{k}": one[4] for k, one in enumerate(found)},
    )


class Problem(BaseTrajectoryIPOPTProblem):
    """Its problem, with a note of each iterate within all constraints that is the best so far."""

    def objective(self, X):
        """Condition number of its base regressor, at an iterate or a step of its finite differences."""
        spent[0] += 1
        return super().objective(X)

    def gradient(self, X):
        """By finite differences, once at each iterate."""
        self.note(X)
        return super().gradient(X)

    def note(self, X):
        """Keep the states where they are the best so far."""
        cost = self.objective(X)
        if cost < best[0] and self._is_feasible(X):
            best[0] = cost
            states = np.array([self.opt_cb[key] for key in ("p_f", "v_f", "a_f")])
            found.append((time.process_time() - begun, spent[0], cost, states, np.ravel(self.opt_cb["t_f"])))
            save()


class Searched(BaseOptimalTrajectory):
    """Its search, with the method that it leaves open."""

    def create_ipopt_problem(self, *args):
        """As its package means it."""
        self.problem = Problem(self, *args)
        return self.problem


np.random.seed(int(seed))  # noqa: NPY002, its search draws from this stream
robot = load_robot(urdf, package_dirs=".", load_by_urdf=True)
search = Searched(robot, list(robot.model.names)[1:], config)
search.identif_config["act_idxv"] = list(range(robot.model.nv))
search.initialize()
results = search.solve(stack_reps=1)
save()
print(f"{len(search.idx_b)} base parameters, {spent[0]} evaluations, {time.process_time() - begun:.1f} s")
for one in results["iteration_data"]:
    print(f"status {one['status']}, converged {one['converged']}, condition {one['obj_values'][-1]:.4g}")
