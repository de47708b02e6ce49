"""The pages in a real browser: drawn without complaint, nothing asked of any other machine, usable by keyboard."""

from __future__ import annotations

import hashlib
import json
import re
import tomllib
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pytest
from typer.testing import CliRunner

pytest.importorskip("starlette")

from browser import HUGE, LAPTOP, NARROW, needs_browser
from haptid.cli import app
from haptid.robot_files import import_robot
from workbenches import pictured

pytestmark = needs_browser
PROJECT = Path(__file__).resolve().parents[2]
EXAMPLES = PROJECT / "examples"
STAGES = ("/", "/device", "/experiment", "/data", "/solve", "/results", "/use", "/live", "/registry")
PAGES = (*STAGES, "/device?path=sr400")


@pytest.mark.parametrize("path", PAGES)
def test_pages_fit_and_are_accessible(bench, tab, path):
    tab.go(bench.origin + path, NARROW)
    assert tab.ask("document.documentElement.scrollWidth") <= NARROW
    assert tab.ask("document.querySelectorAll('h1').length") == 1
    assert tab.ask("document.querySelector('.overlay')?.textContent ?? ''") == ""
    assert tab.accessibility() == []
    # Every stage is marked where one is.
    assert tab.ask("document.querySelectorAll('nav a[aria-current]').length") == 1
    # On a screen of 4K without scaling, text is larger and more than half of the width is used.
    size = "parseFloat(getComputedStyle(document.querySelector('main')).fontSize)"
    small = tab.ask(size)
    tab.size(*HUGE)
    assert tab.ask(size) > 1.5 * small
    assert tab.ask("document.querySelector('main').getBoundingClientRect().width") > HUGE[0] / 2
    assert tab.ask("document.documentElement.scrollWidth") <= HUGE[0]


def test_pages_are_accessible_in_dark_colours_too(bench, tab):
    for path in STAGES:
        tab.go(bench.origin + path, LAPTOP)
        while tab.ask("document.getElementById('theme').value") != "dark":
            tab.ask("document.getElementById('theme').click()")
        assert tab.accessibility() == []


def test_a_wrong_device_has_its_sentence_and_a_right_one_clears_it(bench, tab):
    tab.go(f"{bench.origin}/device?path=devices/two-links.toml", LAPTOP)
    area, said = "#editor-device-file", "document.getElementById('editor-device-file-said').textContent"
    text = tab.ask(f"document.querySelector('{area}').value")
    assert text.startswith("# As built in 2026.")
    tab.wait(f"{said}.includes('10 base parameters')")
    wrong = text.replace('kind = "coulomb"', 'kind = "coulom"')
    tab.write(area, wrong)
    tab.wait(f"{said}.includes('coulomb')")
    assert tab.ask(f"document.querySelector('{area}').getAttribute('aria-invalid')") == "true"
    assert tab.ask("document.querySelector('form button').disabled")
    changed = text.replace("d = 0.3", "d = 0.25")
    tab.write(area, changed)
    tab.wait(f"document.querySelector('{area}').getAttribute('aria-invalid') === 'false'")
    tab.ask("document.querySelector('form').requestSubmit()")
    tab.wait("document.querySelector('form [role=status]').textContent.startsWith('Saved')")
    assert (bench.folder / "devices" / "two-links.toml").read_text() == changed
    read = CliRunner().invoke(app, ["model", str(bench.folder / "devices" / "two-links.toml"), "--json"])
    assert len(json.loads(read.output)["base_parameters"]) == 10
    # Another program changes the file: the second save is refused, and both texts are there.
    (bench.folder / "devices" / "two-links.toml").write_text(text)
    tab.write(area, changed + "# more\n")
    tab.wait(f"document.querySelector('{area}').getAttribute('aria-invalid') === 'false'")
    tab.ask("document.querySelector('form').requestSubmit()")
    tab.wait("document.querySelector('.overlay pre')")
    assert tab.ask("document.querySelector('.overlay pre').textContent") == text
    assert [one for one in tab.troubles if "409" not in one] == []
    tab.troubles.clear()  # the browser notes every answer that is none of success
    assert (bench.folder / "devices" / "two-links.toml").read_text() == text
    tab.ask("[...document.querySelectorAll('.overlay button')][0].click()")
    tab.wait(f"document.querySelector('{area}').value === {json.dumps(text)}")


