"""What a prompt and a notebook show of the values that a user meets: short, whole, and no markup of a file's."""

import re
from pathlib import Path

import numpy as np
import pytest

import haptid
from haptid._internal.display import _FEW, Overview
from haptid.inference.diagnosis import diagnose
from motions import multisine, truth
from small_study import two_links

LINES = 20


@pytest.fixture(scope="module")
def values():
    """Each value of the pipeline, of a small device."""
    model = two_links()
    q, qd, qdd = multisine(2, 6.0, 2e-3, 1)
    tau = haptid.inverse_dynamics(model, truth(model) + 0.1, q, qd, qdd)
    tau += 0.02 * np.random.default_rng(1).standard_normal(tau.shape)
    channels = haptid.Channels(haptid.Signal(("<b>q1", "q2"), "rad"), haptid.Signal(("t1", "t2"), "N m"), rate_hz=500.0)
    log = haptid.Log(Path("made"), "x", 2e-3 * np.arange(q.shape[1]), q.T, tau.T, channels)
    motion = haptid.treat(log, haptid.Treatment(cutoff_hz=30.0, decimation=5))
    estimate = haptid.estimate(haptid.observe(model, motion), haptid.WLS())
    diagnosis = diagnose(estimate)
    return [model.device, model, log, motion, estimate.observation, estimate, diagnosis.validation, diagnosis]


def test_each_is_short_at_a_prompt_and_a_table_in_a_notebook(values):
    for value in values:
        lines = repr(value).splitlines()
        assert 1 < len(lines) <= LINES, type(value)
        assert max(map(len, lines)) <= 160
        shown = value._repr_html_()
        assert len(shown) < 12000
        assert shown.count("<table") == shown.count("</table>") == 1
        assert "<b>" not in shown


def test_the_figures_are_those_of_the_value(values):
    estimate = next(value for value in values if isinstance(value, haptid.Estimate))
    for p in estimate.parameters:
        row = next(line for line in repr(estimate).splitlines() if line.split()[:1] == [p.name])
        assert float(row.split()[1]) == pytest.approx(p.value, abs=max(p.se, 1e-6))
        assert re.search(rf"<td>{p.name}</td>", estimate._repr_html_())


def test_a_long_table_says_how_much_is_left_out():
    made = Overview("many", ("a",), [[str(k)] for k in range(100)], ("note",))
    assert len(made.text().splitlines()) == _FEW + 4
    assert "and 86 more" in made.text()
    assert "and 40 more" in made.html()
