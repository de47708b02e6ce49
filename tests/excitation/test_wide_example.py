"""The example that does better than the published condition number of close to 50, and the gradient of its search."""

import json
from pathlib import Path

import numpy as np
import pytest

import exciting_motion
from haptid import bench
from haptid.bench.limits import FLAT, loop_openness

RESULTS = Path(exciting_motion.__file__).parent / "results" / "exciting-motion.json"


def test_the_wide_example_has_a_condition_below_fifty():
    cost = exciting_motion.Cost(exciting_motion.Series(1.3, 13.0, 200.0))
    experiment = bench.read_experiment(exciting_motion.EXAMPLES / "excite-wide.toml")
    made = bench.plan(experiment.kind, cost.device, 0.02, np.random.default_rng(0))
    W = cost.W(np.array([made.q.T, made.qd.T, made.qdd.T])).transpose(0, 2, 1).reshape(-1, 34)
    scaled = np.linalg.cond(W / np.linalg.norm(W, axis=0))
    recorded = json.loads(RESULTS.read_text())["figures"]["excite-wide, condition with unit columns"]
    assert scaled < 50
    assert scaled == pytest.approx(recorded, rel=0.02)
    q = cost.device.closure.positions(made.q.T).T
    assert loop_openness(cost.device, q).min() > FLAT


def test_the_gradient_of_the_search_is_that_of_its_cost():
    series = exciting_motion.Series(1.0, 6.0, 40.0, count=3, samples=40)
    cost, rng = exciting_motion.Cost(series), np.random.default_rng(1)
    x = series.start(rng)
    way = rng.normal(size=x.shape) / np.sqrt(len(x))
    step = 1e-5
    slope = (cost(x + step * way, 2, 30.0)[0] - cost(x - step * way, 2, 30.0)[0]) / (2 * step)
    assert cost(x, 2, 30.0)[1] @ way == pytest.approx(slope, rel=1e-3)