def test_sliders_move_the_device_by_keyboard_and_loops_stay_closed(bench, tab):
    tab.go(f"{bench.origin}/device?path=four_bar", LAPTOP)
    picture = "document.querySelector('canvas.scene').toDataURL()"
    before = tab.ask(picture)
    tab.ask("document.querySelector('input[data-joint]').focus()")
    slider = "document.querySelector('input[data-joint]')"
    start = tab.ask(f"{slider}.valueAsNumber")
    for _ in range(3):
        tab.press("ArrowRight")
    assert tab.ask(f"{slider}.valueAsNumber") > start
    assert tab.ask(picture) != before
    # The end of the slider cannot be reached by this loop: it stays at a pose that closes.
    tab.press("End")
    value, shown = (
        tab.ask(f"{slider}.valueAsNumber"),
        tab.ask("document.querySelector('.scene .readout, .readout').textContent"),
    )
    assert value < tab.ask(f"Number({slider}.max)") or "do not close" not in shown


def chosen(tab, selector, path):
    """Give a file to a field, as a person's choice."""
    root = tab.call("DOM.getDocument")["root"]["nodeId"]
    found = tab.call("DOM.querySelector", nodeId=root, selector=selector)
    tab.call("DOM.setFileInputFiles", nodeId=found["nodeId"], files=[str(path)])


def test_a_robot_description_becomes_a_device(bench, tab):
    tab.go(f"{bench.origin}/device", LAPTOP)
    source = EXAMPLES / "robots" / "arm.urdf"
    chosen(tab, "input[type=file]", source)
    tab.wait("document.querySelector('form [role=status]').textContent === 'Imported: not saved yet.'")
    text = tab.ask("document.getElementById('editor-device-file').value")
    made = import_robot(source)
    assert tomllib.loads(text) == tomllib.loads(made.text)
    grades = tab.ask("[...document.querySelectorAll('main td .badge')].map((b) => b.textContent)")
    assert grades == [note.grade for note in made.notes]
    assert not (bench.folder / "devices" / "arm.toml").exists()
    said = tab.ask("document.querySelector('#command pre').textContent")
    assert said == "haptid import arm.urdf --out devices/arm.toml"
    tab.wait("!document.querySelector('form button').disabled")
    tab.ask("document.querySelector('form').requestSubmit()")
    tab.wait("document.querySelector('form [role=status]').textContent.startsWith('Saved')")
    assert (bench.folder / "devices" / "arm.toml").read_text() == text
    arm = '<mujoco><worldbody><body name="a"><joint axis="0 0 1"/><geom size="0.1"/></body></worldbody></mujoco>'
    status, made = bench.ask("POST", "/api/import", {"name": "arm.xml", "text": arm})
    assert (status, made["path"]) == (200, "devices/arm-2.toml")
    for name, body in (("a.xacro", source.read_text()), ("a.urdf", "<robot"), ("../a.urdf", source.read_text())):
        assert bench.ask("POST", "/api/import", {"name": name, "text": body})[0] == 400


def test_names_in_files_are_no_markup(bench, tab):
    evil = "<img src=/evil.png onerror=alert(1)><script src=/evil.js></script>"
    text = (bench.folder / "devices" / "two-links.toml").read_text()
    text = text.replace('name = "two links"', f"name = '{evil}'\ndescription = '{evil}'\nsource = '{evil}'")
    (bench.folder / "devices" / "evil.toml").write_text(text)
    for path in ("/", "/device?path=devices/evil.toml"):
        tab.go(bench.origin + path, LAPTOP)
        tab.wait("document.querySelector('main').textContent.includes('<img src=/evil.png')")
        assert tab.ask("document.querySelectorAll('main img, main script').length") == 0
    assert not any("evil.png" in one or "evil.js" in one for one in tab.asked)
    (bench.folder / "devices" / "evil.toml").unlink()


