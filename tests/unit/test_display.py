"""What a prompt and a notebook show of the values that a user meets: short, whole, and no markup of a file's."""

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest

import haptid
from haptid._internal.display import _FEW, Overview
from haptid.inference.diagnosis import diagnose
from motions import multisine, truth
from small_study import two_links, write_study

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


def test_settings_are_a_table_in_a_notebook_and_whole_at_a_prompt(values):
    motion = next(value for value in values if isinstance(value, haptid.Motion))
    for made in (motion.treatment, motion.log.channels):
        assert repr(made).startswith(f"{type(made).__name__}(")
        shown = made._repr_html_()
        assert "<b>" not in shown
        assert all(f"<td>{field.name}</td>" in shown for field in dataclasses.fields(made))
    assert "<td>30.0</td>" in motion.treatment._repr_html_()


def test_a_study_and_a_parameter_are_shown(values, tmp_path):
    study = haptid.read_study(write_study(tmp_path))
    for entry in study.logs:
        assert f"<td>{entry.path}</td><td>{entry.role}</td>" in study._repr_html_()
    assert len(repr(study).splitlines()) == 1 + 1 + len(study.logs) + 2
    estimate = next(value for value in values if isinstance(value, haptid.Estimate))
    for p in estimate.parameters:
        name, value, *_ = repr(p).replace("=", " ").split()
        assert (name, float(value)) == (p.name, pytest.approx(p.value, abs=p.se))
        assert repr(p).splitlines()[0] in p._repr_html_()


def test_a_long_table_says_how_much_is_left_out():
    made = Overview("many", ("a",), [[str(k)] for k in range(100)], ("note",))
    assert len(made.text().splitlines()) == _FEW + 4
    assert "and 86 more" in made.text()
    assert "and 40 more" in made.html()
