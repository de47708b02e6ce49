"""Sentences of an advice, as a newcomer reads them: the cause first, and what it explains not beside it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pytest

import haptid
import small_study
from diagnosed import phantom
from haptid.advice import apply
from haptid.advice.action import CHANGES, MASKS, Action, Advice, told_apart
from haptid.advice.advise import _shifted_once, _travel_unit, advise
from haptid.advice.contact import kind_of
from haptid.advice.edits import Edit, _free_name
from haptid.advice.recorder import faults
from haptid.advice.search import _masks, search_of
from haptid.study.identify import identify
from haptid.study.read import read_study
from motions import multisine, truth


def action(kind: str, after: float, adds: bool, **changes) -> Action:
    made = Action(kind, ("motor 1",), f"mend {kind}", "unseen error", 48.2, after, 0.5, 0.9, adds, (), 24)
    return replace(made, **changes)


def advice(*actions: Action, after: float = 0.06) -> Advice:
    return Advice(actions, 48.2, after, (), 40)


def test_what_the_first_change_explains_is_counted_and_not_listed() -> None:
    """Exchanged channels: a gain and an offset help a little, and were listed as five more causes."""
    one, two = action("torque swap", 0.0585, True), action("gain", 12.8, False)
    three = action("position swap", 0.1, False, before=69.0, motor="motor 1")
    said = advice(one, two, three).sentences
    assert [sentence[:2] for sentence in said] == ["1.", "2 "]
    assert said[1].startswith("2 other changes lower the error by less, which the first explains")


@pytest.mark.parametrize(
    ("first", "second"),
    [
        ({"after": 0.0585}, {"after": 0.06}),  # as good
        ({"after": 20.0}, {"after": 40.0}),  # the first does not explain all
        ({"after": 0.0585, "kind": "contact"}, {"after": 12.8}),  # on other rows
        ({"after": 0.0585}, {"after": 12.8, "adds": True}),
        ({"after": 0.0585}, {"after": 2.0, "before": 1e3, "proof": "prior bodies"}),
    ],
)
def test_what_the_first_change_does_not_explain_is_listed(first: dict, second: dict) -> None:
    kind, adds = first.get("kind", "torque swap"), second.pop("adds", False)
    made = advice(action(kind, first["after"], True), action("gain", second.pop("after"), adds, **second))
    assert [sentence[:2] for sentence in made.sentences if sentence[0].isdigit()] == ["1.", "2."]


def test_errors_are_stated_so_that_their_difference_shows() -> None:
    """A length was said to lower the error from 1.11 to 1.1 %."""
    assert told_apart(1.1132, 1.0981) == ("1.113", "1.098")
    assert told_apart(48.2, 0.0585) == ("48.2", "0.0585")
    assert told_apart(2.0, 2.0) == ("2", "2")


def test_units_are_plain_numbers_and_no_error_that_stays_is_called_a_gain() -> None:
    """Both were: '1e+03 times that of the prior bodies', 'together unseen error 0.0885 to 0.0885 %'."""
    units = [action("unit", 1.0, True, before=1000.2, proof="prior bodies", places=(f"motor {k}",)) for k in (1, 2)]
    said = replace(advice(*units), before=0.0885, after=0.0885).sentences
    assert "the torque is 1000 times that of the prior bodies, and then 1." in said[0]
    assert not any(sentence.startswith("Together") for sentence in said)


def test_a_channel_is_shifted_in_time_by_one_size() -> None:
    """A motor's torque was to be shifted by 78.7 ms, and further down by 25.7 ms."""
    shifts = [
        action("time shift", 5.0, adds, places=places)
        for adds, places in ((False, ("a",)), (True, ("a",)), (False, ("b",)), (False, ("b",)), (False, ("b", "c")))
    ]
    others = [action("offset", 5.0, False, places=("a",)), action("offset", 4.0, False, places=("a",))]
    assert _shifted_once([*shifts, *others]) == [shifts[1], shifts[2], shifts[4], *others]


def test_positions_of_revolute_joints_are_in_rad() -> None:
    assert _travel_unit(phantom()) == "rad"