# Zooms in seven times and out again, sixty steps; of each the coloured pixels in the upper part of the focused chart,
# where only a spike is, the points that were drawn, and the width of the chart.
ZOOMING = """(async () => {
  const plot = document.activeElement, canvas = plot.querySelector("canvas"), made = [];
  const copy = new OffscreenCanvas(canvas.width, canvas.height).getContext("2d", { willReadFrequently: true });
  for (let k = 0; k < 60; k++) {
    plot.dispatchEvent(new KeyboardEvent("keydown", { key: k % 14 < 7 ? "+" : "-" }));
    await new Promise((done) => requestAnimationFrame(() => setTimeout(done)));
    const height = Math.floor(0.4 * canvas.height);
    copy.clearRect(0, 0, canvas.width, canvas.height);
    copy.drawImage(canvas, 0, 0);
    const d = copy.getImageData(70, 0, canvas.width - 70, height).data;
    let n = 0;
    for (let i = 0; i < d.length; i += 4) {
      const [r, g, b, ink] = d.subarray(i, i + 4);
      n += ink > 60 && Math.max(r, g, b) - Math.min(r, g, b) > 60;
    }
    made.push([n, Number(plot.dataset.points), plot.clientWidth]);
  }
  return made;
})()"""


def test_a_log_is_dropped_drawn_and_keeps_its_spike(bench, tab):
    rng = np.random.default_rng(1)
    t = np.arange(100_000) * 1e-3
    names = [f"{kind}{k}" for kind in ("q", "tau") for k in range(1, 8)]
    of = {name: np.sin(t * (1 + k)) + 0.01 * rng.standard_normal(t.size) for k, name in enumerate(names)}
    of["tau2"][54_321] = 50.0
    path = bench.folder / "long.csv"
    pyarrow.csv.write_csv(pa.table({"t": t, **of}), path)
    tab.go(f"{bench.origin}/data", LAPTOP)
    chosen(tab, "input[type=file]", path)
    tab.wait("location.search.includes('long.csv') && document.querySelector('#plots')?.dataset.drawn")
    assert (bench.folder / "logs" / "long.csv").read_bytes() == path.read_bytes()
    assert tab.ask("document.querySelectorAll('.u-wrap canvas').length") == 2
    assert tab.ask("document.body.textContent.includes('100000 rows, 1000 Hz')")
    # Sixty steps of zooming by its keys about the spike: the work of each is that of its pixels, not of the samples.
    tab.ask("document.querySelectorAll('.plot')[1].focus()")
    for _ in range(4):
        tab.press("ArrowRight")
    tops, points, widths = zip(*tab.ask(ZOOMING), strict=True)
    assert len(tops) == 60
    assert max(points) <= 4 * min(widths)
    assert len(set(points)) > 2
    assert min(tops) > 0
    assert tab.accessibility() == []
    most = """(async () => {
      const { samples } = await import('/static/pages/data.js'), { thin } = await import('/static/curves.js');
      const data = await samples('logs/long.csv', 't', ['q1', 'tau2']), found = [];
      const most = (from, to, width) => Math.max(...thin(data.t, [data.of.tau2], from, to, width)[1]);
      for (const width of [97, 1000, 3000]) found.push(most(0, 100, width));
      for (const around of [40, 4, 0.04]) found.push(most(54.321 - around, 54.321 + around, 300));
      return [found, data.of.q1.length, Array.from(data.of.q1.slice(0, 3)), data.t[99999]];
    })()"""
    spikes, count, first, end = tab.ask(most)
    assert spikes == [50.0] * 6
    assert count == 100_000
    np.testing.assert_allclose(first, of["q1"][:3].astype(np.float32), rtol=1e-6)
    assert end == pytest.approx(99.999)


# Elements that the Tab key stops at from the focused one to one before that with a text.
STOPS = """(() => {
  const kinds = "a[href], button:enabled, input:enabled, select:enabled, textarea:enabled, summary, [tabindex='0']";
  const all = [...document.querySelectorAll(kinds)].filter((one) => one.checkVisibility());
  const to = all.findIndex((one) => one.textContent === %s);
  return Math.max(0, to - all.indexOf(document.activeElement) - 1);
})()"""


