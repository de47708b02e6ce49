"""Run FloBaRoID's own search for an exciting trajectory and keep its progress; in an interpreter with its packages.

Called by `benchmarks/beside_flobaroid.py`: python flobaroid_search.py CHECKOUT CONFIG URDF OUT.npz
"""

import runpy
import sys
import time

import numpy as np

checkout, config, urdf, out = sys.argv[1:]
sys.path.insert(0, checkout)
from excitation.trajectoryOptimizer import TrajectoryOptimizer  # noqa: E402

evaluate, best, found = TrajectoryOptimizer.objectiveFunc, [np.inf], []
begun = time.process_time()
spent = [0]


def noted(self, x, *args, **kwargs):
    """The objective, with a note of each motion within all constraints that is the best so far."""
    made = evaluate(self, x, *args, **kwargs)
    spent[0] += 1
    least = self.num_constraints - self.num_coll_constraints
    g = np.asarray(made[1])
    inside = bool((g[:least] <= 0).all() and (g[least:] > 0).all())
    if inside and made[0] < best[0]:
        best[0] = float(made[0])
        data = self.last_trajectory_data
        states = [np.asarray(data[key]) for key in ("target_positions", "target_velocities", "target_accelerations")]
        found.append((time.process_time() - begun, spent[0], made[0], np.array(states), np.asarray(data["times"])))
        np.savez(
            out,
            seconds=[one[0] for one in found],
            evaluations=[one[1] for one in found],
            objective=[one[2] for one in found],
            **{f"states{k}": one[3] for k, one in enumerate(found)},
            **{f"times{k}": one[4] for k, one in enumerate(found)},
        )
    return made


TrajectoryOptimizer.objectiveFunc = noted
sys.argv = ["trajectory.py", "--config", config, "--model", urdf, "--filename", out + ".trajectory.npz"]
runpy.run_path(checkout + "/trajectory.py", run_name="__main__")
print(f"finished after {time.process_time() - begun:.1f} s of processor time, {spent[0]} evaluations")
