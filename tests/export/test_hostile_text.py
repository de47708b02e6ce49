"""Names, units and descriptions that would mean something else in a file: parsed or compiled, they are only text."""

import csv
import json
import re
import subprocess
import tomllib
from html.parser import HTMLParser
from pathlib import Path
from xml.etree import ElementTree

import pytest
from hypothesis import given
from hypothesis import strategies as st

import haptid
from compiled import compiler
from haptid._internal import escaping
from haptid._internal.atomic_folder import MANIFEST
from haptid.cli.common import err, out
from haptid.export import EXPORTERS, CCode, export_model
from haptid.report import make_report
from small_study import DEVICE, STUDY, write_study

HOSTILE = "".join(
    (
        "*/ int owned; /* */ \\\n #include <x> --> <!-- ]]> </script><script>owned()</script>",
        "<img src=x onerror=owned()> &amp; {{7*7}} {% owned %} @name ${owned} %{ \n%} \\input{/etc/passwd} $x^2$ #_~",
        " \x1b[2J\x1b]0;owned\x07 \x9b31m \u202e \u2028owned\u2029 \x85owned =cmd|' /C calc'!A0 \x00 \x0c ---",
    )
)
UNIT = r"\input{/etc/passwd}*/-->%<img>"
# What a user's text may hold in a TOML file, written with escapes.
TEXT = json.dumps(HOSTILE, ensure_ascii=True)


@pytest.fixture(scope="module")
def identification(tmp_path_factory):
    """A study with hostile texts wherever a file may have them."""
    folder = tmp_path_factory.mktemp("hostile")
    write_study(folder)
    (folder / "check.csv").rename(folder / (log := "=check\x1b[2J<script>*.csv"))
    term = (
        f'[[terms]]\nkind = "custom"\nname = "c"\njoints = ["1"]\nunit = {json.dumps(UNIT)}\nexpression = "sin(q_1)"\n'
    )
    device = DEVICE.replace('"two links"', f"{TEXT}\ndescription = {TEXT}\nsource = {TEXT}") + term
    (folder / "device.toml").write_text(device)
    study = STUDY.replace('name = "two links"', f"name = {TEXT}").replace('"check.csv"', json.dumps(log))
    (folder / "study.toml").write_text(study)
    return haptid.identify(haptid.read_study(folder / "study.toml"))


@pytest.fixture(scope="module")
def exported(identification, tmp_path_factory):
    """Every export of it."""
    folder = tmp_path_factory.mktemp("exports")
    export_model(
        identification,
        folder,
        [name for name in EXPORTERS if name not in ("mjcf", "urdf", "chai3d", "dvrk")],
        CCode("arm"),
    )
    return folder


def texts(folder: Path) -> list[tuple[Path, str]]:
    return [(path, path.read_text()) for path in sorted(folder.rglob("*")) if path.is_file()]


def test_no_written_file_has_control_characters(exported):
    for path, text in texts(exported):
        assert not re.search(r"[\x00-\x09\x0b-\x1f\x7f-\x9f\u2028\u2029\u202e]", text), path


@pytest.mark.parametrize("precision", ["c", "c-single"])
def test_c_compiles_and_defines_nothing_else(exported, precision):
    (source,) = [path for path in (exported / precision).glob("*.c") if path.with_suffix(".h").exists()]
    command = [compiler("gcc"), "-std=c99", "-pedantic", "-Wall", "-Wcomment", "-Werror", "-fsyntax-only", str(source)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    code = re.sub(r"/\*.*?\*/", "", source.with_suffix(".h").read_text(), flags=re.DOTALL)
    assert "owned" not in code


def test_rust_matlab_and_latex_keep_texts_in_comments(exported):
    for path, text in texts(exported / "rust"):
        if path.suffix == ".toml" and path.name != "Cargo.lock":
            tomllib.loads(text)
        assert all(line.lstrip().startswith("//") for line in text.splitlines() if "owned" in line), path
    for path, text in texts(exported / "matlab"):
        if path.suffix == ".m":
            assert all("%" in line.split("owned")[0] for line in text.splitlines() if "owned" in line), path
            assert all("%" in line.split("passwd")[0] for line in text.splitlines() if "passwd" in line), path
    for _, text in texts(exported / "latex"):
        code = "\n".join(line for line in text.splitlines() if not line.startswith("%"))
        assert not [name for name in re.findall(r"\\input\{([^}]*)\}", code) if not re.fullmatch(r"\w+", name)]
        assert not re.search(r"(?<!\\)\$x", code)


def test_json_is_json(exported):
    (path,) = (path for path in (exported / "json").glob("*.json") if path.name != MANIFEST)
    assert json.loads(path.read_text())["device"] == HOSTILE


class Tags(HTMLParser):
    """Elements and attributes of a page."""

    def __init__(self) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))


def test_the_report_has_no_element_of_a_text(identification):
    page = Tags()
    page.feed(make_report(identification, command=HOSTILE).html())
    assert not {"img", "iframe", "object", "embed"} & {tag for tag, _ in page.tags}
    scripts = [attributes.get("type") for tag, attributes in page.tags if tag == "script"]
    assert sorted(map(str, scripts)) == ["None", "application/json", "application/json"]
    for tag, attributes in page.tags:
        assert not [name for name in attributes if name.startswith("on")], tag
        assert not (attributes.get("src") or "").strip(), tag
        assert (attributes.get("href") or "#").startswith(("#", "https://doi.org/", "data:,")), tag


def test_tables_have_no_formula_and_terminals_get_no_code(identification, tmp_path):
    haptid.Result.of(identification).save(tmp_path / "result")
    assert haptid.Result.load(tmp_path / "result").study == HOSTILE
    assert "\x9b" not in (tmp_path / "result" / "result.json").read_text()
    with (tmp_path / "result" / "parameters.csv").open(newline="") as file:
        cells = [cell for row in csv.reader(file) for cell in row]
    assert not [cell for cell in cells if cell.startswith(("=", "@")) or "\x1b" in cell]
    for console in (out, err):
        with console.capture() as captured:
            console.print(f"{HOSTILE}\udc80")
        shown = captured.get()
        assert r"\x1b[2J" in shown
        assert r"\udc80" in shown
        assert not re.search(r"[\x00-\x09\x0b-\x1f\x7f-\x9f\u202e\ud800-\udfff]", shown)


@given(st.text(st.characters(codec=None)))
def test_every_text_in_every_format(text):
    comment = escaping.c_comment(text)
    assert "*/" not in comment
    assert len(comment.splitlines()) <= 1
    assert not comment.endswith("\\")
    lines = escaping.xml_comment(text)
    assert ElementTree.fromstring(f"<a><!--\n{lines}\n--><b/></a>".encode()).find("b") is not None
    assert escaping.printable(text).encode("utf-8").decode() == escaping.printable(escaping.printable(text))
    assert json.loads(escaping.json_text({"a": text})) == {"a": text}
    escaping.json_text({"a": text}).encode("utf-8")
    assert not str(escaping.csv_cell(text)).startswith(("=", "@", "\t", "\r"))
    assert not re.search(r"(?<!\\)[#$%&_]", escaping.latex_text(text).replace(r"\textbackslash{}", ""))
