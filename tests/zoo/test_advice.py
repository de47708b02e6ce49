"""Advice on a small zoo: the first action mends the cause of a wrong log, and right logs get none.

`benchmarks/zoo --advice` has hundreds; here is one log for each kind of proof.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from haptid.advice import advise
from haptid.advice import apply_advice as applied
from haptid.advice.recorder import ChannelFault
from haptid.cli.common import app
from haptid.inference.diagnosis import diagnose
from haptid.log import Log
from haptid.study.identify import Identification, identify
from haptid.study.read import read_study
from json_outputs import valid
from zoo.advised import rank
from zoo.case import Case
from zoo.wrong import WrongPlant, identified, written, wrong_cases

ARM = Case(1, "arm2", 250, 16, 1.2, 3, bits=16, friction=0.3, level=0.01)
ARM3 = Case(2, "arm3", 250, 20, 0.8, 3, bits=16, friction=0.3, level=0.01)
AXIS = Case(2, "axis", 250, 12, 1.5, 4, bits=16, friction=0.3, level=0.01)
PENDULUM = Case(1, "pendulum", 200, 24, 1.0, 3, bits=16, friction=0.3, level=0.01)
WRONG = {
    "stribeck": AXIS,
    "spring": AXIS,
    "ripple": AXIS,
    "drift": AXIS,
    "warming": Case(6, "arm2", 250, 16, 1.2, 3, bits=16, friction=0.3, level=0.01),  # a contact, by steady drifts alone
    "wandering offset": PENDULUM,
    "contact": ARM,
    "torque swap": ARM,
    "position sign": ARM,
    "gain": ARM,
    "time shift": ARM,
    "length": ARM,
    "payload": ARM,
}
RIGHT = {
    "white noise": ARM,
    "coarse encoders": Case(3, "arm2", 500, 12, 1.2, 3, bits=11, friction=0.5, noise="AR", level=0.01),
    "noise inside the loop": Case(4, "arm2", 500, 8, 1.2, 3, bits=16, level=0.01, loop=True, delay=1.0),
    # Rounding that is the same in every period, as a ripple is.
    "steps that come back": Case(
        57982019,
        "axis",
        500,
        12,
        1.9715468810396102,
        5,
        bits=11,
        friction=0.1,
        noise="AR",
        level=0.005622527985945208,
        delay=0.5,
    ),
    # A fit with a ripple errs less on all unseen blocks, by chance.
    "a lucky fit": Case(
        71831106, "arm3", 500, 20, 2.461400720907694, 4, bits=12, friction=0.3, level=0.02906740741156694, delay=1.0
    ),
}


def found(case: Case, cause: str, folder: Path) -> tuple[WrongPlant, Identification]:
    plant = WrongPlant(case, cause)
    return plant, identified(plant, folder)


def test_a_payload_comes_before_the_drift_that_explains_less(tmp_path: Path) -> None:
    """Its gain is that of half of the blocks: clear by two standard errors, it stood behind a drift of both motors."""
    plant = next(one for one in wrong_cases(1, 4802) if one.case.seed == 4802058)
    made = advise(identified(plant, tmp_path))
    assert [action.kind for action in made.actions][:2] == ["payload", "drift"]


@pytest.mark.parametrize("cause", WRONG)
def test_the_first_action_mends_the_cause(cause: str, tmp_path: Path) -> None:
    plant, wrong = found(WRONG[cause], cause, tmp_path)
    made = advise(wrong)
    assert rank(plant, [[action.kind, *action.places] for action in made.actions]) == 1, made.sentences
    first = made.actions[0]
    assert first.after < first.before
    assert first.se is not None
    assert first.before - first.after > 2 * first.se or first.kind == "contact"


@pytest.mark.parametrize("name", RIGHT)
def test_right_models_get_no_advice(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("zoo.kept.CACHE", tmp_path)
    _, right = found(RIGHT[name], "none", tmp_path)
    assert advise(right).actions == ()


def test_a_reversed_position_is_tried_where_only_impossible_bodies_show_it(tmp_path: Path) -> None:
    """In slow motion of much weight the free fit makes up for it to a per cent."""
    _, wrong = found(Case(2, "arm3", 250, 20, 0.3, 3, bits=16, friction=0.3, level=0.01), "position sign", tmp_path)
    made = advise(wrong)
    assert made.before < 5.0
    (action,) = (action for action in made.actions if action.kind == "position sign")
    assert action.proof == "unseen error"
    assert action.after < 0.7 * action.before


def test_rows_of_much_torque_are_no_fault(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Dry friction stops a joint as a stuck encoder does: the other rows have to be less wrong without those."""

    def stopped(log: Log) -> Iterator[ChannelFault]:
        size = np.convolve(np.abs(np.asarray(log.torque)[:, 0]), np.ones(50) / 50, "same")
        most = size > np.quantile(size, 0.9)
        yield ChannelFault("stuck position", 0, most, float(most.mean()), 0.0)

    monkeypatch.setattr(sys.modules["haptid.advice.search"], "faults", stopped)
    _, wrong = found(AXIS, "spring", tmp_path)
    made = advise(wrong)
    assert made.actions[0].kind == "spring"
    assert "stuck position" not in {action.kind for action in made.actions}


