"""The folder of a test's workbench, the workbench itself and a tab of the browser that is at home in it."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from browser import Page
from once import made_once, run_folder
from small_study import DEVICE, STUDY, columns
from workbenches import Bench, ended, started


def write_folder(folder: Path) -> None:
    """Two links, two logs and a study, in the layout of the workbench."""
    import pyarrow as pa
    import pyarrow.csv

    for name in ("devices", "studies", "logs"):
        (folder / name).mkdir(parents=True)
    (folder / "devices" / "two-links.toml").write_text("# As built in 2026.\n" + DEVICE.lstrip())
    text = STUDY.replace('"device.toml"', '"../devices/two-links.toml"')
    text = text.replace('"log.csv"', '"../logs/sweep.csv"').replace('"check.csv"', '"../logs/check.csv"')
    (folder / "studies" / "two-links.toml").write_text(text.lstrip())
    for seed, name in ((1, "sweep.csv"), (2, "check.csv")):
        pyarrow.csv.write_csv(pa.table(columns(seed)), folder / "logs" / name)


@pytest.fixture(scope="session")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder as it is before anything was done in it; it is copied, and not changed."""
    return made_once(run_folder(tmp_path_factory) / "workbench-folder", write_folder)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, plain: Path) -> Path:
    """A folder of the module's own."""
    made = tmp_path_factory.mktemp("bench") / "lab"
    shutil.copytree(plain, made)
    return made


@pytest.fixture(scope="module")
def bench(folder: Path) -> Iterator[Bench]:
    """The workbench of the module's folder."""
    made = started(folder)
    yield made
    ended(made)


@pytest.fixture(scope="module")
def tab(browser_tab: Page, bench: Bench) -> Iterator[Page]:
    """A tab of the browser, at home in the workbench."""
    with browser_tab.another() as opened:
        opened.go(bench.address, 1280)
        yield opened


@pytest.fixture(autouse=True)
def untroubled(request: pytest.FixtureRequest) -> Iterator[None]:
    """In a test with a browser: no error in the console, and no request to anything but this server."""
    if "tab" not in request.fixturenames:
        yield
        return
    tab, bench = request.getfixturevalue("tab"), request.getfixturevalue("bench")
    tab.troubles.clear()
    tab.asked.clear()
    yield
    assert tab.troubles == []
    assert [one for one in tab.asked if not one.startswith((bench.origin, "data:", "blob:", "about:"))] == []
