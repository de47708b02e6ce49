"""Start-up: what is not called is not loaded."""

import math
import pkgutil
import subprocess
import sys
from importlib import import_module
from operator import attrgetter

import pytest
import typer

import command_time
import haptid

# Together they take a second or more to load.
HEAVY = ("numpy", "scipy", "pyarrow", "h5py", "pydantic", "matplotlib", "clarabel", "mujoco", "sympy")


def loaded(program: str) -> set[str]:
    """Packages that a program has loaded at its end."""
    printed = f"{program}\nimport sys\nprint('loaded', *sys.modules)"
    run = subprocess.run([sys.executable, "-c", printed], capture_output=True, text=True, check=True)
    return {name.split(".")[0] for name in run.stdout.splitlines()[-1].split()}


HELP = """
import sys
from haptid.cli import app
sys.argv = ["haptid", "--help"]
try:
    app()
except SystemExit:
    pass
"""


@pytest.mark.parametrize("program", ["import haptid", HELP])
def test_import_and_help_load_nothing_heavy(program: str) -> None:
    assert not loaded(program) & set(HEAVY)


@pytest.mark.parametrize("name", ["identify", "import", "app", "friction"])
def test_a_command_is_registered_alone(name: str) -> None:
    program = HELP.replace('"--help"', f'"{name}", "--help"').replace("import app", "import main as app")
    printed = f"{program}\nfrom haptid.cli import common\nprint(sum(n.startswith('haptid.cli.') for n in sys.modules))"
    run = subprocess.run([sys.executable, "-c", printed], capture_output=True, text=True, check=True)
    assert f"Usage: haptid {name}" in run.stdout
    assert int(run.stdout.splitlines()[-1]) <= 3


def test_every_command_is_known_by_its_name() -> None:
    from haptid import cli

    assert sorted(cli._COMMANDS.split()) == sorted(typer.main.get_command(cli.app).commands)


@pytest.mark.parametrize(
    ("rooms", "absent"),
    [
        (
            "haptid.advice, haptid.report.report",
            "scipy.stats scipy.signal scipy.optimize scipy.sparse scipy.spatial scipy.ndimage matplotlib asyncio",
        ),
        (
            "haptid.report.run, haptid.report.tables",
            "haptid.advice haptid.report.report jinja2 scipy.optimize matplotlib asyncio",
        ),
        ("haptid.experiment.excitation", "scipy.stats scipy.signal matplotlib mujoco"),
    ],
    ids=["with a report", "numbers alone", "the search for a motion"],
)
def test_an_identification_loads_only_what_it_calls(rooms: str, absent: str) -> None:
    """Each takes as long to load as an identification of a short log computes."""
    program = f"import haptid.cli.work, haptid.report.source, {rooms}\nimport sys\nprint('loaded', *sys.modules)"
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert not set(absent.split()) & set(run.stdout.splitlines()[-1].split())


def test_most_dataclasses_are_not_made_when_they_are_loaded() -> None:
    """Each costs half a millisecond."""
    program = """
import gc, haptid.cli.work, haptid.advice, haptid.report.report
from haptid._internal.late import _Late
own = [one for one in gc.get_objects() if isinstance(one, type) and "__dataclass_fields__" in vars(one)]
own = [one for one in own if str(one.__module__).startswith("haptid.")]
print(len(own), sum(isinstance(vars(one)["__dataclass_fields__"], _Late) for one in own))
"""
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    classes, late = map(int, run.stdout.split())
    assert classes > 300
    assert late > 0.8 * classes


def test_a_log_with_times_is_read_without_what_looks_for_channels(tmp_path) -> None:
    path = tmp_path / "log.csv"
    rows = [f"{0.01 * k:.2f},{math.sin(0.05 * k)},{math.cos(0.05 * k)}" for k in range(200)]
    path.write_text("\n".join(["t,q1,tau1", *rows]), encoding="utf-8")
    program = f"""
from haptid.log import Channels, Signal, read_log
read_log({str(path)!r}, Channels(Signal(("q1",), "rad"), Signal(("tau1",), "N m"), "t"))
import sys
print('loaded', *sys.modules)"""
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert not {"haptid.log.survey", "sqlite3"} & set(run.stdout.splitlines()[-1].split())


@pytest.mark.parametrize("name", [name for stage in command_time.STAGES.values() for name in stage])
def test_every_stage_of_a_command_is_a_function_of_the_package(name: str) -> None:
    module, path = name.split(":")
    assert callable(attrgetter(path)(import_module(module)))


# The namespace of `import haptid`: a further name belongs in its room, or here after some thought.
PUBLIC = """
CLIE CLOE DIDIM EKF GLS IRLS IV OLS SUR TLS UKF WLS BlockJackknife Bootstrap Channels Classical ClusterRobust Comparison
Device Diagnosis DynamicModel ErrorsInVariables Estimate FixedB Identification Log Motion Observation OutputErrorMethod
PhysicallyConsistent Profile Result Ridge Sandwich Signal Study Treatment Validation __version__ characterise compare
design_excitation diagnose eliminate errors estimate estimate_force export_model fit_errors identify identify_payloads
identify_poses inverse_dynamics make_report observe observe_all open_log predict propose read_device read_log read_study
shipped_devices simulate treat validate
"""


def test_the_public_names_are_these() -> None:
    assert sorted(haptid.__all__) == sorted(PUBLIC.split())
    assert 50 <= len(haptid.__all__) <= 66


def test_every_public_name_is_there_and_is_no_module() -> None:
    modules = {module.name for module in pkgutil.iter_modules(haptid.__path__)} - {"errors"}
    assert not modules & set(haptid.__all__)
    # Each room is there without an import of its own.
    assert {module for module in modules if not module.startswith("_")} - {"app", "cli", "demos"} <= set(dir(haptid))
    assert set(haptid.__all__) <= set(dir(haptid))
    for name in haptid.__all__:
        assert getattr(haptid, name) is not None


def test_a_room_is_loaded_at_its_first_use() -> None:
    program = "import haptid; print(haptid.estimation.Bounds.__name__, haptid.inference.drift.__name__)"
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert run.stdout.split() == ["Bounds", "drift"]


def test_a_name_that_is_not_there_is_rejected() -> None:
    with pytest.raises(AttributeError, match="no attribute 'identifier'"):
        haptid.identifier  # noqa: B018


def test_an_interrupt_before_a_command_begins_has_no_traceback(monkeypatch: pytest.MonkeyPatch) -> None:
    from haptid import __main__ as module

    def interrupted() -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("haptid.cli.main", interrupted)
    with pytest.raises(SystemExit) as end:
        module.program()
    assert end.value.code == 130


def test_at_the_end_nothing_is_gone_through_that_a_command_has_loaded() -> None:
    program = """
import atexit, gc, sys
atexit.register(lambda: print(len(gc.get_objects()) < gc.get_freeze_count()))
sys.argv = ["haptid", "--version"]
from haptid.__main__ import program
program()
"""
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert run.stdout.splitlines()[-1] == "True"
