"""Logs of the bench, treated as proposed, give the true parameters back: a small version of the benchmark."""

import pytest

from bench_identification import CASES, study
from haptid.experiment import bench

# Five times the default step, s. Beside the limits below, errors of this seed change by 0.18 at most, and the largest
# is 0.84 of its limit (0.88 with the default step).
PHYSICS = bench.Physics(5e-4)

# Per cent of: the exact torque on unseen motion, parameters, Coulomb and viscous friction.
LIMITS = {
    "exact states": (0.01, 0.05, 0.01, 0.2),
    "differentiated": (0.05, 0.1, 0.05, 0.5),
    "encoders": (0.2, 1.0, 0.2, 3.0),
}


@pytest.mark.parametrize("name", [name for name in CASES if "7" not in name])
def test_logs_of_the_bench_give_the_truth_back(name):
    found = study(name, seed=1, seconds=16.0, physics=PHYSICS)
    for sort, limits in LIMITS.items():
        for (what, error), limit in zip(found[sort].items(), limits, strict=True):
            assert error <= limit, (sort, what)
