"""Every class of error is raised, and its sentence is reviewed in `sentences.txt`.

After a change of a sentence write the file again, and read the difference:

    RENEW_SENTENCES=1 python -m pytest tests/errors
"""

from __future__ import annotations

import ast
import inspect
import os
import pickle
import re
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

import haptid
from haptid import errors
from haptid.app.workspace import WorkbenchFolder
from haptid.cli.options import ranges
from haptid.device.toml.errors_at import Place
from haptid.dynamics.forward import ForwardDynamics, sets_of
from haptid.dynamics.symbolic import loop_regroupings
from haptid.dynamics.workspace import Box
from haptid.errors import HaptidError
from haptid.estimation.nonlinear import variable_projection
from haptid.executors import DaskExecutor, ProcessExecutor
from haptid.experiment import bench
from haptid.export import export_c, export_urdf
from haptid.inference.diagnosis import diagnose
from haptid.log import Channels, Signal, read_log
from haptid.report import read_report
from haptid.robot_files import import_robot
from motions import motion, multisine, truth

SENTENCES = Path(__file__).with_name("sentences.txt")
SOURCE = Path(haptid.__file__).parent
CLASSES = {name: kind for name, kind in inspect.getmembers(errors, inspect.isclass) if issubclass(kind, HaptidError)}

DEVICE = """
name = "two links"
gravity = [0.0, -9.81, 0.0]
[[joints]]
name = "1"
[[joints]]
name = "2"
d = 0.3
[[terms]]
kind = "viscous"
joints = "all"
[[terms]]
kind = "coulomb"
joints = "all"
"""
STUDY = """
name = "two links"
device = "device.toml"
[[logs]]
path = "log.csv"
"""
EXPERIMENT = 'name = "test"\n'
COLUMN = '[[terms]]\nkind = "custom"\nname = "C"\nunit = "N m"\nexpression = "{}"\njoints = ["1"]\n'
CHANNELS = Channels(position=Signal(("q1", "q2"), "rad"), torque=Signal(("tau1", "tau2"), "N m"), time="t")

Case = Callable[[Path], object]
CASES: dict[str, Case] = {}


def case(function: Case) -> Case:
    """Registers a call that raises, in an empty folder."""
    CASES[function.__name__] = function
    return function


def device(folder: Path, text: str = DEVICE) -> haptid.DynamicModel:
    (folder / "device.toml").write_text(text)
    return haptid.DynamicModel(haptid.read_device(folder / "device.toml"))


def log(folder: Path, rows: int = 500, change: Callable[[np.ndarray], None] | None = None) -> Path:
    """A log of two joints, (rows, 5), after a change of its values."""
    q, _, _ = multisine(2, rows * 1e-3, 1e-3, 0)
    values = np.column_stack([np.arange(rows) * 1e-3, q.T, 2 * q.T + 0.1])
    if change is not None:
        change(values)
    path = folder / "log.csv"
    np.savetxt(path, values, "%.9g", ",", header="t,q1,q2,tau1,tau2", comments="")
    return path


def moved(folder: Path, **given: object) -> tuple[haptid.DynamicModel, haptid.Motion]:
    model = device(folder)
    return model, motion(model, truth(model), seconds=1.0, **given)  # type: ignore[arg-type]


@case
def shape(_: Path) -> object:
    return haptid.read_device("emps").with_gravity([0.0, 9.81])


@case
def executor_count(_: Path) -> object:
    return ProcessExecutor(0)


@case
def method_setting(_: Path) -> object:
    return haptid.Ridge(share=-1.0)


@case
def box(_: Path) -> object:
    return Box((0.0, 1.0, 0.0), (1.0, 0.0, 1.0))


@case
def cluster(_: Path) -> object:
    return list(DaskExecutor("nowhere").map(abs, [1]))


@case
def output_folder(folder: Path) -> object:
    (folder / "file").touch()
    model = haptid.DynamicModel(haptid.read_device("emps"))
    return export_c((model, np.ones(len(model.base))), folder / "file")


@case
def workbench_path(folder: Path) -> object:
    return WorkbenchFolder(folder).inside("../secret.toml")


