"""Forms as views on texts, and remedies of logs that are refused: degrees, a wrapped counter, exchanged channels."""

from __future__ import annotations

import json
import tomllib

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pytest

pytest.importorskip("starlette")

from browser import LAPTOP, NARROW, needs_browser
from small_study import columns

STUDY = "studies/two-links.toml"


def text_of(bench, path=STUDY):
    return (bench.folder / path).read_text()


def test_a_form_has_the_values_of_the_text_and_sets_one(bench):
    for kind, path in (("study", STUDY), ("device", "devices/two-links.toml")):
        text = text_of(bench, path)
        fields = bench.ask("POST", "/api/form", {"kind": kind, "text": text})[1]["fields"]
        values = tomllib.loads(text)
        for one in fields:
            at = values
            for key in one["path"]:
                at = (at.get(key) if isinstance(at, dict) else at[key]) if at is not None else None
            assert at == one["value"]
            assert one["kind"] in ("text", "number", "integer", "choice", "numbers")
        assert len(fields) > 20
    asked = {"text": text_of(bench), "field": json.dumps(["treatment", "decimation"]), "value": "8"}
    made = bench.ask("POST", "/api/form/set", asked)[1]["text"]
    assert made == text_of(bench).replace("decimation = 5", "decimation = 8")


@pytest.mark.parametrize(
    "wrong",
    [
        {"field": "[]"},
        {"field": "{}"},
        {"field": "["},
        {"field": '["logs", 7, "role"]'},
        {"field": "[null]"},
        {"text": "a = "},
        {"text": "a = 1\n" * 300_000},
    ],
)
def test_a_wrong_field_is_refused(bench, wrong):
    asked = {"text": text_of(bench), "field": '["name"]', "value": "1"} | wrong
    status, said = bench.ask("POST", "/api/form/set", asked)
    assert (status, bool(said["error"])) == (400, True)
    assert bench.ask("POST", "/api/form", {"kind": "password", "text": "a = 1"})[0] == 400
    assert bench.ask("POST", "/api/form", {"kind": "study", "text": "a = "})[1]["error"]


@needs_browser
def test_a_field_changes_the_text_and_keeps_its_comments(bench, tab):
    path = "studies/commented.toml"
    (bench.folder / path).write_text("# Monday\n" + text_of(bench).replace("[treatment]", "[treatment] # by hand"))
    tab.go(f"{bench.origin}/solve?path={path}", LAPTOP)
    tab.ask("document.querySelector('details.form').open = true")
    field = 'input[data-field=\'["treatment","cutoff_hz"]\']'
    tab.wait(f"document.querySelector({json.dumps(field)})")
    tab.write(field, "25")
    area = "document.getElementById('editor-study-file')"
    tab.wait(f"{area}.value.includes('cutoff_hz = 25')")
    text = tab.ask(f"{area}.value")
    assert text == text_of(bench, path).replace("cutoff_hz = 30", "cutoff_hz = 25")
    tab.wait("document.getElementById('editor-study-file-said').textContent.startsWith('Valid')")
    # A wrong value has its sentence, by the reader of the file.
    tab.write(field, "-3")
    tab.wait(f"{area}.getAttribute('aria-invalid') === 'true'")
    assert text_of(bench, path).startswith("# Monday\n")
    tab.size(NARROW, 900)
    assert tab.ask("document.documentElement.scrollWidth") <= NARROW
    tab.ask(f"{area}.value = {json.dumps(text_of(bench, path))}")  # nothing unsaved is left


def spoiled(name):
    """A log with one fault, and the study's text as a person would have written it."""
    made = columns(3, 8.0)
    if name == "degrees":
        made |= {key: np.rad2deg(made[key]) for key in ("q1", "q2")}
    elif name == "wrapped":
        made["q1"] = np.mod(made["q1"] + 3 * np.arange(made["q1"].size) * 2e-3, 2 * np.pi)
    elif name == "leap":
        made["q1"] = made["q1"] + 1.0 * (np.arange(made["q1"].size) >= 2000)
    elif name == "exchanged":
        made["q2"] = 1.3 + 0.5 * made["q2"]
    return made


