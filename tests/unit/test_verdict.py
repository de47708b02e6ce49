"""The verdict names the obstacle in plain words."""

from types import SimpleNamespace

import pytest

from haptid.inference.diagnosis.finding import Finding
from haptid.inference.diagnosis.verdict import COMPENSATION, MEANING, PREDICTION, SINGLE_PARAMETERS, verdict
from haptid.validation.validation import MotorError, Validation

LOOKS = (*PREDICTION, *COMPENSATION, *SINGLE_PARAMETERS)


def given(relative, statuses, told=4, seen=False):
    """The verdict on an estimate of four parameters, of which so many are told well."""
    parameters = [SimpleNamespace(name=f"P{k}", relative_se=1.0 if k < told else 50.0) for k in range(4)]
    errors = Validation((MotorError("1", "motor 1", "N m", relative, 100.0, 10),), seen)
    findings = [Finding(name, statuses.get(name, "ok"), {"p": 1e-5}, f"About {name}.") for name in LOOKS]
    return verdict(SimpleNamespace(parameters=parameters, free_parameters=range(4)), errors, findings)


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


def test_the_gravest_reasons_are_named_and_the_rest_counted():
    made = given(0.2, dict.fromkeys(LOOKS, "bad") | {"units and signs": "doubt"})
    assert f"and {len(LOOKS) - 4} more reasons, though" in made.sentences[2]
    assert MEANING["units and signs"] not in made.sentences[2]


def test_without_unseen_rows_a_validation_is_wanted():
    assert given(0.2, {"drift": "bad"}, seen=True).sentences[3:] == ("Validate it on another log.",)
    assert len(given(0.2, {"drift": "bad"}).sentences) == 3


def test_negative_friction_is_not_said_of_the_torque():
    parameters = [SimpleNamespace(name="P", relative_se=1.0)]
    errors = Validation((MotorError("1", "motor 1", "N m", 0.2, 100.0, 10),), False)
    both, bodies = {"negative FV1": -0.1, "negative IA2": -1.0}, "the inertial torque of the device file's bodies."
    for sentence, figures, words in (
        ("FV1 negative, which is impossible.", {"negative FV1": -0.1}, "FV1 of friction or rotors is negative"),
        ("FV1 and IA2 negative, which is impossible.", both, "FV1 and IA2 of friction or rotors are negative"),
        (f"The torque of 1 is 3 times {bodies}", both, MEANING["units and signs"]),
    ):
        findings = [Finding("units and signs", "doubt", figures, sentence)]
        made = verdict(SimpleNamespace(parameters=parameters, free_parameters=range(1)), errors, findings)
        assert f"because {words}" in made.sentences[0]
