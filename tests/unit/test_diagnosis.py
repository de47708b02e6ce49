"""A diagnosis: its missing columns against a device that has them, its sentences, and what it leaves out."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import haptid
from diagnosed import estimated, log, phantom
from haptid.estimation.methods.constrained import FixedAtZero
from haptid.inference.diagnosis import diagnose
from haptid.inference.diagnosis.added_variable import CandidateColumns, augment
from haptid.inference.diagnosis.excitation import advice
from haptid.inference.diagnosis.exogeneity import narrowly_filtered
from haptid.inference.diagnosis.finding import SIGNIFICANCE
from haptid.inference.diagnosis.lack_of_fit import CANDIDATES, friction_coordinates
from haptid.inference.diagnosis.plausibility import confusions, unit_error, unlike_together
from haptid.inference.diagnosis.residuals import normality, residuals
from haptid.inference.diagnosis.torque_faults import torque_faults
from haptid.inference.elimination import not_identifiable
from haptid.observation.augmented import torque_rates
from motions import motion, truth

LOOKS = {
    *("excitation", "collinearity", "whiteness", "normality", "even spread", "time delay", "errors in W"),
    *("units and signs", "ripple", "rigid range", "influence", "drift", "torque channels", "play", "limit cycle"),
    *(term.name for term in CANDIDATES),
}


@pytest.fixture(scope="module")
def clean():
    return estimated(log(1, seconds=20.0))


@pytest.fixture(scope="module")
def diagnosis(clean):
    return diagnose(clean)


@pytest.fixture(scope="module")
def without_viscosity(tmp_path_factory):
    """The device without viscous friction on motor 2."""
    text = (Path(haptid.__file__).parent / "device/library" / "phantom_premium_15.toml").read_text(encoding="utf-8")
    path = tmp_path_factory.mktemp("device") / "device.toml"
    text = text.partition("[targets]")[0]
    path.write_text(text.replace('kind = "viscous"\nmotors = "all"', 'kind = "viscous"\nmotors = ["1", "3"]'))
    return haptid.DynamicModel(haptid.read_device(path))


def test_a_missing_column_is_what_a_device_with_that_term_estimates(without_viscosity):
    full = phantom()
    made = motion(full, truth(full), seconds=12.0, noise=0.05, phi=0.8)
    wanted = haptid.estimate(haptid.observe(full, made), haptid.OLS())
    lacking = haptid.estimate(haptid.observe(without_viscosity, made), haptid.OLS())
    row = np.eye(3)[1]
    added = augment(lacking, [CandidateColumns(row, 1, lambda context: context.motion[1][[1]])]).test([0])
    k = wanted.base.names.index("FV2")
    assert added.values[0] == pytest.approx(wanted.beta[k], rel=1e-8)
    assert added.se[0] == pytest.approx(wanted.se[k], rel=1e-6)
    assert added.dof == pytest.approx(wanted.dof[k], rel=1e-6)
    np.testing.assert_allclose(lacking.beta + added.shift, np.delete(wanted.beta, k), rtol=1e-7)
    assert added.explained[1] > 0


def test_a_column_that_the_model_has_cannot_be_distinguished_from_it(clean):
    again = augment(clean, [CandidateColumns(np.eye(3)[0], 1, lambda context: context.motion[1][[0]])])
    assert again.test([0]) is None


def test_rows_that_were_left_out_of_the_fit_are_left_out_of_the_diagnosis(clean):
    half = haptid.estimate(clean.observation.alternate()[0], haptid.WLS())
    left = residuals(half)
    assert [int(left.used(m).sum()) for m in range(3)] == [int(motor.rows.sum()) for motor in half.observation.motors]
    for m, motor in enumerate(half.observation.motors):
        assert np.sqrt(np.nansum(left.e[m] ** 2)) == pytest.approx(motor.residual(half.beta), rel=1e-9)
    wide = augment(half, torque_rates(half.model, [0, 1, 2]))
    for motor, wanted in zip(wide.observation.motors, half.observation.motors, strict=True):
        assert motor.rows.sum() == wanted.rows.sum()


def test_several_motions_are_diagnosed_together():
    both = [haptid.observe(phantom(), motion(phantom(), truth(phantom()), seed=s, noise=0.02)) for s in (1, 2)]
    found = diagnose(haptid.estimate(both[0] + both[1], haptid.WLS()))
    assert found.verdict.torque == "ok"
    assert found["whiteness"].figures["rows"] == sum(o.rows for o in both)


def test_parameters_and_motors_that_were_left_out_stay_out(clean):
    reduced = haptid.estimate(clean.observation, FixedAtZero(("FV2",)))
    found = diagnose(reduced)
    assert found["bent viscosity"].figures["p"] < SIGNIFICANCE or found["time delay"].status != "ok"
    assert "FV2" not in found["excitation"].sentence
    own = haptid.estimate(clean.observation.only("1"), FixedAtZero(untold_by_motor_1(clean), haptid.OLS()))
    alone = diagnose(own)
    assert "motor 1" in alone.verdict.sentences[0]
    assert not any("motor 2" in name for finding in alone.findings for name in finding.figures)


def untold_by_motor_1(made):
    return tuple(made.base.names[k] for k in not_identifiable(made.observation.only("1")))


def test_a_clean_log_has_every_look_and_a_good_verdict(diagnosis):
    assert {finding.name for finding in diagnosis.findings} == LOOKS
    assert [f.sentence for f in diagnosis.findings if f.status == "bad"] == []
    assert (diagnosis.verdict.torque, diagnosis.verdict.parameters) == ("ok", "ok")
    assert "Validate it on another log." in str(diagnosis.verdict)
    assert all(name in diagnosis.summary() for name in LOOKS)
    for finding in diagnosis.findings:
        assert finding.sentence[0].isupper()
        assert finding.sentence.endswith(".")
        assert all(np.isfinite(value) for value in finding.figures.values()), finding.name


def test_a_validation_on_unseen_rows_takes_the_place_of_the_direct_one(clean):
    unseen = haptid.observe(phantom(), haptid.treat(log(2, seconds=12.0), clean.observation.motions[0].treatment))
    found = diagnose(clean, haptid.validate(clean, unseen))
    assert "on unseen rows" in found.verdict.sentences[0]
    assert not any("Validate it" in sentence for sentence in found.verdict.sentences)


def test_a_torque_at_its_limit_and_one_that_chatters_are_named(clean):
    """A limit that 0.1 % of the samples reach; a sliding mode that switches for a tenth of a second at reversals."""
    raw = clean.observation.motions[0].log
    assert torque_faults(clean).status == "ok"

    def found(torque):
        treated = haptid.treat(replace(raw, torque=torque), clean.observation.motions[0].treatment)
        return torque_faults(replace(clean, observation=replace(clean.observation, motions=(treated,))))

    first, second, _ = raw.channels.torque.channels
    limited = np.array(raw.torque)
    limit = np.quantile(np.abs(limited[:, 0]), 0.999)
    limited[:, 0] = np.clip(limited[:, 0], -limit, limit)
    clipped = found(limited)
    assert clipped.status == "doubt"
    assert clipped.sentence.startswith(f"{first} stays at its limit ({limit:.3g})")
    assert 0.0005 < clipped.figures[f"clipped {first}"] <= 0.001  # runs of one or two samples may be noise
    assert second not in clipped.sentence
    switching = np.array(raw.torque)
    slow = np.abs(np.gradient(np.asarray(raw.position)[:, 1])) < 0.1 * np.abs(np.gradient(raw.position[:, 1])).max()
    sign = np.where(np.arange(len(slow)) // 2 % 2, 1.0, -1.0)
    switching[:, 1] += np.where(slow, 0.6 * switching[:, 1].std() * sign, 0.0)
    chattering = found(switching)
    assert chattering.status in ("doubt", "bad")
    assert chattering.sentence.startswith(f"{second} steps back and forth")


def test_an_exact_fit_leaves_no_residual_to_look_at():
    made = haptid.estimate(haptid.observe(phantom(), motion(phantom(), truth(phantom()))), haptid.OLS())
    found = diagnose(made)
    assert {finding.name for finding in found.findings} == {"excitation", "collinearity"}
    assert "rounding" in found.left_out[0]


def test_without_accelerations_some_looks_are_left_out():
    found = diagnose(estimated(log(1), formulation="momentum"))
    assert {finding.name for finding in found.findings} == LOOKS - {"time delay", "errors in W"}
    assert len(found.left_out) == 2
    assert found.verdict.torque == "ok"


def test_no_instrument_where_the_filter_is_already_as_narrow_as_the_motion(clean):
    (used,) = clean.observation.motions
    assert narrowly_filtered(used).treatment.cutoff_hz < np.min(used.treatment.cutoff_hz)
    narrow = haptid.treat(used.log, replace(used.treatment, cutoff_hz=5.0, parallel_cutoff_hz=None))
    assert narrowly_filtered(narrow) is None
    assert narrowly_filtered(motion(phantom(), truth(phantom()))) is None


def test_places_are_where_friction_is_declared():
    assert [place.label for place in friction_coordinates(phantom(), range(3))] == ["motor 1", "motor 2", "motor 3"]
    coupled = friction_coordinates(haptid.DynamicModel(haptid.read_device("staubli_tx40")), range(6))
    assert len({place.label for place in coupled}) == len(coupled) >= 6
    assert any(np.count_nonzero(place.weights) > 1 for place in coupled)


def test_factors_are_named_after_what_makes_them():
    assert unit_error(1000.0, []) == "milli- for whole units"
    assert unit_error(57.0, []) == "degrees for radians"
    assert unit_error(-0.0175, []) == "radians for degrees"
    assert unit_error(2.7, [2.73]) == "a gear ratio left out"
    assert unit_error(0.37, [2.73]) == "a gear ratio counted twice"
    assert unit_error(4.0, []) is None


@pytest.mark.parametrize(
    ("factors", "unit", "named"),
    [
        ((9.6, 1.1, 0.9), "N m", ()),  # kilograms, of one channel of three
        ((9.6, 11.0, 13.0), "N m", (1, 2)),  # of all, as far as they are near
        ((9.6,), "N m", ()),  # nothing is known of the others
        ((9.6, 11.0, 13.0), "A", ()),  # no currents
        ((56.0, 1.1), "A", ()),
        ((1000.0, 1.1, 0.9), "A", (1,)),  # a drive has its own
        ((9.6, 6.0, 5.0), "N m", ()),  # torque constants
    ],
)
def test_no_motor_has_a_unit_of_its_own_where_all_share_one(clean, factors, unit, named):
    """The largest error of a wrist's small motor was once "kilograms for newtons", among currents."""
    sizes = {f"motor {k}": factor for k, factor in enumerate(factors, 1)}
    assert set(confusions(in_unit(clean, unit), sizes)) == {f"motor {k}" for k in named}


