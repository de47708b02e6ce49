"""The frequency response of logs that repeat beside the fit of elastic motors: where it begins, and in the report."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import haptid
from elastic_motors import DT, FV, FVM, IA, STEP, TRUTH, D, J, K, axis, recorded, treated
from haptid.inference.frequency_response import modelled_compliance, response_of_motors
from haptid.report import make_report
from haptid.treatment_choice import spring_start
from haptid.treatment_choice.hidden_joints import complete_logs

PERIOD = 2.0
STUDY = """schema = 1
name = "axis"
device = "axis.toml"

[[logs]]
path = "log.csv"

[channels]
time = "t"
position = { channels = ["theta"], unit = "rad" }
torque = { channels = ["u"], unit = "N m", side = "motor" }

[treatment]
torque_delay_s = 0.0
"""
AXIS = """schema = 1
name = "axis"
gravity = [0.0, 0.0, -9.81]
joints = [{ name = "1" }]
terms = [
    { kind = "elastic", motors = "all" },
    { kind = "rotor-inertia", motors = "all" },
    { kind = "viscous", joints = "all" },
    { kind = "viscous", motors = "all" },
]
"""


def compliance(s):
    """Position by torque of the motor in closed form."""
    load, bend = J * s**2 + FV * s, K + D * s
    return 1 / (IA * s**2 + FVM * s + load * bend / (load + bend))


def repeating(seconds: float = 8.0) -> haptid.Log:
    """The motor's side along a multisine of the motor up to 16 Hz with this period, in closed form."""
    rng, t = np.random.default_rng(2), DT * np.arange(round(seconds / DT))
    s = 2j * np.pi * np.arange(1, 33) / PERIOD
    motor = (1.5 / np.abs(s)) * np.exp(1j * rng.uniform(0, 2 * np.pi, len(s)))
    theta, tau = ((x[:, None] * np.exp(s[:, None] * t)).real.sum(axis=0) for x in (motor, motor / compliance(s)))
    seen, tau = STEP * np.round(theta / STEP), tau + 0.01 * tau.std() * rng.standard_normal(len(t))
    channels = haptid.Channels(haptid.Signal(("theta",), "rad"), haptid.Signal(("u",), "N m", side="motor"), "t")
    return haptid.Log(Path("made"), "", t, seen[:, None], tau[:, None], channels)


def test_a_fit_begins_at_the_measured_frequency(monkeypatch):
    """Without any other start: the fit has nothing but the frequency of the response."""
    monkeypatch.setattr(spring_start, "_TRIED", ())
    log = repeating()
    response = response_of_motors(axis(), [log], 0.0)
    (spring,) = response.springs
    _, found = complete_logs(axis(), [log], [True], {"1": spring.antiresonance}, torque_delay_s=0.0)
    assert found["KE1"].value == pytest.approx(K, rel=0.02)
    low, high = spring.conf_int(0.999)
    assert low < found["KE1"].value < high


def test_logs_that_do_not_repeat_have_no_response():
    log = repeating(seconds=3.0)
    assert response_of_motors(axis(), [log]) is None


def test_the_report_has_measured_and_modelled_compliance(tmp_path):
    (tmp_path / "axis.toml").write_text(AXIS)
    (tmp_path / "study.toml").write_text(STUDY)
    log = repeating()
    rows = np.column_stack([log.t, log.position, log.torque])
    np.savetxt(tmp_path / "log.csv", rows, delimiter=",", header="t,theta,u", comments="")
    made = haptid.identify(haptid.read_study(tmp_path / "study.toml"))
    assert made.estimate["KE1"].value == pytest.approx(K, rel=0.02)
    f = made.response.f
    np.testing.assert_allclose(made.response.period, PERIOD)
    found, motion = made.estimate, made.runs[0].motion
    model = modelled_compliance(found.model, found.beta, motion, f)[:, 0, 0]
    np.testing.assert_allclose(np.abs(model / compliance(2j * np.pi * f) - 1), 0.0, atol=0.1)
    section = make_report(made).sections["residual"]
    (chart,) = (section.charts[k] for k in section.responses)
    assert "compliance" in chart.title
    assert "in the band at" in chart.caption


def test_the_modelled_compliance_is_the_closed_form():
    model = axis()
    exact, f = np.array([TRUTH[name] for name in model.base.names]), np.geomspace(0.5, 40.0, 30)
    made = modelled_compliance(model, exact, treated(recorded(seconds=3.0)), f)
    np.testing.assert_allclose(made[:, 0, 0], compliance(2j * np.pi * f), rtol=1e-9)
