"""Causes that were missed, or named behind others, on logs of the zoo: each is the first action now."""

from __future__ import annotations

import tomllib
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pyarrow.csv
import pytest

from haptid.advice import advise, verdict_with
from haptid.advice import apply_advice as applied
from haptid.advice.proof import _together
from haptid.advice.search import TriedChange
from haptid.advice.trial import Fitted, Setting, Trial, gain
from haptid.inference.diagnosis import diagnose
from haptid.inference.diagnosis.verdict import MEANING
from haptid.study.identify import identify
from haptid.study.read import read_study
from zoo.advised import rank
from zoo.case import Case
from zoo.wrong import WrongPlant, identified, written

SHORT = Case(90211016, "arm2", 1000, 12, 1.0964, 3, bits=18, friction=0.1, noise="AR", level=0.0056, delay=0.5)
CAUSES = {
    # All of its blocks' errors fall, and these differ as much as the errors of a large cause do.
    "a unit": ("unit", SHORT),
    # Steps far below the noise of the model's acceleration, or hidden in the noise of the torque.
    "steps of a torque": (
        "coarse",
        Case(90211035, "axis", 1000, 20, 2.285, 4, bits=14, friction=0.3, noise="AR", level=0.0056, delay=0.5),
    ),
    "steps of two torques": (
        "coarse",
        Case(90211031, "arm2", 250, 12, 0.9825, 3, bits=15, friction=0.1, level=0.0205, delay=0.5),
    ),
    # The motion repeats itself to the sample, or has the states of the contact in contacts only.
    "a contact in motion that repeats": (
        "contact",
        Case(90211062, "axis", 500, 30, 1.991, 3, bits=17, friction=0.1, level=0.0124, delay=1.0),
    ),
    "contacts at the same states": (
        "contact",
        Case(90211065, "arm2", 1000, 12, 0.7093, 5, bits=17, friction=0.1, level=0.0219),
    ),
    # Its rest is not in the middle of the range.
    "a spring": ("spring", Case(90211068, "pendulum", 1000, 12, 1.572, 3, bits=15, friction=0.1, level=0.0047)),
    # Nine samples, of the only channel.
    "a late torque": ("time shift", Case(90211055, "pendulum", 250, 12, 2.424, 3, bits=15, noise="AR", level=0.006)),
    # Dry friction near reversals was a part of the slope.
    "a length": (
        "length",
        Case(90211104, "arm2", 500, 30, 2.411, 3, bits=17, friction=0.3, noise="AR", level=0.0062, delay=1.0),
    ),
    # Its own bodies cannot exist, which is no reason to reverse all torques.
    "exchanged torques": ("torque swap", Case(90211024, "arm2", 250, 30, 1.722, 3, bits=15, level=0.0054)),
    # Its friction is negative in the fit of a channel that is zero most of the time.
    "a dead torque": ("dead", Case(1129014, "arm2", 250, 20, 1.047, 3, bits=14, friction=0.1, noise="AR", level=0.02)),
    # The bodies make up for it, and seemed to be in another unit.
    "load friction": (
        "load friction",
        Case(1129044, "phantom", 500, 12, 0.8675, 4, bits=16, friction=0.1, level=0.01553, delay=1.0),
    ),
    # Of one motor, whose error is that of all.
    "a payload": (
        "payload",
        Case(90211116, "pendulum", 500, 12, 1.748, 5, bits=15, friction=0.1, level=0.005051, delay=0.5),
    ),
    # Faster than the motion, so that the proposed filter passed hardly any of either.
    "a ripple behind a low filter": (
        "ripple",
        Case(90211097, "pendulum", 250, 30, 0.6778, 3, bits=14, friction=0.3, level=0.01366, delay=0.5),
    ),
    # A delay of -28 ms was compensated that left 15.0 % in place of 15.1.
    "a reversed torque that looks early": (
        "torque sign",
        Case(4802003, "arm2", 500, 30, 2.17633, 5, bits=18, friction=0.3, level=0.01707, delay=1.0),
    ),
    # It was Stribeck friction below zero, which cannot be.
    "friction that is less in slow motion": (
        "degressive friction",
        Case(5, "arm2", 500, 20, 1.1, 4, bits=16, friction=0.5, level=0.01, delay=0.5),
    ),
    # The only position, held while the torque goes on.
    "a stuck position": (
        "stuck",
        Case(57482020, "axis", 500, 30, 0.714, 4, bits=15, friction=0.1, level=0.006847, delay=1.0),
    ),
}


@pytest.mark.parametrize("name", CAUSES)
def test_the_cause_is_named_first(name: str, tmp_path: Path) -> None:
    cause, case = CAUSES[name]
    plant = WrongPlant(case, cause)
    wrong = identified(plant, tmp_path)
    made = advise(wrong, diagnose(wrong.estimate))
    assert rank(plant, [[action.kind, *action.places] for action in made.actions]) == 1, made.sentences


