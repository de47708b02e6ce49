"""The verdict names the obstacle in plain words."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from haptid.advice import Action, Advice, verdict_with
from haptid.advice.action import CHANGES
from haptid.advice.search import unseen_percent
from haptid.inference.diagnosis.finding import Finding
from haptid.inference.diagnosis.verdict import (
    COMPENSATION,
    MEANING,
    PREDICTION,
    SINGLE_PARAMETERS,
    ProvenChange,
    verdict,
)
from haptid.validation.validation import MotorError, Validation

LOOKS = (*PREDICTION, *COMPENSATION, *SINGLE_PARAMETERS)


def estimate(parameters):
    """An estimate of these parameters."""
    return SimpleNamespace(
        parameters=parameters,
        free_parameters=parameters,
        observation=SimpleNamespace(motors=()),
    )


def parameter(name, relative_se=1.0, excited=True):
    return SimpleNamespace(name=name, relative_se=relative_se, excited=excited)


def given(relative, statuses, told=4, seen=False, unexcited=(), proven=None):
    """The verdict on an estimate of four parameters, `told` of them known well, and some `unexcited`."""
    parameters = [parameter(f"P{k}", 1.0 if k < told else 50.0, f"P{k}" not in unexcited) for k in range(4)]
    errors = Validation((MotorError("1", "motor 1", "N m", relative, 100.0, 10),), seen)
    findings = [Finding(name, statuses.get(name, "ok"), {"p": 1e-5}, f"About {name}.") for name in LOOKS]
    return verdict(estimate(parameters), errors, findings, proven)


def test_every_look_that_counts_has_plain_words():
    assert set(LOOKS) == set(MEANING)
    assert not any(term in words for words in MEANING.values() for term in ("in W", "whiteness", "bent"))


def test_a_good_model_is_good_for_everything():
    made = given(0.2, {})
    assert (made.torque, made.compensation, made.parameters) == ("ok", "ok", "ok")
    assert made.sentences == (
        "The model is good for predicting torque: the torque error of motor 1 is 0.20 % (on unseen rows; limits 5 and "
        "20 %).",
        "It is good for compensation of friction and gravity.",
        "It is good for quoting single parameters: all 4 have standard errors below 10 %.",
    )
    assert made.looks == ((), (), ())


@pytest.mark.parametrize("name", LOOKS)
def test_what_made_a_use_unfit_is_its_reason(name):
    made = given(0.2, {name: "bad"})
    assert made.parameters == "bad"
    assert made.sentences[2] == (
        f"It is not fit for quoting single parameters, because {MEANING[name]}, though all 4 have standard errors "
        "below 10 %."
    )
    assert made.looks[2] == (name,)
    assert (MEANING[name] in made.sentences[0]) == (name in PREDICTION)
    assert (MEANING[name] in made.sentences[1]) == (name in PREDICTION + COMPENSATION)


def test_a_large_error_is_itself_the_reason():
    made = given(30.0, {}, told=1)
    assert "not fit for predicting torque, because the torque error of motor 1 is 30 %" in made.sentences[0]
    assert (
        "not fit for compensation of friction and gravity, because the torque error of motor 1 is 30 %"
        in made.sentences[1]
    )
    assert "with care for quoting single parameters, because only 1 of 4" in made.sentences[2]


def test_parameters_that_rounding_invents_are_not_counted_as_told():
    """They are said not to be quoted, and were among those with small standard errors."""
    told = given(0.2, {}, unexcited=("P1",)).sentences[2]
    assert "because only 3 of 4 have standard errors below 10 % (P0, P2 and P3)" in told


def test_the_gravest_reasons_are_named_and_the_rest_counted():
    made = given(0.2, dict.fromkeys(LOOKS, "bad") | {"units and signs": "doubt"})
    assert f"and {len(LOOKS) - 4} more reasons, though" in made.sentences[2]
    assert MEANING["units and signs"] not in made.sentences[2]


def test_without_unseen_rows_a_validation_is_wanted():
    assert given(0.2, {"drift": "bad"}, seen=True).sentences[3:] == ("Validate it on another log.",)
    assert len(given(0.2, {"drift": "bad"}).sentences) == 3


def test_negative_friction_is_not_said_of_the_torque():
    parameters = [parameter("P")]
    errors = Validation((MotorError("1", "motor 1", "N m", 0.2, 100.0, 10),), False)
    both, bodies = {"negative FV1": -0.1, "negative IA2": -1.0}, "the inertial torque of the device file's bodies."
    for sentence, figures, words in (
        ("FV1 negative, which is impossible.", {"negative FV1": -0.1}, "FV1 of friction or rotors is negative"),
        ("FV1 and IA2 negative, which is impossible.", both, "FV1 and IA2 of friction or rotors are negative"),
        (f"The torque of 1 is 3 times {bodies}", both, MEANING["units and signs"]),
    ):
        findings = [Finding("units and signs", "doubt", figures, sentence)]
        made = verdict(estimate(parameters), errors, findings)
        assert f"because {words}" in made.sentences[0]


def motor(name, unit, residual, measured):
    return MotorError(name, f"motor {name}", unit, residual, measured, 10)


DEAD = (motor("1", "N m", 1.0, 10.0), motor("2", "N m", 1.0, 0.01), motor("3", "N", 4.0, 20.0))


def test_a_motor_with_hardly_any_torque_does_not_decide():
    """It made 17 846 % of 43, and the verdict."""
    errors = Validation(DEAD, False)
    assert errors.mixed
    assert errors.relative == pytest.approx(100 * math.sqrt((2 / 100.0001 + 0.04) / 2))
    assert [m.motor for m in errors.silent] == ["2"]
    assert errors.largest.motor == "3"
    parameters = [parameter("P")]
    made = verdict(estimate(parameters), errors, [])
    assert (made.torque, made.parameters) == ("doubt", "doubt")
    assert "the torque error of motor 3 is 20 %" in made.sentences[0]
    assert "motor 2 has hardly any torque" in made.sentences[0]


def test_a_small_motor_is_named_and_does_not_decide_and_a_large_one_does():
    """A wrist with 0.7 % of the torque and an error of 81 % made a model of 3.7 % unfit for anything."""
    small = Validation((replace(DEAD[0], residual=0.4), motor("2", "N m", 0.057, 0.07)), False)
    assert (small.silent, small.largest.motor) == ((), "1")
    assert [(m.motor, round(share, 3)) for m, share in small.small] == [("2", 0.007)]
    parameters = [parameter("P")]
    made = verdict(estimate(parameters), small, [])
    assert made.torque == "doubt"
    assert (
        "motors with hardly any torque have errors above 20 % (motor 2 81 %), though the torque error of motor 1 is 4"
        in made.sentences[0]
    )
    wrong = Validation((DEAD[0], motor("2", "N m", 40.0, 1.0)), False)
    assert (wrong.silent, wrong.largest.motor) == ((), "2")


def test_channels_without_any_torque_leave_an_error():
    constant = Validation((DEAD[0], motor("3", "N", 4.0, 0.0)), False)
    assert constant.relative == pytest.approx(10.0)  # a unit without torque is left out
    nothing = Validation((motor("1", "N m", 1.0, 0.0),), False)
    assert (nothing.relative, nothing.largest.motor) == (math.inf, "1")


@pytest.mark.parametrize("units", [("N m", "N m", "N m"), ("N m", "N m", "N")])
def test_advice_has_the_error_of_all_motors_that_tables_have(units):
    rng = np.random.default_rng(0)
    residual, measured = rng.uniform(1, 2, (6, 3)), np.array([5.0, 0.1, 20.0])
    motors = [motor(str(k), units[k], np.linalg.norm(residual[:, k]), measured[k]) for k in range(3)]
    weights = np.array([1.0, 3.0, 0.5])
    bench = SimpleNamespace(weights=weights, sizes=lambda _: measured**2)
    model = SimpleNamespace(device=SimpleNamespace(torque_units=units, free_rows=(False,) * 3), known_rows=range(3))
    trial = SimpleNamespace(errors=residual**2 * weights**2, setting=None)
    assert unseen_percent(model, bench, trial) == pytest.approx(Validation(tuple(motors), False).relative)
    assert unseen_percent(model, bench, trial, 1) == pytest.approx(motors[1].relative)


def test_a_proven_change_takes_the_place_of_what_residuals_seem_to_be_caused_by():
    statuses = {"time delay": "bad", "units and signs": "doubt", "ripple": "bad", "collinearity": "doubt"}
    before = given(0.3, statuses)
    after = given(0.3, statuses, proven=ProvenChange("reverse the torque channel of motor 1", frozenset()))
    assert (after.torque, after.compensation, after.parameters) == (
        before.torque,
        before.compensation,
        before.parameters,
    )
    assert MEANING["time delay"] in before.sentences[0]
    said = " ".join(after.sentences)
    assert 'the proven change "reverse the torque channel of motor 1" is not made' in said
    assert MEANING["units and signs"] in said  # tells it from bodies, and not from residuals
    assert not any(MEANING[name] in said for name in ("time delay", "ripple"))
    agreeing = given(0.3, statuses, proven=ProvenChange("add a ripple", frozenset({"ripple"})))
    assert MEANING["ripple"] in " ".join(agreeing.sentences)
    assert MEANING["time delay"] not in " ".join(agreeing.sentences)


@pytest.mark.parametrize(
    ("kind", "label", "said"),
    [
        (
            "drift",
            "joint 1",
            "split the log, or record at one temperature, as the friction or offset of joint 1 drifts with time",
        ),
        ("torque sign", "motor a:b", "reverse the torque channel of motor a:b"),
        (
            "dead torque",
            "motor 1",
            "leave out the torque channel of motor 1, which is dead: check its wiring, and record again",
        ),
    ],
)
def test_the_verdict_has_the_whole_instruction_of_what_is_proven(kind, label, said):
    """It was cut at a colon, in a joint's name too, and of drift it had no instruction at all."""
    change = CHANGES[kind].format(where=label)
    action = Action(kind, (label,), change, "unseen error", 48.0, 2.0, 0.5, 0.9, True, (), 24)
    parameters = [SimpleNamespace(name="P", relative_se=1.0, excited=True)]
    errors = Validation((MotorError("1", "motor 1", "N m", 0.3, 100.0, 10),), False)
    findings = [Finding("time delay", "bad", {"p": 1e-5}, "About it.")]
    fitted = estimate(parameters)
    diagnosis = SimpleNamespace(
        estimate=fitted, validation=errors, findings=findings, verdict=verdict(fitted, errors, findings)
    )
    made = verdict_with(diagnosis, Advice((action,), 48.0, 2.0, (), 40))
    assert f'the proven change "{said}" is not made' in made.sentences[0]
    assert MEANING["time delay"] not in str(made)