def pressed(tab, text):
    """A button or a link, reached and pressed by keyboard alone."""
    tab.wait(f"[...document.querySelectorAll('button:enabled, a')].some((one) => one.textContent === {text!r})")
    # As many as the page has on the way, then one by one.
    tab.tabs(tab.ask(STOPS % json.dumps(text)))
    for _ in range(40):
        if tab.ask("document.activeElement.textContent") == text:
            return tab.press("Enter")
        tab.press("Tab")
    raise AssertionError(f"not reached by keyboard: {text}")


def test_a_study_is_drafted_checked_and_identified(bench, tab):
    """The stages from a study to its export; what is pressed is pressed by keyboard."""
    tab.go(f"{bench.origin}/data?path=logs/sweep.csv&device=devices/two-links.toml", LAPTOP)
    pressed(tab, "Draft a study")
    tab.wait("document.getElementById('editor-study-file-said')?.textContent.startsWith('Valid')")
    text = tab.ask("document.getElementById('editor-study-file').value")
    assert re.search(r'device = "\.\./devices/two-links\.toml"', text)
    pressed(tab, "Save and go on to solve")
    tab.wait("location.pathname === '/solve' && document.body?.dataset.ready !== undefined")
    assert (bench.folder / "studies" / "two-links-2.toml").read_text() == text
    press = "[...document.querySelectorAll('button')].find((b) => b.textContent === '{}')"
    run = press.format("Run")
    assert tab.ask(f"{run}.disabled")
    assert tab.ask("document.body.textContent.includes('Check first.')")
    pressed(tab, "Check")
    tab.wait(f"!{run}.disabled")
    assert tab.ask("document.body.textContent.includes('No problems were found.')")
    pressed(tab, "Run")
    tab.wait("document.querySelector('.steps li')")
    # The same job is there in a page that is loaded again.
    tab.go(f"{bench.origin}/solve?path=studies/two-links-2.toml", LAPTOP)
    tab.wait("document.querySelector('.steps li')")
    pressed(tab, "Open the result")
    tab.wait("document.querySelector('main')?.dataset.drawn !== undefined")
    assert tab.ask("document.querySelectorAll('main section.part').length") > 6
    drawn = "[...document.querySelectorAll('.chart')].filter((c) => c.clientWidth).every((c) => 'drawn' in c.dataset)"
    assert tab.ask(drawn)
    stored = json.loads((bench.folder / "results" / "two-links-2" / "result.json").read_text())
    assert {p["name"] for p in stored["estimate"]["parameters"]} <= set(
        tab.ask("[...document.querySelectorAll('#parameter-table tbody tr')].map((r) => r.cells[0].dataset.value)")
    )
    assert tab.ask("document.querySelector('#command pre').textContent") == "haptid report results/two-links-2"
    for path in ("/results?path=results/two-links-2", "/use?path=results/two-links-2&to=json"):
        tab.go(bench.origin + path, NARROW)
        assert tab.ask("document.documentElement.scrollWidth") <= NARROW
        assert tab.accessibility() == []
    shown = tab.ask("document.querySelector('main pre.code').textContent")
    pressed(tab, "Write these files")
    written = bench.folder / "exports" / "two-links-2" / "json" / "two_links.json"
    tab.wait("document.querySelector('main').textContent.includes('Written into exports/two-links-2')")
    assert json.loads(written.read_text()) == json.loads(shown)


