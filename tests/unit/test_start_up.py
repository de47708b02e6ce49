"""Start-up: what is not called is not loaded."""

import pkgutil
import subprocess
import sys

import pytest

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


def test_every_public_name_is_there_and_is_no_module() -> None:
    modules = {module.name for module in pkgutil.iter_modules(haptid.__path__)} - {"errors"}
    assert not modules & set(haptid.__all__)
    assert set(haptid.__all__) <= set(dir(haptid))
    for name in haptid.__all__:
        assert getattr(haptid, name) is not None


def test_a_name_that_is_not_there_is_refused() -> None:
    with pytest.raises(AttributeError, match="no attribute 'identifier'"):
        haptid.identifier  # noqa: B018