def test_a_sign_that_only_rescales_is_proven_by_bodies_that_can_exist(tmp_path: Path) -> None:
    _, wrong = found(AXIS, "torque sign", tmp_path)
    made = advise(wrong)
    assert [(action.kind, action.proof) for action in made.actions] == [("torque sign", "possible bodies")]
    assert made.actions[0].change.endswith(" cannot be negative")
    assert " cannot be negative: without it they are " in made.actions[0].sentence
    after = applied(made, wrong, tmp_path / "out")
    assert after is not None
    np.testing.assert_allclose(after.identification.estimate.beta, -wrong.estimate.beta, rtol=1e-6)


def test_torques_that_are_all_reversed_are_known_by_bodies_that_can_exist(tmp_path: Path) -> None:
    """One of them alone cannot be: the arm's coupling would be of the wrong sign."""
    study = written(WrongPlant(ARM), tmp_path)
    text = study.read_text()
    assert 'side = "motor" }' in text
    study.write_text(text.replace('side = "motor" }', 'side = "motor", gain = -1.0 }'))
    wrong = identify(read_study(study))
    made = advise(wrong)
    (first, *_) = made.actions
    assert (first.kind, first.places, first.proof) == ("torque sign", ("motor 1", "motor 2"), "consistent fit")
    after = applied(made, wrong, tmp_path / "out")
    assert after is not None
    np.testing.assert_allclose(after.identification.estimate.beta, -wrong.estimate.beta, rtol=1e-6)