def with_small_noise(folder: Path) -> Path:
    """A study whose logs have noise in place of the torque of motor 2, a thousandth of that of motor 1."""
    path = small_study.write_study(folder)
    for seed, name in ((1, "log.csv"), (2, "check.csv")):
        made = small_study.columns(seed, 20.0)
        size = 1e-3 * float(np.std(made["tau1"]))
        made["tau2"] = size * np.random.default_rng(seed).standard_normal(len(made["t"]))
        pyarrow.csv.write_csv(pa.table(made), folder / name)
    return path


def test_a_torque_of_noise_that_is_small_is_named_and_not_given_a_gain(tmp_path: Path) -> None:
    """The first advice was a gain of 0.00025 on the channel, which then has noise as large as the torque."""
    path = with_small_noise(tmp_path)
    said = advise(identify(read_study(path))).sentences
    assert said[0].startswith("1. Leave out the torque channel of motor 2, which shows noise alone")
    assert not any("gain" in sentence.split(":")[0] for sentence in said if sentence[0].isdigit())


def test_a_channel_of_which_the_model_explains_nothing_is_given_no_gain(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As above in a log that is too short, or too slow, to be certain of noise."""
    for place in ("advice.recorder", "motion.noise_torques"):
        monkeypatch.setattr(f"haptid.{place}.noise_alone", lambda log: np.zeros(log.torque.shape[1], dtype=bool))
    path = with_small_noise(tmp_path)
    first = advise(identify(read_study(path))).actions[0]
    assert (first.kind, first.edits) == ("no torque", ())
    assert "motor 2, of which the model explains nothing: check that it is connected" in first.sentence


@pytest.mark.parametrize(("size", "rows"), [(1e-3, "Its error is of noise."), (0.3, "Its rows are not used")])
def test_a_torque_of_noise_in_a_validation_log_alone_is_named(tmp_path: Path, size: float, rows: str) -> None:
    """Nothing named it: a large one had no rows, and a small one made the motion of the fit suspected of its error."""
    path = small_study.write_study(tmp_path)
    made = small_study.columns(2, 20.0)
    noise = np.random.default_rng(2).standard_normal(len(made["t"]))
    made["tau2"] = size * float(np.std(made["tau2"])) * noise
    pyarrow.csv.write_csv(pa.table(made), tmp_path / "check.csv")
    made = advise(identify(read_study(path)))
    assert not made.actions
    (said,) = (one for one in made.sentences if "check.csv" in one)
    assert said.startswith("check.csv: torque of motor 2 shows no part that follows the motion")
    assert rows in said


@pytest.mark.parametrize(("factor", "told"), [(2.0, True), (-1.0, True), (1e3, True), (1.0, False)])
def test_a_validation_log_of_another_gain_is_told_with_it(tmp_path: Path, factor: float, told: bool) -> None:
    """The motion of the fit was suspected; other motion, which the fit does not determine, has no one factor."""
    path = small_study.write_study(tmp_path)
    made = small_study.columns(2)
    made["tau1"] = factor * made["tau1"] if told else made["tau1"] + 3.0 * np.sin(7 * made["t"])
    pyarrow.csv.write_csv(pa.table(made), tmp_path / "check.csv")
    (said,) = (one for one in advise(identify(read_study(path))).sentences if "check.csv" in one)
    assert ("Another unit, sign or gain" in said) is told
    if told:
        size = float(said.partition("that of motor 1 is ")[2].split()[0])
        assert size == pytest.approx(factor, rel=0.02)
        assert "motor 2" not in said


def test_a_body_that_a_validation_log_has_more_is_no_gain(tmp_path: Path) -> None:
    """It makes the torques larger too, by no one factor."""
    path = small_study.write_study(tmp_path)
    made, model = small_study.columns(2), small_study.two_links()
    q = np.stack([made["q1"], made["q2"]])
    qd = np.gradient(q, 2e-3, axis=1)
    body = np.isin(model.base.names, ["ZZ2", "MX2", "MY2"]) * 0.05
    tau = haptid.inverse_dynamics(model, body, q, qd, np.gradient(qd, 2e-3, axis=1))
    made |= {f"tau{k + 1}": made[f"tau{k + 1}"] + tau[k] for k in (0, 1)}
    pyarrow.csv.write_csv(pa.table(made), tmp_path / "check.csv")
    (said,) = (one for one in advise(identify(read_study(path))).sentences if "check.csv" in one)
    assert "something differs in that log" in said


def test_a_validation_log_of_noise_alone_is_named_once(tmp_path: Path) -> None:
    path = small_study.write_study(tmp_path)
    made, rng = small_study.columns(2, 20.0), np.random.default_rng(2)
    made |= {name: rng.standard_normal(len(made["t"])) for name in ("tau1", "tau2")}
    pyarrow.csv.write_csv(pa.table(made), tmp_path / "check.csv")
    (said,) = (one for one in advise(identify(read_study(path))).sentences if "check.csv" in one)
    assert said.startswith("check.csv: no torque follows the motion")


STAGE = """
schema = 1
name = "turntable and wrist"
gravity = [0.0, 0.0, -9.81]
convention = "modified-dh"
[[joints]]
name = "1"
[[joints]]
name = "2"
alpha = 1.5707963267948966
[[terms]]
kind = "coulomb"
joints = "all"
"""


def test_friction_below_its_noise_is_no_torque_to_leave_out(tmp_path: Path) -> None:
    """A right model of a small wrist, whose friction no test finds: its rows harm no other."""
    path = small_study.write_study(tmp_path)
    (tmp_path / "device.toml").write_text(STAGE)
    model = haptid.DynamicModel(haptid.read_device(tmp_path / "device.toml"))
    beta = np.array([{"ZZ1R": 0.3, "FC1": 0.4, "FC2": 1e-5}.get(name, 0.0) for name in model.base.names])
    for seed, name in ((1, "log.csv"), (2, "check.csv")):
        q, qd, qdd = multisine(2, 20.0, 2e-3, seed)
        tau = haptid.inverse_dynamics(model, beta, q, qd, qdd)
        tau += np.array([[0.01], [1e-3]]) * np.random.default_rng(seed).standard_normal(tau.shape)
        table = {"t": 2e-3 * np.arange(q.shape[1]), "q1": q[0], "q2": q[1], "tau1": tau[0], "tau2": tau[1]}
        pyarrow.csv.write_csv(pa.table(table), tmp_path / name)
    found = identify(read_study(path))
    (log,) = found.runs[0].observation.motions
    assert [fault.kind for fault in faults(log.log)] == ["noise alone"]
    assert not advise(found).actions


def test_a_channel_of_which_no_row_is_used_is_exchanged_with_none(tmp_path: Path) -> None:
    """The noise of a dead torque is a small residual: its exchange left an error of 100 % as the best combination."""
    path = small_study.write_study(tmp_path)
    for seed, name in ((1, "log.csv"), (2, "check.csv")):
        made = small_study.columns(seed, 20.0)
        made["tau2"] = 1e-3 * float(np.std(made["tau1"])) * np.random.default_rng(seed).standard_normal(len(made["t"]))
        pyarrow.csv.write_csv(pa.table(made), tmp_path / name)
    found = advise(identify(read_study(path)))
    assert found.after < 5
    assert "% of the samples" not in found.sentences[0]


@pytest.mark.parametrize(
    ("errors", "kept"),
    [
        ({"spring": 0.23, "spring length": 1.72}, "spring"),  # the length mended delays that the lack of a spring made
        ({"spring": 3.0, "spring length": 1.72}, "spring length"),
        ({"spring length": 1.72}, "spring length"),  # the spring alone is not confirmed
        ({"contact spring": 0.2, "contact spring length": 0.3}, "contact spring"),
        ({"spring": 0.23}, "spring"),
    ],
)
def test_the_first_action_is_applied_alone_where_it_leaves_no_more(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, errors: dict[str, float], kept: str
) -> None:
    """A spring left out made a length of 100 mm look proven; both were written, with 1.72 % in place of 0.23 %."""
    written = []

    def wrote(actions, _found, folder, _data):
        written.append(" ".join(one.kind for one in actions))
        return folder.path / "study.toml"

    def tried(actions, found, folder, data, before):
        path, after = wrote(actions, found, folder, data), errors.get(" ".join(one.kind for one in actions))
        return None if after is None else apply.Applied(path, actions, before, after, found)

    monkeypatch.setattr(apply, "_write", wrote)
    monkeypatch.setattr(apply, "_tried", tried)
    monkeypatch.setattr(apply, "_worst", lambda _: 4.9)
    edit = (Edit("study", "set", ("estimate", "use"), "auto"),)
    kinds = max(errors, key=len).split() + ["length"] * (len(errors) == 1 and kept == "spring")
    actions = tuple(replace(action(kind, 1.0, True), edits=edit) for kind in kinds)
    made = apply.apply_advice(advice(*actions), None, tmp_path)
    assert made is not None
    assert " ".join(one.kind for one in made.actions) == kept
    assert written[-1] == kept  # the files are those of the actions


def test_friction_at_rest_is_no_contact() -> None:
    """At both ends of a log nothing moves, and friction breaks away as it sets off: a hand was said to touch it."""
    model, dt = small_study.two_links(), 1e-2
    q, *_ = multisine(2, 20.0, dt, 1)
    moves = np.clip(np.arange(q.shape[1]) * dt - 4.0, 0.0, 1.0)
    q = q * (3 * moves**2 - 2 * moves**3)
    qd = np.gradient(q, dt, axis=1)
    tau = haptid.inverse_dynamics(model, truth(model) + 0.3, q, qd, np.gradient(qd, dt, axis=1))
    motion = haptid.Motion(dt, q.T, tau.T, haptid.Treatment(10.0, decimation=2))
    search = search_of(model, [motion], truth(model) + 0.3)
    rests = search.rows.t < 3.5
    sets_off = (search.rows.t > 4.2) & (search.rows.t < 5.0)
    for flagged, kind in ((rests, "rest"), (sets_off, "start"), (np.roll(rests, len(rests) // 2), "contact")):
        search.__dict__["contact"] = flagged
        (found,) = [one for one, _ in _masks(search)]
        assert found.kind == kind
    assert "rests" in CHANGES["rest"]
    assert {"rest", "start"} < set(MASKS)


def test_what_sticks_in_a_validation_log_is_left_out_there_too(tmp_path: Path) -> None:
    """Its error fell by nothing, so that leaving out the parts of the fit was not confirmed."""
    path = small_study.write_study(tmp_path)
    path.write_text(small_study.STUDY.replace("[treatment]\ncutoff_hz = 30\ndecimation = 5\n", ""))
    for seed, name in ((1, "log.csv"), (2, "check.csv")):
        made = small_study.columns(seed, 20.0)
        for start in np.random.default_rng(seed).integers(100, len(made["t"]) - 160, 12):
            made["q2"][start : start + 50] = made["q2"][start]
        pyarrow.csv.write_csv(pa.table(made), tmp_path / name)
    found = identify(read_study(path))
    said = advise(found)
    (stuck,) = (one for one in said.actions if one.kind == "stuck position")
    assert {edit.path for edit in stuck.edits} == {("logs", 0), ("all logs", 1)}
    assert "haptid poses" in stuck.sentence
    made = apply.apply_advice(said, found, tmp_path / "out")
    assert made is not None
    assert made.after < 0.7 * made.before
    assert (tmp_path / "out" / "study.toml").read_text().count("exclude") == 2


def proposed(*edits: Edit) -> Advice:
    """Advice of one change for each edit."""
    return advice(*(replace(action("length", 1.0, True), edits=(edit,)) for edit in edits))


def test_what_is_tried_first_leaves_no_device_file_behind(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Where the first change alone is kept, the device file of the combination would stay beside its study."""
    found = identify(read_study(small_study.write_study(tmp_path)))
    spring = Edit("study", "set", ("estimate", "use"), "auto")
    device = Edit("device", "set", ("gravity",), [0.0, 0.0, -9.8])
    shipped = replace(found, study=replace(found.study, device="two_links"))
    monkeypatch.setattr("haptid.advice.edits.file_text", lambda _: ("device.toml", small_study.DEVICE))
    monkeypatch.setattr("haptid.advice.edits.read_study", lambda path: path)
    folder, (first, second) = apply._Folder(tmp_path / "out"), proposed(spring, device).actions
    apply._write((first, second), shipped, folder, None)
    assert (tmp_path / "out" / "device.toml").is_file()
    apply._write((first,), shipped, folder, None)
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["study.toml"]


@pytest.mark.parametrize("earlier", [False, True])
def test_what_is_not_confirmed_leaves_the_folder_as_it_was(tmp_path: Path, earlier: bool) -> None:
    found = identify(read_study(small_study.write_study(tmp_path)))
    out = tmp_path / "out"
    if earlier:
        out.mkdir()
        (out / "study.toml").write_text("of an earlier run")
    worse = Edit("study", "set", ("treatment", "cutoff_hz"), 3.0)
    assert apply.apply_advice(proposed(worse), found, out) is None
    assert out.exists() == earlier
    assert not earlier or [one.read_text() for one in out.iterdir()] == ["of an earlier run"]


def test_the_study_itself_is_not_overwritten(tmp_path: Path) -> None:
    """`--apply .` beside a `study.toml` put the change in its place, or removed it where none was confirmed."""
    path = small_study.write_study(tmp_path)
    path = path.rename(tmp_path / "study.toml")
    found, before = identify(read_study(path)), path.read_text()
    with pytest.raises(haptid.errors.OutputFolderError, match=r"study\.toml is what is to be changed"):
        apply.apply_advice(proposed(Edit("study", "set", ("estimate", "use"), "auto")), found, tmp_path)
    assert path.read_text() == before
    assert {one.name for one in tmp_path.iterdir()} >= {"study.toml", "device.toml", "log.csv"}


def of_rows(t, velocity, log) -> SimpleNamespace:
    return SimpleNamespace(t=np.asarray(t), velocity=np.asarray(velocity), log=np.asarray(log))


def test_a_joint_that_is_held_does_not_hide_that_the_others_stand() -> None:
    """Zero is not below a share of zero, and noise is not below a share of itself: a hand was said to touch the arm."""
    t = np.arange(0.0, 6.0, 0.02)
    moves = np.where(t < 1.0, 0.0, np.sin(2 * np.pi * (t - 1.0)))
    noise = 1e-4 * np.random.default_rng(0).normal(size=t.size)
    for held in (np.zeros_like(t), noise):
        rows = of_rows(t, [moves, held], np.zeros(t.size, dtype=int))
        assert kind_of(rows, (t > 0.98) & (t < 1.6)) == "start"
        assert kind_of(rows, t < 0.9) == "rest"
        assert kind_of(rows, (t > 3.3) & (t < 3.9)) == "contact"


def test_a_part_of_another_log_is_judged_by_that_log() -> None:
    """Times start at zero in each log, and the judgement of the log before was used for the next one."""
    t = np.tile(np.arange(0.0, 6.0, 0.02), 2)
    log = np.repeat([0, 1], t.size // 2)
    moves = np.where((log == 0) & (t < 1.0), 0.0, np.sin(2 * np.pi * (t - 1.0) + 0.5))
    sets_off = (log == 0) & (t > 0.98) & (t < 1.5)
    touched = (log == 1) & (t > 0.5) & (t < 2.5)
    assert kind_of(of_rows(t, [moves], log), sets_off | touched) == "contact"
    assert kind_of(of_rows(t, [moves], log), sets_off) == "start"


def test_a_column_is_named_beside_one_that_has_its_name() -> None:
    """Degressive friction of a second velocity was written as FD_1 again, which no device can have."""
    device = SimpleNamespace(parameters=SimpleNamespace(names=("FC1", "FD_1", "FD2_1")))
    assert _free_name(device, "FD", "1") == "FD3_1"
    assert _free_name(device, "FD", "2") == "FD_2"
