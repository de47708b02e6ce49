"""What README.md and docs/*.md say is so: what they show runs and prints that, links lead somewhere, no key is missing.

A page is walked from top to bottom in a folder of its own, beside a copy of the examples. A `toml` block that begins
with `# name.toml` is saved under that name. A `text` block is what the block before it printed, with `...` where lines
are left out. A command is expected to succeed unless its line ends in `# exit status N`.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import os
import pickle
import re
import runpy
import shlex
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from typer.main import get_command
from typer.testing import CliRunner

import haptid
from haptid.cli import app
from haptid.dynamics.symbolic import loop_regroupings
from haptid.experiment import bench
from once import made_once, run_folder

PROJECT = Path(__file__).resolve().parents[2]
PAGES = [
    PROJECT / "README.md",
    *sorted((PROJECT / "docs").glob("*.md")),
    *sorted((PROJECT / "docs" / "reference").glob("*.md")),
]
FENCE = re.compile(r"^```(\w*)[^\n]*\n(.*?)^```$", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"!?\[[^\]]*\]\(([^)\s]+)\)")
FIGURE = re.compile(r"[-+]?\d+\.?\d*(?:e[-+]?\d+)?")
STATUS = re.compile(r"\s*# exit status (\d)$")
# What the shell does with a command.
SHELL = re.compile(r"[|&;<>$*`]")
SHARED = "../shared/data"
# Step of the simulator, s, where a page sets none: five times the default. Its error is below what pages quote.
STEP = 5e-4
# After which a command that hangs is given up, s.
PATIENCE = 900
# What is smaller is rounding, and another one on another processor.
ROUNDING = 1e-12
# Of each recording: the parameters that the README quotes, with their form, and the form of its errors.
QUOTED = {
    "emps": ({"M1": ".2f", "FV1": ".1f", "FC1": ".2f", "OFF1": ".2f"}, ".2f"),
    "staubli_tx40": ({f"FC{k}": ".2f" for k in range(1, 6)}, ".2f"),
    "kuka_kr300": ({f"FV{k}": ".0f" for k in range(1, 7)}, ".1f"),
}


@dataclass(frozen=True)
class Block:
    """A fenced block of a page: what it is written in, its text, and the line it begins on."""

    page: Path
    language: str
    text: str
    line: int

    def __str__(self) -> str:
        return f"{self.page.name}:{self.line}"

    @property
    def file(self) -> str | None:
        """Name that the block is saved under, where its first line is a comment that is one."""
        named = re.match(r"# (\S+\.toml)\n", self.text)
        return named[1] if named else None

    @property
    def kind(self) -> str:
        """Of a toml block: device, study, or part of one."""
        keys = set(tomllib.loads(self.text))
        if {"name", "gravity", "joints"} <= keys:
            return "device"
        if {"schema", "name", "trajectory", "controller"} <= keys:
            return "experiment"
        return "study" if {"schema", "name", "device", "logs"} <= keys else "part"


def blocks(page: Path, *languages: str) -> list[Block]:
    text = page.read_text(encoding="utf-8")
    found = [Block(page, m[1], m[2], text.count("\n", 0, m.start()) + 1) for m in FENCE.finditer(text)]
    return [block for block in found if not languages or block.language in languages]


def every(*languages: str) -> list[Any]:
    """Blocks of all pages, as parameters of a test."""
    return [pytest.param(block, id=str(block)) for page in PAGES for block in blocks(page, *languages)]


def commands(block: Block) -> Iterator[tuple[str, int]]:
    """Commands of a block, and the exit status that each is expected to have."""
    for line in block.text.splitlines():
        wanted = STATUS.search(line)
        command = line[: wanted.start()] if wanted else line.partition("  # ")[0].strip()
        if command:
            yield command, int(wanted[1]) if wanted else 0


# --- commands and Python ----------------------------------------------------------------------------------------


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working folder like a fresh clone, as far as the pages use one; the recordings beside it, where they are."""
    work = tmp_path / "haptid"
    shutil.copytree(PROJECT / "examples", work / "examples")
    if (PROJECT.parent / "shared").is_dir():
        (tmp_path / "shared").symlink_to(PROJECT.parent / "shared")
    monkeypatch.chdir(work)
    monkeypatch.setenv("PATH", os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]]))
    for threads in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        monkeypatch.setenv(threads, "1")
    return work