@pytest.mark.parametrize(
    ("factors", "unit", "says"),
    [
        ((0.102, 0.127, 0.4), "N m", "if the channels are currents"),
        ((0.102, 0.127), "N m", "motor 1 and motor 2 are 0.102 to 0.127 times"),
        ((14.0, 11.0, 9.0), "A", "all too large: check the motors' `torque_constant`"),
        ((0.102, 0.9, 1.1), "N m", ""),
        ((0.102, 9.0, 1.1), "N m", ""),
        ((-0.102, -0.127, -0.4), "N m", ""),
    ],
)
def test_currents_taken_as_torques_are_told_by_all_motors_together(clean, factors, unit, says):
    """Six currents were "newtons for kilograms" of the first motor, whose torque constant is near 9.81 N m/A."""
    sizes = {f"motor {k}": factor for k, factor in enumerate(factors, 1)}
    said = unlike_together(in_unit(clean, unit), sizes)
    assert bool(said) is bool(says)
    assert says in said


def in_unit(clean, unit):
    """What stands for the estimate of a log whose torque channels have this unit."""
    motors = clean.observation.motors
    channels = SimpleNamespace(torque_unit=unit, torque_units=(unit,) * len(motors))
    return SimpleNamespace(
        model=clean.model,
        observation=SimpleNamespace(motors=motors, motions=(SimpleNamespace(log=SimpleNamespace(channels=channels)),)),
    )