def test_of_two_signs_that_predict_alike_the_one_whose_bodies_can_exist_is_named(tmp_path: Path) -> None:
    """Either motor of a coupled pair may be reversed; one of both leaves all inertias negative."""
    case = Case(90211002, "arm2", 500, 12, 1.527, 5, bits=18, friction=0.5, noise="AR", level=0.0189, delay=1.0)
    plant = WrongPlant(case, "torque sign")
    made = advise(identified(plant, tmp_path))
    signs = [action for action in made.actions if action.kind == "torque sign"]
    assert [action.places for action in signs] == [(f"motor {plant.motor + 1}",)]
    assert not signs[0].rivals


def test_the_verdict_names_the_proven_sign_and_no_delay(tmp_path: Path) -> None:
    """Residuals of a reversed torque look late."""
    case = Case(44, "arm2", 250, 16, 0.7, 3, bits=16, friction=0.5, level=0.0129, delay=1.0)
    wrong = identified(WrongPlant(case, "torque sign"), tmp_path)
    looks = diagnose(wrong.estimate)
    assert MEANING["time delay"] in str(looks.verdict)
    made = verdict_with(looks, advise(wrong, looks))
    assert MEANING["time delay"] not in str(made)
    assert "reverse the torque" in made.sentences[0]
    assert (made.torque, made.parameters) == (looks.verdict.torque, looks.verdict.parameters)


def test_steps_are_stated_by_what_coarser_ones_do(tmp_path: Path) -> None:
    plant = WrongPlant(CAUSES["steps of a torque"][1], "coarse")
    (action,) = advise(identified(plant, tmp_path)).actions
    assert "with steps 3 times as coarse the error" in action.sentence
    assert action.after < action.before
    assert action.edits == ()


def test_what_hides_behind_a_late_torque_is_found_with_it(tmp_path: Path) -> None:
    """A spring, with torques 36 ms late: the shift alone was advised, and the spring once it was applied."""
    case = Case(3, "pendulum", 250, 16, 1.6, 3, bits=16, friction=0.1, level=0.005)
    plant, late = WrongPlant(case, "spring"), 9
    study = written(plant, tmp_path)
    table = pyarrow.csv.read_csv(tmp_path / "log.csv").to_pydict()
    rows = slice(late, None)
    shifted = {name: np.array(values)[rows] for name, values in table.items()}
    shifted["u1"] = np.array(table["u1"])[:-late]
    pyarrow.csv.write_csv(pyarrow.table(shifted), tmp_path / "log.csv")
    wrong = identify(read_study(_without_delay(study)))
    made = advise(wrong)
    assert [action.kind for action in made.combination][:2] == ["time shift", "spring"], made.sentences
    assert made.after < 0.2 * made.before
    after = applied(made, wrong, tmp_path / "out")
    assert after is not None
    delay = after.identification.study.treatment["torque_delay_s"]
    np.testing.assert_allclose(delay, -late / case.rate, atol=1.0 / case.rate)  # the spring moves it by half a sample
    device = tomllib.loads((tmp_path / "out/device.toml").read_text())
    (spring,) = (term for term in device["terms"] if term["kind"] == "spring")
    assert spring["rest"] == pytest.approx(plant.motion.centre[0], abs=0.2)


def _without_delay(study: Path) -> Path:
    study.write_text(study.read_text() + "\n[treatment]\ntorque_delay_s = 0.0\n")
    return study


def test_degressive_friction_is_written_as_a_term_and_identified(tmp_path: Path) -> None:
    case = Case(6, "pendulum", 500, 20, 1.1, 4, bits=16, friction=0.5, level=0.01, delay=0.5)
    plant = WrongPlant(case, "degressive friction")
    wrong = identified(plant, tmp_path)
    made = advise(wrong)
    after = applied(made, wrong, tmp_path / "out")
    assert after is not None
    assert after.after < 0.3 * after.before
    (term,) = (p for p in after.identification.estimate.parameters if p.name == "FD_1")
    assert term.value > 3 * term.se


def test_one_motor_does_not_hide_what_is_proven_on_another() -> None:
    """Together their gain scattered too much, though one motor's alone was seven standard errors."""
    rng = np.random.default_rng(3)
    blocks = 24
    good, poor = rng.normal(0.10, 0.02, blocks), rng.normal(0.05, 0.50, blocks)
    errors = {"": np.ones(blocks), "good": 1 - good, "poor": 1 - poor, "both": 1 - good - poor}

    def trial(name: str) -> Trial:
        return Trial(settings[name], errors[name][:, None], Fitted(np.arange(1), (), np.ones(1), np.ones(1)))

    settings = {"": Setting(), "good": Setting(terms=(((1,),),)), "poor": Setting(terms=(((2,),),))}
    settings["both"] = settings["poor"].plus(settings["good"])
    names = {setting: name for name, setting in settings.items()}
    bench = SimpleNamespace(run=lambda setting: trial(names[setting]))
    members = [
        (TriedChange("ripple", (name,), settings[name]), trial(name), gain(trial(""), trial(name)))
        for name in ("poor", "good")
    ]
    found = [merged.places for merged, _, _ in _together(SimpleNamespace(bench=bench), trial(""), members)]
    assert found == [("good",)]