@pytest.fixture
def shared(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of the test run, in which outcomes of commands are kept for the other pages."""
    return run_folder(tmp_path_factory)


@pytest.fixture
def recordings_kept(shared: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Pages ask the bench for the same recordings: of an experiment with one seed it simulates one in a test run."""
    simulated = bench.perform

    def kept(experiment: bench.Experiment, setup: bench.Setup, seed: int, progress: Any = None) -> bench.Recording:
        tables = (experiment.table, setup.model.device.tables)
        text = f"{[table.model_dump_json(by_alias=True) for table in tables]} {setup.model.device.gravity} {seed}"
        name = f"recording-{hashlib.sha256(text.encode()).hexdigest()[:16]}"
        if experiment.table.physics is None:
            setup = replace(setup, physics=replace(setup.physics, step=STEP))
        made = made_once(
            shared / name,
            lambda folder: (folder / "made").write_bytes(pickle.dumps(simulated(experiment, setup, seed, progress))),
        )
        return pickle.loads((made / "made").read_bytes())

    monkeypatch.setattr("haptid.experiment.bench.run.perform", kept)
    monkeypatch.setattr(bench, "perform", kept)


@pytest.mark.usefixtures("recordings_kept")
@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(PROJECT).as_posix())
def test_page_runs_from_top_to_bottom(page: Path, folder: Path, shared: Path) -> None:
    names: dict[str, Any] = {}
    printed, cause = "", None
    for block in blocks(page):
        if block.language == "bash" and SHARED not in block.text:
            printed, cause = run_commands(block, shared), block
        elif block.language == "python":
            printed, cause = run_python(block, names), block
        elif block.language == "toml" and block.file:
            (folder / block.file).write_text(block.text, encoding="utf-8")
        elif block.language == "text" and cause:
            check_output(block, printed)


@pytest.mark.parametrize("block", [b for b in every("bash") if SHARED in b.values[0].text])
@pytest.mark.usefixtures("shared_data")
def test_commands_on_the_recordings_run_and_reach_the_figures_quoted(block: Block, folder: Path, shared: Path) -> None:
    run_commands(block, shared)
    for line in block.text.splitlines():
        if match := re.search(r"examples/(\w+)/study.toml .*--out (\S+)", line):
            quoted_figures(match[1], json.loads((folder / match[2] / "result.json").read_text(encoding="utf-8")))


def run_commands(block: Block, shared: Path) -> str:
    """Run a block line by line; what its commands printed."""
    printed = ""
    for command, wanted in commands(block):
        if command.startswith("make "):
            printed += run_make(command.removeprefix("make ").split()[0], shared)
        elif command == ". .venv/bin/activate":
            assert "VENV := .venv" in (PROJECT / "Makefile").read_text(encoding="utf-8")
        else:
            status, shown = run_once(command, shared)
            assert status == wanted, f"{block}: {command}\n{shown}"
            printed += shown
    return printed