FAULTS = {
    "degrees": ("Positions are in deg", lambda text: text),
    "wrapped": ("unwrap", lambda text: text),
    "leap": ("Use the log from 4.000 s on", lambda text: text),
    "exchanged": ("Exchange q2 and q1", lambda text: text.replace('["q1", "q2"]', '["q2", "q1"]')),
}


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_has_a_remedy_that_works(bench, name):
    """Links have narrow limits, as of a real device, so that faults can be seen."""
    title, written = FAULTS[name]
    device = text_of(bench, "devices/two-links.toml")
    limits = "[-2.0, 2.0]", "[-2.5, 2.5]"
    narrow = {"exchanged": ("[-0.9, 0.9]", "[0.7, 2.0]"), "wrapped": ("[-100.0, 100.0]", "[-2.5, 2.5]")}
    for old, new in zip(limits, narrow.get(name, limits), strict=True):
        device = device.replace(old, new)
    (bench.folder / "devices" / "narrow.toml").write_text(device)
    pyarrow.csv.write_csv(pa.table(spoiled(name)), bench.folder / "logs" / "spoiled.csv")
    text = text_of(bench).replace("sweep.csv", "spoiled.csv").replace("two-links.toml", "narrow.toml")
    text = "# kept\n" + written(text)
    found = bench.ask("POST", "/api/study/remedies", {"path": "studies/spoiled.toml", "text": text})[1]["logs"][0]
    assert found["problem"], found
    (remedy,) = (one for one in found["remedies"] if title in one["title"] and "and jump" not in one["title"])
    assert remedy["text"].startswith("# kept\n")
    again = {"path": "studies/spoiled.toml", "text": remedy["text"]}
    assert bench.ask("POST", "/api/study/remedies", again)[1]["logs"][0]["problem"] == ""
    (bench.folder / "logs" / "spoiled.csv").unlink()


@needs_browser
def test_a_remedy_is_pressed(bench, tab):
    pyarrow.csv.write_csv(pa.table(spoiled("degrees")), bench.folder / "logs" / "degrees.csv")
    tab.go(f"{bench.origin}/data?path=logs/degrees.csv&device=devices/two-links.toml", LAPTOP)
    tab.ask("[...document.querySelectorAll('form')].at(-2).querySelectorAll('select')[2].value = ''")  # no other log
    tab.ask("[...document.querySelectorAll('form')].at(-2).requestSubmit()")
    area = "document.getElementById('editor-study-file')"
    tab.wait("document.querySelectorAll('#remedies h3').length")
    tab.write("#editor-study-file", tab.ask(f"{area}.value").replace('unit = "deg"', 'unit = "rad"'))
    press = "[...document.querySelectorAll('button')].find((b) => b.textContent === '{}')"
    tab.ask(press.format("Read the logs again") + ".click()")
    tab.wait(press.format("Positions are in deg"))
    tab.ask(press.format("Positions are in deg") + ".click()")
    tab.wait("document.querySelector('#remedies .ok') && !document.querySelector('#remedies .problem')")
    assert 'unit = "deg"' in tab.ask(f"{area}.value")
    tab.ask(f"{area}.value = ''")


@needs_browser
def test_a_stretch_that_is_seen_is_left_out(bench, tab):
    """Zoomed by keys; the button says the stretch, and its text has it as `exclude`."""
    tab.go(f"{bench.origin}/data?path=logs/sweep.csv&device=devices/two-links.toml", LAPTOP)
    tab.ask("[...document.querySelectorAll('form')].at(-2).querySelectorAll('select')[2].value = ''")  # no other log
    tab.ask("[...document.querySelectorAll('form')].at(-2).requestSubmit()")
    area = "document.getElementById('editor-study-file')"
    press = "[...document.querySelectorAll('button')].find((b) => b.textContent.startsWith('Leave out'))"
    tab.wait("document.querySelectorAll('#remedies h3').length")
    assert tab.ask(f"{press}.disabled")
    tab.ask("document.querySelector('.plot').focus()")
    for key in ("+", "+", "+"):
        tab.press(key)
    begin, end = map(float, tab.ask(f"{press}.textContent.match(/[0-9.]+/g)"))
    whole = 2e-3 * (len(columns(1)["t"]) - 1)
    assert end - begin == pytest.approx(whole / 8, abs=2e-3)
    tab.ask(f"{press}.click()")
    tab.wait(f"{area}.value.includes('exclude')")
    logs = tomllib.loads(tab.ask(f"{area}.value"))["logs"]
    assert [log.get("exclude") for log in logs if log["path"].endswith("sweep.csv")] == [[[begin, end]]]
    tab.wait("document.querySelector('#remedies .ok') && !document.querySelector('#remedies .problem')")
    tab.ask(f"{area}.value = ''")
    wrong = {"text": "", "log": "logs/sweep.csv", "begin": "0", "end": "1"}
    for change in ({}, {"text": "a ="}, {"text": text_of(bench), "begin": "x"}, {"text": text_of(bench), "log": "x"}):
        status, said = bench.ask("POST", "/api/form/leave-out", wrong | change)
        assert (status, bool(said["error"])) == (400, True)