@case
def workbench_name(folder: Path) -> object:
    return WorkbenchFolder(folder).save_text("devices/con.toml", "", "")


@case
def device_file_name(_: Path) -> object:
    return haptid.read_device("emsp")


@case
def device_syntax(folder: Path) -> object:
    return device(folder, DEVICE + "[[joints")


@case
def robot_file(folder: Path) -> object:
    (folder / "robot.urdf").write_text('<robot name="r">\n<link name="a"/>\n<joint name="j" type="screw"/>\n</robot>')
    return import_robot(folder / "robot.urdf")


@case
def device_key(folder: Path) -> object:
    return device(folder, DEVICE.replace("d = 0.3", "dd = 0.3"))


@case
def device_expression(folder: Path) -> object:
    return device(folder, DEVICE.replace("d = 0.3", 'd = "2*(1"'))


@case
def device_degrees(folder: Path) -> object:
    return device(folder, DEVICE.replace("d = 0.3", "alpha = 90"))


@case
def device_cycle(folder: Path) -> object:
    return device(folder, DEVICE.replace('name = "1"', 'name = "1"\nparent = "2"'))


@case
def device_transmission(folder: Path) -> object:
    return device(folder, DEVICE + "".join(f'[[motors]]\nname = "{k}"\ndrives = {{ 1 = 1, 2 = 1 }}\n' for k in "ab"))


@case
def column_value(folder: Path) -> object:
    model = device(folder, DEVICE + COLUMN.format("sqrt(q_1)"))
    return model.external(np.full((2, 3), -1.0), np.zeros((2, 3)), np.zeros((2, 3)))


@case
def no_targets(folder: Path) -> object:
    model, made = moved(folder)
    return haptid.inference.targets(haptid.estimate(haptid.observe(model, made), haptid.WLS()))


@case
def no_handle(folder: Path) -> object:
    return haptid.dynamics.handle_motion(device(folder), np.zeros((2, 1)))


@case
def loop_out_of_reach(_: Path) -> object:
    closure = haptid.read_device("five_bar").closure
    return closure.positions(np.linspace([2.356, 0.785], [3.14, 0.0], 50).T)


@case
def loop_in_another_unit(_: Path) -> object:
    return haptid.read_device("five_bar").closure.positions(np.full((2, 1), 1e6))


@case
def loop_singular(folder: Path) -> object:
    kite = """
    name = "kite"
    gravity = [0, -9.81, 0]
    [[joints]]
    name = "crank"
    [[joints]]
    name = "coupler"
    d = 0.2
    [[joints]]
    name = "rocker"
    parent = "base"
    d = 0.2
    [[loops]]
    passive = ["coupler", "rocker"]
    at = { crank = 1.0 }
    guess = { rocker = 0.3 }
    cut = { body_a = "coupler", frame_a = { d = 0.3 }, body_b = "rocker", frame_b = { d = 0.3 } }
    """
    return device(folder, kite).device.closure.positions(np.linspace(1.0, -1.013, 100)[None])


@case
def log_absent(folder: Path) -> object:
    return read_log(folder / "log.csv", CHANNELS)


@case
def log_text(folder: Path) -> object:
    path = log(folder)
    path.write_text(path.read_text().replace("\n0.005,", "\noops,"))
    return read_log(path, CHANNELS)


@case
def log_channel(folder: Path) -> object:
    signal = Signal(("q1", "q3"), "rad")
    return read_log(log(folder), Channels(position=signal, torque=CHANNELS.torque, time="t"))


@case
def log_unit(folder: Path) -> object:
    signal = Signal(("q1", "q2"), "degre")
    return read_log(log(folder), Channels(position=signal, torque=CHANNELS.torque, time="t"))


@case
def log_not_finite(folder: Path) -> object:
    return read_log(log(folder, change=lambda x: x.__setitem__((7, 2), np.nan)), CHANNELS)


@case
def log_constant(folder: Path) -> object:
    return read_log(log(folder, change=lambda x: x.__setitem__((slice(None), 3), 1.0)), CHANNELS)