def run_once(command: str, shared: Path) -> tuple[int, str]:
    """Exit status of a command and what it printed: of the first page that has run it on the same files.

    Those are the files and folders that it names, but for its output, and every TOML file of the working folder.
    """
    if not command.startswith(("haptid ", "python ")) or SHELL.search(command) or SHARED in command:
        return run_command(command)
    words = shlex.split(command)
    named = [Path(word) for before, word in pairwise(words) if before != "--out" and Path(word).exists()]
    state = hashlib.sha256(command.encode())
    for path in sorted({*named, *Path().glob("*.toml")}):
        for file in sorted(path.rglob("*")) if path.is_dir() else [path]:
            state.update(str(file).encode() + (file.read_bytes() if file.is_file() else b""))

    def make(folder: Path) -> None:
        before = digests()
        (folder / "printed.json").write_text(json.dumps(run_command(command)), encoding="utf-8")
        copy((path for path, digest in digests().items() if before.get(path) != digest), Path(), folder / "files")

    made = made_once(shared / f"command-{state.hexdigest()[:16]}", make)
    left = made / "files"
    copy((path.relative_to(left) for path in left.rglob("*") if path.is_file()), left, Path())
    status, shown = json.loads((made / "printed.json").read_text(encoding="utf-8"))
    return status, shown


