"""The example that does better than the published condition number of close to 50."""

import json
from pathlib import Path

import numpy as np
import pytest

import exciting_motion
import haptid
from haptid.experiment import bench
from haptid.experiment.bench.limits import FLAT, loop_conditioning
from haptid.experiment.excitation import observed_motion, quality

RESULTS = Path(exciting_motion.__file__).parent / "results" / "exciting-motion.json"


def test_the_wide_example_has_a_condition_below_fifty():
    model = haptid.DynamicModel(haptid.read_device("cea_medical_branch"))
    experiment = bench.read_experiment(exciting_motion.EXAMPLES / "excite-wide.toml")
    made = bench.plan(experiment.kind, model, 0.02, np.random.default_rng(0))
    scaled = quality(observed_motion(model, made), tuple(range(34)), np.zeros(34), np.ones(3)).scaled
    recorded = json.loads(RESULTS.read_text())["figures"]["excite-wide, condition with unit columns"]
    assert scaled < 50
    assert scaled == pytest.approx(recorded, rel=0.02)
    assert loop_conditioning(model, model.device.closure.positions(made.q.T).T).min() > FLAT


def test_a_short_search_comes_near_it():
    """A fifth of the usual evaluations, from 2000 and more before the search."""
    found, _, _ = exciting_motion.race("cea_medical_branch", 320, seed=0)
    assert found.before.scaled > 1000
    assert found.after.scaled < 75