def test_torques_that_are_all_reversed_are_known_where_a_motor_alone_tells_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Bodies that can exist explain the whole arm only with the other sign, whatever single parameters show."""
    study = written(WrongPlant(ARM), tmp_path)
    right = identify(read_study(study))
    study.write_text(study.read_text().replace('side = "motor" }', 'side = "motor", gain = -1.0 }'))
    wrong = identify(read_study(study))
    monkeypatch.setattr(sys.modules["haptid.advice.sought"], "impossible", lambda *_: iter(()))
    (first, *_) = advise(wrong).actions
    assert (first.kind, first.places, first.proof) == ("torque sign", ("motor 1", "motor 2"), "consistent fit")
    assert first.after == pytest.approx(right.use.candidates[0].error if right.use.candidates else first.after, rel=0.1)
    assert first.after < 0.5 * first.before


def test_joints_in_another_order_are_put_into_the_device_s(tmp_path: Path) -> None:
    """Positions and torques of the joints exchanged: no change of one channel mends that."""
    study, log = written(WrongPlant(ARM), tmp_path), tmp_path / "log.csv"
    right = identify(read_study(study)).unseen[0].comparable.relative
    log.write_text(log.read_text().replace("q1", "q[1]").replace("q2", "q[2]"))
    text = study.read_text().replace('channels = ["q1", "q2"]', 'field = "q", joints = [2, 1]')
    study.write_text(text.replace('["u1", "u2"], unit = "N m"', '["u2", "u1"], unit = "N m", gain = [1.0, 1]'))
    wrong = identify(read_study(study))
    made = advise(wrong)
    assert [action.kind for action in made.actions] == ["joint order"]
    after = applied(made, wrong, tmp_path / "out")
    assert after is not None
    assert after.identification.study.path.read_text().count("joints = [1, 2]") == 1
    assert after.after == pytest.approx(right, rel=0.02)
    assert after.before > 4 * right


@pytest.mark.parametrize(
    ("count", "words"),
    [
        ("offset = [0.0, 1.5707963, 0.0]", "add -90 deg to the position of joint 2"),
        ("gain = [1.0, -1.0, 1.0]", "reverse position and torque of joint 2"),
        ("offset = [0.0, 1.5707963, -1.5707963]", "add -90 deg to the position of joint 2"),  # the last one is absorbed
    ],
)
def test_joints_that_the_log_counts_otherwise_are_counted_as_the_device_file_does(
    count: str, words: str, tmp_path: Path
) -> None:
    """A controller's zero a quarter turn from the description's, or its axis reversed, with the torque's sign."""
    study = written(WrongPlant(ARM3), tmp_path)
    device = tmp_path / "device.toml"
    device.write_text("".join(x for x in device.read_text().splitlines(True) if not x.startswith("limits")))
    right, text = identify(read_study(study)), study.read_text()
    text = text.replace('"q3"], unit = "rad"', f'"q3"], unit = "rad", {count}')
    if "gain" in count:
        text = text.replace('"u3"], unit = "N m"', f'"u3"], unit = "N m", {count}')
    study.write_text(text)
    wrong = identify(read_study(study))
    made = advise(wrong)
    assert [(action.kind, action.change.split(":")[0]) for action in made.actions] == [("joint zeros", words)]
    (first,) = made.actions
    assert first.se is not None
    assert first.before - first.after > 5 * first.se
    after = applied(made, wrong, tmp_path / "out")
    assert after is not None
    assert after.before > 5 * after.after
    known = [k for k, name in enumerate(right.estimate.base.names) if name.startswith(("FV", "FC", "ZZ1"))]
    np.testing.assert_allclose(after.identification.estimate.beta[known], right.estimate.beta[known], rtol=0.02)