def digests() -> dict[Path, str]:
    """SHA-256 of every file of the working folder but the examples."""
    files = (path for path in Path().rglob("*") if path.is_file() and path.parts[0] != "examples")
    return {path: hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


def copy(files: Iterable[Path], source: Path, to: Path) -> None:
    for file in files:
        (to / file).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(source / file, to / file)


def run_command(command: str) -> tuple[int, str]:
    """Exit status of a command, and what it printed.

    haptid and the scripts of the examples run in this process, as starting one takes longer than most of them; what
    needs the shell goes to it.
    """
    first, *others = shlex.split(command)
    if first == "haptid" and not SHELL.search(command):
        done = CliRunner().invoke(app, others)
        if done.exception and not isinstance(done.exception, SystemExit):
            raise done.exception
        return done.exit_code, done.output
    if first == "python" and others[0].endswith(".py") and not SHELL.search(command):
        return run_script(*others)
    made = run(["bash", "-c", command])
    return made.returncode, made.stdout + made.stderr


def run_script(script: str, *arguments: str) -> tuple[int, str]:
    """Exit status of a Python script, and what it printed."""
    printed, status = io.StringIO(), 0
    with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(printed):
        patch.setattr(sys, "argv", [script, *arguments])
        patch.syspath_prepend(Path(script).parent.resolve())
        try:
            runpy.run_path(script, run_name="__main__")
        except SystemExit as end:
            status = int(end.code or 0)
    return status, printed.getvalue()


def run_make(target: str, shared: Path) -> str:
    """Targets are only looked up; of the demo the script is run, since pages use the logs that it leaves.

    The command that the script starts is run in this process, once with that of the page.
    """

    def started(command: list[str], **_: Any) -> subprocess.CompletedProcess[str]:
        assert command[:3] == [sys.executable, "-m", "haptid"]
        status, shown = run_once(shlex.join(["haptid", *command[3:]]), shared)
        print(shown)
        return subprocess.CompletedProcess(command, status)

    assert re.search(rf"^{target}:", (PROJECT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE), target
    if target != "demo":
        return ""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("haptid.experiment.bench.run.ProcessExecutor", haptid.executors.SerialExecutor)
        patch.setattr(subprocess, "run", started)
        status, printed = run_script("examples/demo.py", "--out", "demo")
    assert status == 0, printed
    return printed


def run(command: list[str]) -> subprocess.CompletedProcess[str]:
    return subprocess.run(command, capture_output=True, text=True, encoding="utf-8", check=False, timeout=PATIENCE)


def run_python(block: Block, names: dict[str, Any]) -> str:
    """Run a block with the names that earlier ones of its page have made; what it printed."""
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        exec(compile("\n" * block.line + block.text, str(block.page), "exec"), names)
    return printed.getvalue()


def check_output(block: Block, printed: str) -> None:
    """Every stretch of the block between lines of `...` was printed, whatever its widths and line breaks."""
    text, found = plain(printed)
    for part in re.split(r"^\.\.\.$", block.text, flags=re.MULTILINE):
        words, figures = plain(part)
        shares = [
            SPREAD if ESTIMATED.search(line) else 0.01 for line in part.splitlines() for _ in FIGURE.findall(line)
        ]
        places = [text.count("#", 0, match.start()) for match in re.finditer(re.escape(words), text)]
        assert places, f"{block} is not what the block before it prints:\n{part}\n---\n{printed}"
        shown = [found[k : k + len(figures)] for k in places]
        assert any(all(map(alike, figures, other, shares)) for other in shown), (
            f"{block}: figures {figures}, printed {shown}"
        )


def plain(text: str) -> tuple[str, list[str]]:
    """Words with single blanks and # for each figure, and the figures."""
    return " ".join(FIGURE.sub("#", text).split()), FIGURE.findall(text)


# Lines with standard errors or errors of logs, and the spread of these between draws: 1 / sqrt(2 dof) for dof clusters,
# a fifth for a dozen.
ESTIMATED, SPREAD = re.compile(r" \.\. |unseen|of the fit|relative error|standard error"), 0.2


def alike(quoted: str, printed: str, spread: float = 0.01) -> bool:
    """Equal but for what another processor may change; what is only rounding (1e-16) may be any rounding.

    The simulated logs pass through encoders, and a rounding can move a count: on another processor they are another
    draw. Then values change by a few units of the last digit or 1 %, and standard errors and errors of logs, which are
    printed with three digits at most, by their spread.
    """
    before, _, after = quoted.partition(".")
    digits = len((before.lstrip("-") + after).lstrip("0"))
    apart = abs(float(quoted) - float(printed))
    if abs(float(quoted)) < ROUNDING:
        return abs(float(printed)) < ROUNDING
    share = spread if after and digits <= 3 else 0.01
    return apart < max(3.01 * 10.0 ** -len(after), share * abs(float(quoted)))


def quoted_figures(example: str, result: dict[str, Any]) -> None:
    """The README's table of recordings has the figures of this result."""
    values = {p["name"]: p["value"] for p in result["estimate"]["parameters"]}
    unseen = [v["relative_error_percent"] for v in result["validation"] if (v["rows"], v["motor"]) == ("unseen", "all")]
    parameters, error = QUOTED[example]
    figures = [format(values[name], form) for name, form in parameters.items()]
    figures += [format(value, error) for value in (min(unseen), max(unseen))]
    table = re.findall(r"-?\d+(?:\.\d+)?", (PROJECT / "README.md").read_text(encoding="utf-8"))
    assert not set(figures) - set(table), f"README.md does not have these figures of {example}"


# --- device and study files -------------------------------------------------------------------------------------


@pytest.mark.parametrize("block", every("toml"))
def test_device_and_study_files_are_read(block: Block, tmp_path: Path) -> None:
    """Whole files as they stand; parts of one in the place of the same keys in the page's first whole file."""
    wholes = [other for other in blocks(block.page, "toml") if other.kind != "part"]
    text, kind = block.text, block.kind
    if kind == "part":
        text, kind = together(wholes[0].text, text), wholes[0].kind
    path = tmp_path / "file.toml"
    path.write_text(text, encoding="utf-8")
    if kind == "device":
        assert base_parameters_of(path) > 0
    elif kind == "experiment":
        assert bench.read_experiment(path).name
    else:
        assert haptid.read_study(path).logs


def base_parameters_of(path: Path) -> int:
    """Of a device, or of one whose loops need a guess that `loop_regroupings` does without."""
    try:
        return len(haptid.DynamicModel(haptid.read_device(path)).base)
    except haptid.errors.LoopClosureError:
        return len(loop_regroupings(path))


def together(whole: str, part: str) -> str:
    return "".join(f"{key} = {toml(value)}\n" for key, value in (tomllib.loads(whole) | tomllib.loads(part)).items())


def toml(value: Any) -> str:
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{json.dumps(key)} = {toml(item)}" for key, item in value.items()) + " }"
    return f"[{', '.join(map(toml, value))}]" if isinstance(value, list) else json.dumps(value)


# --- links ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(PROJECT).as_posix())
def test_relative_links_lead_somewhere(page: Path) -> None:
    for target in LINK.findall(FENCE.sub("", page.read_text(encoding="utf-8"))):
        if not target.startswith(("https://", "http://", "mailto:")):
            name, _, heading = target.partition("#")
            file = (page.parent / name).resolve() if name else page
            assert file.exists(), f"{page.name} links to {target}, which is not there"
            assert not heading or heading in headings(file), f"{page.name} links to {target}, which has no such heading"


def headings(page: Path) -> set[str]:
    """Anchors of a page's headings, as web sites make them."""
    titles = re.findall(r"^#+ (.+)$", FENCE.sub("", page.read_text(encoding="utf-8")), re.MULTILINE)
    if page.name == "cli.md":  # the site puts the commands there
        titles += [f"haptid {name}" for name in get_command(app).commands]
    return {re.sub(r"[^\w\- ]", "", title.lower()).strip().replace(" ", "-") for title in titles}


def test_navigation_has_every_page() -> None:
    listed = re.findall(r": (\S+\.md)$", (PROJECT / "mkdocs.yml").read_text(encoding="utf-8"), re.MULTILINE)
    assert {page.relative_to(PROJECT / "docs").as_posix() for page in PAGES[1:]} <= set(listed)
    for name in listed:  # the page of a notebook is made from it
        place = PROJECT / "docs" / name
        assert place.exists() or (place.parent.name == "notebooks" and place.with_suffix(".ipynb").exists())


# --- keys -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("page", "schema"),
    [
        ("device-files.md", haptid.device.device_schema),
        ("studies.md", haptid.study.study_schema),
        ("bench.md", bench.experiment_schema),
    ],
)
def test_every_key_is_documented_and_no_other(page: str, schema: Callable[[], dict[str, Any]]) -> None:
    """A table of keys is headed `| keys of `[[joints]]` |`, one of those at the top of the file `| keys |`."""
    known: dict[str, set[str]] = {}
    for table, key in keys(schema(), schema(), ""):
        known.setdefault(table, set()).add(key)
    if page == "bench.md":  # its `[[terms]]` are those of a device file, to which it refers
        devices = list(keys(haptid.device.device_schema(), haptid.device.device_schema(), ""))
        shared = {table: {key for own, key in devices if own == table} for table in known if table.startswith("terms")}
        assert shared == {table: known.pop(table) for table in shared}
        assert "(device-files.md" in (PROJECT / "docs" / page).read_text(encoding="utf-8")
    assert documented(PROJECT / "docs" / page) == known


