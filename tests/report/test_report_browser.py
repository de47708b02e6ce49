"""The page in a real browser: drawn without complaint, sorted, zoomed, moved. Its pictures stay in the run's folder."""

import re

import numpy as np
import pytest

import haptid
from browser import LAPTOP, PHONE, needs_browser
from closed_devices import CAM, RELATIONS
from haptid.dynamics import link_poses
from haptid.report.page import module_of_scripts
from haptid.report.page import page as written
from haptid.report.sections.mechanism import MechanismSection
from reported import found, made, source
from true_parameters import true_parameters

pytestmark = needs_browser
MASS = re.compile(r"([\d.e−]+) kg along")


@pytest.fixture(scope="module")
def report(tab, folder):
    made().write(folder)
    tab.open(folder / "report.html", LAPTOP)
    return tab


@pytest.mark.parametrize(("width", "theme"), [(LAPTOP, "light"), (PHONE, "dark")])
def test_the_page_is_drawn_without_complaint(tab, folder, width, theme):
    made().write(folder)
    tab.open(folder / "report.html", width)
    tab.ask(f"document.documentElement.dataset.theme = '{theme}'")
    assert tab.accessibility() == []
    assert tab.troubles == []
    keys = tab.ask("[...document.querySelectorAll('main > section')].map((s) => s.id)")
    assert keys == list(made().sections)
    assert tab.picture(folder / f"page-{width}.png", "body").stat().st_size > 100_000
    assert tab.ask("document.documentElement.scrollWidth") <= width  # nothing hangs out at the side


def test_every_chart_is_drawn(report):
    unfolded = "[...document.querySelectorAll('.chart')].filter((c) => c.clientWidth)"
    assert report.ask(f"{unfolded}.length") > 30
    assert report.ask(f"{unfolded}.every((c) => 'drawn' in c.dataset)")
    assert report.ask(f"{unfolded}.every((c) => c.querySelector('svg *, canvas'))")
    lines = "[...document.querySelectorAll('#torque path')].map((p) => p.getAttribute('d').length)"
    assert min(report.ask(lines)) > 1000
    image = "[...document.querySelectorAll('image.pixels')].every((i) => i.getAttribute('href').length > 100)"
    assert report.ask(image)


def test_folded_parts_are_drawn_when_they_are_opened(report):
    report.ask("document.querySelectorAll('#residual details').forEach((d) => { d.open = false; })")
    report.ask("document.querySelectorAll('#residual .chart svg').forEach((s) => s.remove())")
    report.ask("document.querySelectorAll('#residual details').forEach((d) => { d.open = true; })")
    report.wait("[...document.querySelectorAll('#residual .chart')].every((c) => c.querySelector('svg path'))")


def column(tab, k):
    cells = f"[...document.querySelectorAll('#parameter-table tbody tr')].map((r) => r.cells[{k}].dataset.value)"
    return tab.ask(cells)


def test_tables_sort_when_a_heading_is_pressed(report):
    press = "document.querySelectorAll('#parameter-table th button')[{}].click()"
    report.ask(press.format(1))
    up = [float(v) for v in column(report, 1)]
    assert up == sorted(up)
    assert report.ask("document.querySelectorAll('#parameter-table th')[1].getAttribute('aria-sort')") == "ascending"
    report.ask(press.format(1))
    assert [float(v) for v in column(report, 1)] == up[::-1]
    report.ask(press.format(0))
    names = column(report, 0)
    assert names.index("FV2") < names.index("FV3") < names.index("ZZbaR")


def test_tables_are_downloaded(report):
    # What a click would save, caught where the page makes it.
    report.ask("""
        window.saved = [];
        const whole = URL.createObjectURL;
        URL.createObjectURL = (blob) => { blob.text().then((text) => window.saved.push(text)); return whole(blob); };
        HTMLAnchorElement.prototype.click = function () {};
        document.querySelectorAll('#parameters .wide + .actions')[0].querySelectorAll('[data-download]')
            .forEach((b) => b.click());
    """)
    report.wait("window.saved.length === 3")
    csv, listed, tex = sorted(
        report.ask("window.saved"), key=lambda text: "[{\\".index(text[0]) if text[0] in "[{\\" else -1
    )
    assert csv.splitlines()[0].startswith("name,value,low,high,se")
    assert len(csv.splitlines()) == 1 + len(found().estimate.parameters)
    value = next(line for line in csv.splitlines() if line.startswith("FC1,")).split(",")[1]
    assert float(value) == pytest.approx(found().estimate["FC1"].value)
    assert '"grouping"' in listed
    assert r"\begin{tabular}" in tex


def first_tick(tab, chart):
    return tab.ask(f"document.querySelector('#{chart} .axes text').textContent")


def test_zooming_one_plot_moves_all_of_its_log(report):
    before = {key: first_tick(report, key) for key in ("torque-0-0", "residual-0-2", "torque-1-0")}
    report.drag("#torque-0-0 svg", (0.5, 0.5), (0.6, 0.5))
    after = {key: first_tick(report, key) for key in before}
    assert after["torque-0-0"] != before["torque-0-0"]
    assert after["torque-0-0"] == after["residual-0-2"]
    assert after["torque-1-0"] == before["torque-1-0"]
    report.ask("document.querySelectorAll('#torque-0-0 .controls button')[2].click()")
    assert first_tick(report, "residual-0-2") == before["residual-0-2"]
    assert report.troubles == []