def test_the_result_in_the_workbench_is_the_one_of_the_report(bench, tab):
    """Same numbers, same curves: the charts of the page and of report.html have the same paths."""
    study, out = bench.folder / "studies/two-links.toml", bench.folder / "results/reported"
    out.parent.mkdir(exist_ok=True)
    done = CliRunner().invoke(app, ["identify", str(study), "--out", str(out)])
    assert (out / "report.html").is_file(), done.output
    curves = "[...document.querySelectorAll('#torque path')].map((p) => p.getAttribute('d'))"
    numbers = "document.getElementById('parameters').querySelector('tbody').innerText"
    found = []
    for address in (
        f"{bench.origin}/results?path=results/reported",
        (bench.folder / "results/reported/report.html").as_uri(),
    ):
        tab.go(address, LAPTOP)
        tab.wait("document.querySelectorAll('#torque path').length")
        tab.ask("document.querySelector('main').style.cssText = 'width: 1000px; max-width: none; padding: 0'")
        tab.size(LAPTOP + 1, 900)
        tab.ask("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
        drawn = tab.ask(curves)
        # The mechanism follows the cursor of the torque.
        tab.ask("document.querySelector('#torque-0-0').focus()")
        tab.press("ArrowRight")
        pose = tab.ask("[...document.querySelectorAll('input[data-joint]')].map((s) => s.valueAsNumber)")
        found.append((len(drawn), hashlib.sha256("".join(drawn).encode()).hexdigest(), tab.ask(numbers), pose))
    tab.asked[:] = [one for one in tab.asked if not one.startswith("file:")]
    assert found[0] == found[1]


def test_stages_are_reached_by_keyboard_alone(bench, tab):
    tab.go(f"{bench.origin}/", LAPTOP)
    seen = []
    for _ in range(13):
        tab.press("Tab")
        seen.append(tab.ask("document.activeElement.textContent.trim()"))
    assert seen[:2] == ["Skip to the page", "haptid"]
    stages = ["Home", "Device", "Experiment", "Data", "Solve", "Results", "Use", "Live", "Registry"]
    assert [re.sub(r"^\d\s*", "", one) for one in seen[2:11]] == stages
    outline = tab.ask("getComputedStyle(document.activeElement).outlineStyle")
    assert outline != "none"
    # Back to Solve, and there: Enter follows, and the focus is seen on the page that comes.
    for _ in range(13 - 2 - stages.index("Solve") - 1):
        tab.press("Tab", shift=True)
    tab.press("Enter")
    tab.wait("location.pathname === '/solve' && document.body?.dataset.ready !== undefined")


def test_the_trial_goes_from_nothing_to_a_verdict(bench, tab, tmp_path):
    """One button: logs of the virtual bench, their identification, its verdict; and the pages on the way."""
    pytest.importorskip("mujoco")
    tab.go(f"{bench.origin}/", LAPTOP)
    tab.ask("localStorage.setItem('haptid-theme', 'light')")
    tab.go(f"{bench.origin}/", LAPTOP)
    tab.ask("document.querySelector('button.main').click()")
    tab.wait("location.pathname === '/solve' && document.querySelectorAll('.steps li').length > 2")
    pictured(tab, "job", tmp_path)
    tab.wait("location.pathname === '/results' && document.querySelector('main')?.dataset.drawn !== undefined")
    assert tab.ask("document.querySelector('h1').textContent") == "PHANToM on the virtual bench"
    stored = json.loads((bench.folder / "results/bench-phantom/result.json").read_text())
    assert stored["criteria"]["met"] is True
    # What was simulated is found again.
    truth = {name: [0.026, 0.0092, 0.0091][k] for k, name in enumerate(("FC1", "FC2", "FC3"))}
    found = {p["name"]: p for p in stored["estimate"]["parameters"]}
    for name, value in truth.items():
        assert found[name]["value"] == pytest.approx(value, rel=0.05)
    pictured(tab, "results", tmp_path)
    for name, path in {
        "home": "/",
        "device": "/device?path=phantom_premium_15",
        "data": "/data?path=logs/bench-sweep.parquet",
        "solve": "/solve?path=studies/bench-phantom.toml",
        "use": "/use?path=results/bench-phantom&to=c",
    }.items():
        tab.go(bench.origin + path, LAPTOP, 1350 if name == "data" else 900)
        tab.wait("[...document.querySelectorAll('.chart')].every((c) => 'drawn' in c.dataset)")
        pictured(tab, name, tmp_path)
    assert tab.ask("document.querySelectorAll('main pre.code').length") >= 3
    assert "haptid export results/bench-phantom --to c" in tab.ask("document.querySelector('#command pre').textContent")