def keys(node: Any, schema: dict[str, Any], table: str) -> Iterator[tuple[str, str]]:
    """Each table and a key of it: `joints.limits`, `velocity`. Names that a user chooses are none."""
    node = schema["$defs"][node["$ref"].rpartition("/")[2]] if "$ref" in node else node
    for part in (*node.get("anyOf", ()), *node.get("oneOf", ())):
        yield from keys(part, schema, table)
    named = (*node.get("patternProperties", {}).values(), node.get("additionalProperties"))
    for inner in (node.get("items"), *named):
        if isinstance(inner, dict):
            yield from keys(inner, schema, table)
    for key, value in node.get("properties", {}).items():
        yield table, key
        yield from keys(value, schema, f"{table}.{key}".lstrip("."))


def documented(page: Path) -> dict[str, set[str]]:
    found: dict[str, set[str]] = {}
    tables: list[str] = []
    for line in page.read_text(encoding="utf-8").splitlines():
        first = line.split("|")[1].strip() if line.startswith("|") else ""
        named = [name.strip("[]") for name in re.findall(r"`([^`]+)`", first)]
        if first.startswith("keys"):
            tables = named or [""]
        elif not first:
            tables = []
        for table in tables if named and not first.startswith("keys") else ():
            found.setdefault(table, set()).update(named)
    return found