def set_joint(tab, joint, value):
    tab.ask(
        f"(() => {{ const s = document.querySelector('input[data-joint=\"{joint}\"]'); s.value = {value};"
        "s.dispatchEvent(new Event('input', {bubbles: true})); })()"
    )


def scene_of(tab):
    picture = tab.ask("document.querySelector('canvas.scene').toDataURL()")
    words = tab.ask("document.querySelector('#scene .readout').textContent")
    masses = [float(m.replace("−", "-")) for m in MASS.findall(words)]
    pose = tab.ask("[...document.querySelectorAll('input[data-joint]')].map((s) => s.valueAsNumber)")
    return picture, masses, np.array(pose)


def agrees(identified, masses, pose):
    """The page's masses, three digits, are the library's at that pose."""
    expected = haptid.end_effector.apparent_mass(identified, pose[:, None]).mass.values[0]
    np.testing.assert_allclose(masses, expected, rtol=6e-3)


def test_the_device_moves_with_its_sliders_and_has_the_masses_the_library_states(report):
    before, masses, pose = scene_of(report)
    agrees(found().estimate, masses, pose)
    set_joint(report, 1, pose[1] + 0.3)
    set_joint(report, 2, pose[2] - 0.2)
    after, moved, there = scene_of(report)
    assert before != after
    np.testing.assert_allclose(there - pose, [0, 0.3, -0.2], atol=1e-6)
    agrees(found().estimate, moved, there)


def test_the_device_follows_the_cursor_of_the_torque(report):
    """At the cursor's time the drawing has the pose of the log, and its links are where the library's kinematics is."""
    before = scene_of(report)[0]
    report.ask("document.addEventListener('cursor', (event) => { window.at = event.detail.x; })")
    report.ask("document.querySelector('#torque-0-1').focus()")
    for _ in range(3):
        report.press("ArrowRight")
    picture, masses, pose = scene_of(report)
    assert picture != before
    track, model = source().tracks[0], found().estimate.model
    qa, t = np.linalg.inv(model.device.row_map) @ track.position, track.t0 + track.step * np.arange(track.rows)
    there = [np.interp(report.ask("window.at"), t, q) for q in qa]
    # The page has some hundred poses of the log, and takes the line between two.
    np.testing.assert_allclose(pose, there, atol=0.01 * np.ptp(qa))
    np.testing.assert_allclose(script_poses(report, pose), link_poses(model, pose[:, None])[0], atol=1e-9)
    agrees(found().estimate, masses, pose)


def test_the_device_turns_when_it_is_dragged(report):
    before = scene_of(report)[0]
    report.drag("canvas.scene", (0.3, 0.5), (0.6, 0.4))
    assert scene_of(report)[0] != before
    assert report.troubles == []


def script_poses(tab, qa):
    """Poses of all links by the page's own script, (joints, 4, 4)."""
    script = module_of_scripts().rpartition("export")[0]
    drawing = "JSON.parse(document.getElementById('drawings').textContent).scene"
    act = f"const m = new Mechanism({drawing}); m.move({qa.tolist()}); return m.links();"
    links = tab.ask(f"(() => {{ {script} {act} }})()")
    made = np.tile(np.eye(4), (len(links), 1, 1))
    made[:, :3, :3] = [np.reshape(link["R"], (3, 3)) for link in links]
    made[:, :3, 3] = [link["p"] for link in links]
    return made


@pytest.mark.parametrize("name", ["five_bar", "delta", "arm7", "cam", "cea_medical_branch"])
def test_any_device_is_drawn_and_closes_its_loops(tab, folder, name):
    relations = RELATIONS.format("q4 = q2 - q3 + 0.2*q1*q3")
    (folder / "cam.toml").write_text(CAM + relations)
    model = haptid.DynamicModel(haptid.read_device(folder / "cam.toml" if name == "cam" else name))
    rng = np.random.default_rng(0)
    start = getattr(
        model.device.closure, "at", np.array([0.3, 0.1, 0.8, 0.3, 0.2, 0.5, 0.3])[: len(model.device.active)]
    )
    qa = start[:, None] + 0.05 * np.sin(rng.uniform(0, 6, (len(start), 50)))
    section = MechanismSection.drawn(model, model.base.of(true_parameters(model)), qa)
    path = folder / f"{name}.html"
    path.write_text(written(name, "", (section,)), encoding="utf-8")
    tab.open(path, LAPTOP)
    assert tab.troubles == []
    _, masses, pose = scene_of(tab)
    np.testing.assert_allclose(
        script_poses(tab, start + 0.02), link_poses(model, (start + 0.02)[:, None])[0], atol=1e-9
    )
    tab.picture(folder / f"{name}.png", "#mechanism")
    identified = haptid.end_effector.GivenParameters(model, model.base.of(true_parameters(model)))
    if masses:
        agrees(identified, masses, pose)
    set_joint(tab, 0, pose[0] + 0.1)
    before, masses, pose = scene_of(tab)
    assert before
    if masses:
        agrees(identified, masses, pose)
    assert masses or model.device.handle is None