def test_of_mounting_and_order_the_one_that_leaves_least_is_advised(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On a wall, some exchange of joints explains a part of the torque; gravity explains it all."""
    study, device = written(WrongPlant(ARM), tmp_path), tmp_path / "device.toml"
    device.write_text(device.read_text().replace("gravity = [0.0, -9.81, 0.0]", "gravity = [0.0, 0.0, -9.81]"))
    wrong = identify(read_study(study))
    module = sys.modules["haptid.advice.advise"]
    (mounting,) = advise(wrong).actions
    worse = replace(mounting, kind="joint order", after=2 * mounting.after)
    monkeypatch.setattr(module, "_order", lambda *_: worse)
    assert [action.kind for action in advise(wrong).actions] == ["mounting"]
    monkeypatch.setattr(module, "_order", lambda *_: replace(worse, after=0.5 * mounting.after))
    assert [action.kind for action in advise(wrong).actions] == ["joint order"]


def test_the_description_of_another_robot_is_questioned(tmp_path: Path) -> None:
    arm = replace(ARM, seed=5)
    study, device = written(WrongPlant(arm), tmp_path), tmp_path / "device.toml"
    device.write_text(device.read_text().replace("d = 0.25", "d = 0.25\nalpha = 0.9"))
    made = advise(identify(read_study(study)))
    assert any("Check first that the device file is of this robot" in line for line in made.undetermined)
    study = written(WrongPlant(arm), tmp_path)
    assert not any("Check first" in line for line in advise(identify(read_study(study))).undetermined)


def test_a_mounting_is_named_with_those_that_predict_as_well(tmp_path: Path) -> None:
    """Two links in the plane of gravity, read as level: first moments turn with gravity, inertia tells its axis."""
    rivals = []
    slow = replace(ARM, motion_hz=0.04, seconds=150.0, rate=20.0, noise="AR", level=0.04)
    for case in (ARM, slow):
        study, device = written(WrongPlant(case), tmp_path), tmp_path / "device.toml"
        level = device.read_text().replace("gravity = [0.0, -9.81, 0.0]", "gravity = [0.0, 0.0, -9.81]")
        device.write_text(level)
        (action,) = advise(identify(read_study(study))).actions
        assert action.kind == "mounting"
        told = f"[{', '.join(f'{x:g}' for x in action.edits[0].value)}]"
        rivals.append({told, *(one.removeprefix("gravity ") for one in action.rivals)})
    assert rivals[0] == {"[0, -9.81, 0]"}
    assert rivals[1] == {"[0, -9.81, 0]", "[0, 9.81, 0]", "[-9.81, 0, 0]", "[9.81, 0, 0]"}


def test_a_delay_of_all_channels_is_advised_and_written(tmp_path: Path) -> None:
    """Twelve samples late, and no delay compensated: far beyond what the slope of the torque tells."""
    study = written(WrongPlant(replace(ARM, delay=12.0)), tmp_path)
    study.write_text(study.read_text() + "\n[treatment]\ntorque_delay_s = 0.0\n")
    wrong = identify(read_study(study))
    made = advise(wrong)
    first = made.actions[0]
    assert (first.kind, first.proof) == ("common delay", "unseen error"), made.sentences
    after = applied(made, wrong, tmp_path / "out")
    assert after is not None
    assert after.after < 0.5 * after.before
    delay = after.identification.study.treatment["torque_delay_s"]
    np.testing.assert_allclose(delay, 12 / ARM.rate, atol=0.5 / ARM.rate)


def test_a_gain_of_one_axis_cannot_be_told(tmp_path: Path) -> None:
    _, wrong = found(AXIS, "gain", tmp_path)
    made = advise(wrong, diagnose(wrong.estimate))
    assert made.actions == ()
    assert "gain of the torque (motor 1)" in made.undetermined[0]


def test_the_best_combination_is_written_and_identified_again(tmp_path: Path) -> None:
    _, before = found(AXIS, "stribeck", tmp_path)
    given = {path: path.read_bytes() for path in tmp_path.iterdir()}
    made = CliRunner().invoke(app, ["advise", str(tmp_path / "study.toml"), "--apply", str(tmp_path / "out"), "--json"])
    assert made.exit_code == 0, made.output
    values = valid("advise", made.stdout)
    assert values["actions"][0]["edits"][0]["value"]["kind"] == "stribeck"
    assert values["applied"]["after"] < 0.5 * values["applied"]["before"]
    assert values["applied"]["before"] == pytest.approx(before.unseen[0].comparable.relative)
    assert 'kind = "stribeck"' in (tmp_path / "out" / "device.toml").read_text()
    assert all(path.read_bytes() == content for path, content in given.items())


def test_rows_of_a_contact_are_excluded_in_the_written_study(tmp_path: Path) -> None:
    plant, wrong = found(ARM, "contact", tmp_path)
    after = applied(advise(wrong), wrong, tmp_path / "out")
    assert after is not None
    (log,) = after.identification.study.logs
    for start in (0.15, 0.45, 0.75):
        middle = (start + 0.03) * plant.case.seconds
        assert any(low < middle < high for low, high in log.exclude)
    clean = WrongPlant(ARM)
    off = np.abs(after.identification.estimate.beta - clean.beta) / after.identification.estimate.se
    assert off.max() < 5


def test_a_study_that_is_in_order_is_not_written(tmp_path: Path) -> None:
    written(WrongPlant(AXIS), tmp_path)
    made = CliRunner().invoke(app, ["advise", str(tmp_path / "study.toml"), "--apply", str(tmp_path / "out")])
    assert made.exit_code == 0
    assert "Nothing is written" in made.stdout
    assert not (tmp_path / "out").exists()