@case
def log_backwards(folder: Path) -> object:
    return read_log(log(folder, change=lambda x: x.__setitem__((slice(200, None), 0), x[200:, 0] - 0.1)), CHANNELS)


@case
def log_of_gaps(folder: Path) -> object:
    def pauses(x: np.ndarray) -> None:
        x[:, 0] += 0.2 * (np.arange(len(x)) // 40)

    return read_log(log(folder, change=pauses), CHANNELS)


@case
def log_of_another_device(folder: Path) -> object:
    model = haptid.DynamicModel(haptid.read_device("phantom_premium_15"))
    return haptid.observe(model, haptid.treat(read_log(log(folder), CHANNELS), haptid.Treatment(cutoff_hz=30)))


@case
def treatment_setting(_: Path) -> object:
    return haptid.Treatment(cutoff_hz=-1.0)


@case
def motion_too_short(folder: Path) -> object:
    return haptid.treat(read_log(log(folder, rows=60), CHANNELS), haptid.Treatment(cutoff_hz=1)).usable


@case
def no_accelerations(_: Path) -> object:
    return haptid.Treatment(cutoff_hz=None, velocity=haptid.motion.HighPass(30.0))


@case
def too_few_rows(folder: Path) -> object:
    model = device(folder)
    return haptid.estimate(haptid.observe(model, motion(model, truth(model), seconds=0.003)), haptid.OLS())


@case
def not_excited(folder: Path) -> object:
    model, made = moved(folder)
    flat = (made.qd * [1.0, 0.0], np.zeros_like(made.qdd))
    still = haptid.Motion(made.dt, made.q * [1.0, 0.0], made.tau, haptid.Treatment(cutoff_hz=None), rates=flat)
    return haptid.estimate(haptid.observe(model, still), haptid.OLS())


@case
def no_body(folder: Path) -> object:
    model = device(folder)
    return haptid.export.export_urdf((model, -np.ones(len(model.base))), folder / "out")


@case
def nothing_searched(folder: Path) -> object:
    model, made = moved(folder)
    return variable_projection(model, [made])


@case
def rows_twice(folder: Path) -> object:
    model, made = moved(folder)
    observation = haptid.observe(model, made)
    return observation + observation


@case
def rows_seen(folder: Path) -> object:
    model, made = moved(folder)
    return haptid.validate(haptid.estimate(haptid.observe(model, made), haptid.WLS()), made)


@case
def two_devices(folder: Path) -> object:
    model, made = moved(folder)
    return haptid.observe(model, made) + haptid.observe(device(folder), made)


@case
def no_inertia(folder: Path) -> object:
    model = device(folder)
    still = np.zeros((2, 1))
    return ForwardDynamics(model, sets_of(model, np.zeros(len(model.base)))).acceleration(still, still, still)


@case
def symbols_in_loops(folder: Path) -> object:
    device(folder, DEVICE + '[[loops]]\nrelations = ["q2 = q1"]\n')
    return loop_regroupings(folder / "device.toml")


@case
def empty_workspace(_: Path) -> object:
    model = haptid.DynamicModel(haptid.read_device("phantom_premium_15"))
    return haptid.dynamics.workspace(model, box=Box((9.0, 9.0, 9.0), (9.1, 9.1, 9.1))).grid()


@case
def unknown_parameter(folder: Path) -> object:
    model, made = moved(folder)
    return haptid.estimate(haptid.observe(model, made), haptid.estimation.FixedAtZero(("FV9",)))


@case
def trajectory_too_short(_: Path) -> object:
    model = haptid.DynamicModel(haptid.read_device("emps"))
    return bench.plan(bench.Multisine(0.5, (0.0,), (0.1,)), model, 1e-3, np.random.default_rng(0))


@case
def figure_count(_: Path) -> object:
    model = haptid.DynamicModel(haptid.read_device("phantom_premium_15"))
    return bench.plan(bench.Multisine(4.0, (0.0, 0.0, 0.0), (0.1, 0.2)), model, 1e-3, np.random.default_rng(0))


@case
def experiment_key(folder: Path) -> object:
    (folder / "experiment.toml").write_text(EXPERIMENT + "sped = 1\n")
    return bench.read_experiment(folder / "experiment.toml")


@case
def not_validated(folder: Path) -> object:
    model, made = moved(folder)
    return export_c(haptid.estimate(haptid.observe(model, made), haptid.WLS()), folder / "out", largest_error=5.0)


@case
def study_key(folder: Path) -> object:
    (folder / "study.toml").write_text(STUDY + "[treatmnt]\n")
    return haptid.read_study(folder / "study.toml")


@case
def study_absent(folder: Path) -> object:
    return haptid.read_study(folder / "study.toml")


@case
def no_result(folder: Path) -> object:
    return read_report(folder)


@case
def option(_: Path) -> object:
    return ranges("--limit", ["q1"])


@case
def more_joints_than_rows(_: Path) -> object:
    model = haptid.DynamicModel(haptid.read_device("arm7"))
    return haptid.characterise(
        haptid.end_effector.GivenParameters(model, np.ones(len(model.base))), np.full((7, 1), 0.3)
    ).weight


@case
def too_few_passes(_: Path) -> object:
    model = haptid.DynamicModel(haptid.read_device("phantom_premium_15"))
    made = motion(model, truth(model), seconds=2.0, noise=1e-3)
    return haptid.estimate(haptid.observe(model, made), haptid.OutputErrorMethod(most=1))


@case
def no_compiler(folder: Path) -> object:
    model = haptid.DynamicModel(haptid.read_device("emps"))
    export_c((model, np.ones(len(model.base))), folder / "out")
    before = os.environ.get("CC")
    os.environ["CC"] = "no-such-compiler"
    try:
        return bench.Compiled.of(folder / "out").observer(100.0, 1e-3)
    finally:
        del os.environ["CC"]
        if before is not None:
            os.environ["CC"] = before


def sentence(name: str, folder: Path) -> tuple[HaptidError, str]:
    """The error of a case, and its class and text without what differs between machines."""
    folder.mkdir()
    with pytest.raises(HaptidError) as raised:
        CASES[name](folder)
    error = raised.value
    public = next(kind.__name__ for kind in type(error).__mro__ if kind.__module__ in PACKAGE)
    text = str(error).replace(str(folder), "FOLDER")
    text = re.sub(r"\blog motion [0-9a-f]+", "log ID", text)
    text = re.sub(r"\d(\.\d+)?e-(0[5-9]|[1-3]\d)\b", "SMALL", text)
    return error, f"{name}\n  {public}: {text}\n"


# Where the classes are defined.
PACKAGE = ("haptid.errors",)


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[HaptidError, str]]:
    folder = tmp_path_factory.mktemp("cases")
    return {name: sentence(name, folder / name) for name in CASES}