def test_advice_names_the_joint_or_motor(clean):
    names = clean.base.names
    assert "motor 2" in advice(clean, names.index("FV2"))
    assert "joint be" in advice(clean, names.index("ZZbeR"))


@pytest.mark.parametrize("seed", [8, 15, 23])
def test_dry_friction_at_reversals_is_no_outlier(seed):
    """Its sign is known to some samples only; the fraction of the residual power there was above the limit."""
    found = diagnose(estimated(log(seed)))["normality"]
    assert found.status != "bad"
    assert found.figures["outliers at reversals"] > 0


def test_a_contact_in_motion_is_an_outlier():
    made = log(8)
    speed = np.abs(np.gradient(np.asarray(made.position)[:, 0]))
    fast = 2000 + int(np.argmax(np.convolve(speed, np.ones(200), mode="same")[2000:-2000]))
    torque = np.array(made.torque)
    torque[fast - 5 : fast + 5, 0] += 2.0 * torque[:, 0].std()
    found = diagnose(estimated(replace(made, torque=torque)))["normality"]
    assert (found.status, found.figures["outliers"] > 0) == ("bad", True)
    assert "motor 1" in found.sentence


def test_nothing_is_said_of_normality_where_the_motor_turns_in_every_window(clean):
    left = residuals(clean)
    turning = np.where(np.arange(left.e.shape[1]) % 4 < 2, 1.0, -1.0)
    found = normality(left, np.tile(turning, (len(left.e), 1)))
    assert (found.status, found.figures["outliers"]) == ("ok", 0)
    assert not any(name.startswith("skewness") for name in found.figures)