def test_what_no_change_confirms_is_what_residuals_look_like():
    """Friction that lags looks like a late torque, which was stated as a fact although no shift predicted better."""
    parameters = [SimpleNamespace(name="P", relative_se=1.0, excited=True)]
    errors = Validation((MotorError("1", "motor 1", "N m", 0.3, 6.0, 10),), False)
    findings = [Finding("time delay", "bad", {"p": 1e-5}, "About it."), Finding("ripple", "bad", {"p": 1e-5}, "It.")]
    fitted = estimate(parameters)
    diagnosis = SimpleNamespace(
        estimate=fitted, validation=errors, findings=findings, verdict=verdict(fitted, errors, findings)
    )
    action = Action("ripple", ("motor 1",), "add a ripple", "unseen error", 6.0, 5.0, 0.1, 0.3, True, (), 24)
    assert f"because {MEANING['time delay']}" in diagnosis.verdict.sentences[0]
    kinds = frozenset(("ripple", "time shift"))
    made = verdict_with(diagnosis, Advice((action,), 6.0, 5.0, (), 40, kinds=kinds))
    assert f"look as where {MEANING['time delay']}, which no change that was tried confirms" in made.sentences[0]
    assert made.parameters == "bad"  # by the ripple, which is proven
    assert MEANING["ripple"] in made.sentences[2]
    assert MEANING["time delay"] not in made.sentences[2]
    untried = verdict_with(diagnosis, Advice((), 6.0, 6.0, ("No action is tried.",), 0))
    assert untried.sentences == diagnosis.verdict.sentences
    unjudged = verdict_with(diagnosis, Advice((replace(action, kind="torque sign"),), 6.0, 5.0, (), 40))
    assert unjudged.sentences == diagnosis.verdict.sentences
    nothing = verdict_with(diagnosis, Advice((), 6.0, 6.0, (), 40, kinds=kinds))
    assert nothing.compensation == nothing.parameters == "doubt"