def test_sentences_are_the_reviewed_ones(found: dict[str, tuple[HaptidError, str]]) -> None:
    text = "\n".join(shown for _, shown in found.values())
    if os.environ.get("RENEW_SENTENCES"):
        SENTENCES.write_text(text, encoding="utf-8")
    assert text.split("\n\n") == SENTENCES.read_text(encoding="utf-8").split("\n\n")


def test_errors_are_sentences_and_cross_processes(found: dict[str, tuple[HaptidError, str]]) -> None:
    for name, (error, _) in found.items():
        assert str(error).rstrip().endswith((".", '"', "`")), name
        again = pickle.loads(pickle.dumps(error))
        assert (type(again), str(again)) == (type(error), str(error))
        assert again.advice == error.advice


def test_every_class_that_can_be_raised_here_has_a_sentence(found: dict[str, tuple[HaptidError, str]]) -> None:
    known = {name for name, kind in CLASSES.items() if kind.__module__ in PACKAGE}
    assert known == {kind.__name__ for error, _ in found.values() for kind in type(error).__mro__} & known


def test_every_class_is_raised_in_the_package() -> None:
    made = {name for path in SOURCE.rglob("*.py") if path.name != "errors.py" for name in constructed(path)}
    raised = {base for name in made for base in CLASSES[name].__mro__}
    assert [name for name, kind in CLASSES.items() if kind.__module__ in PACKAGE and kind not in raised] == []


# Functions of errors.py that compose an error, and its class.
COMPOSED = {"unknown_name": "UnknownNameError", "setting_error": "SettingError"}


def constructed(path: Path) -> Iterator[str]:
    """Classes of errors of which a module makes one, or that it hands to another that does."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Call):
            for part in (node.func, *node.args):
                if isinstance(part, ast.Name) and (name := COMPOSED.get(part.id, part.id)) in CLASSES:
                    yield name


def test_message_fields_advice_and_notes() -> None:
    error = errors.LogDataError("q1 is 3.", where="q1", found=3, limit=2, advice="Map another.", notes=["seen twice"])
    assert str(error) == "q1 is 3. Map another."
    assert (error.where, error.found, error.limit, error.advice) == ("q1", 3, 2, "Map another.")
    assert error.__notes__ == ["seen twice"]
    assert str(Place("a.toml", "joints[0]").error("found 1", "Write 2.")) == "a.toml: joints[0]: found 1. Write 2."


def test_a_key_of_a_hostile_file_does_not_fill_the_screen(tmp_path: Path) -> None:
    """200 000 characters of a key are shown by its ends; paths as long as a system allows a name are whole."""
    path = tmp_path / ("d" * 200) / ("e" * 200)
    path.mkdir(parents=True)
    device = path / "device.toml"
    device.write_text('name = "d"\n' + "k" * 200_000 + " = 1\n")
    with pytest.raises(HaptidError) as caught:
        haptid.read_device(device)
    assert str(device) in str(caught.value)
    assert "(20000" in str(caught.value)
    assert len(str(caught.value)) < 3000


def test_names_are_suggested() -> None:
    assert errors.suggestion("FV11", ["FV1", "FC1"]) == 'Did you mean "FV1"? Known: FV1, FC1.'
    assert errors.suggestion("x", []) == "Known: none."
    assert errors.keys_here("logs.0.pth", ["path"]) == 'Did you mean "path"? Keys here: path.'
    assert errors.keys_here("logs", ()) == ""
    assert errors.listed("abcd", 2) == "a, b and 2 more"


def test_advice_names_the_decimation_only_where_there_is_one(tmp_path: Path) -> None:
    model, read = device(tmp_path), read_log(log(tmp_path), CHANNELS)
    for given, advice in (
        ({"cutoff_hz": 900.0}, "Lower cutoff_hz."),
        ({"parallel_cutoff_hz": 900.0}, "Lower parallel_cutoff_hz."),
        ({"parallel_cutoff_hz": 60.0, "decimation": 10}, "Lower parallel_cutoff_hz, or reduce the decimation."),
    ):
        with pytest.raises(errors.TreatmentError) as raised:
            haptid.observe(model, haptid.treat(read, haptid.Treatment(**{"cutoff_hz": 30.0} | given)))
        assert raised.value.advice == advice


def test_an_export_that_fails_speaks_of_no_experiment_alone(tmp_path: Path) -> None:
    model, stribeck = device(tmp_path), '[[terms]]\nkind = "stribeck"\njoints = ["1"]\nvelocity = 1\n'
    more = device(tmp_path, DEVICE + stribeck)
    sticking = truth(more)
    sticking[more.base.names.index("FS1")] = 0.01
    for given, said in (((more, sticking), "without this term"), ((model, -truth(model)), "physical")):
        with pytest.raises(HaptidError, match=said) as raised:
            export_urdf(given, tmp_path / "urdf")
        assert "experiment" not in str(raised.value)
        assert "bench" not in str(raised.value)


def test_what_is_looked_up_by_a_wrong_name_says_which_there_are(tmp_path: Path) -> None:
    model, made = moved(tmp_path)
    estimate = haptid.estimate(haptid.observe(model, made), haptid.OLS())
    for value in (estimate, diagnose(estimate)):
        with pytest.raises(errors.UnknownNameError, match=r"no .* 'nope'.*Known"):
            value["nope"]
    assert len(f"{estimate.observation}".splitlines()) <= 20
