"""The live page: samples by UDP and WebSocket to a file, drawn, identified; and attacks on its calls."""

from __future__ import annotations

import json
import os
import socket
import threading
import time

import numpy as np
import pytest

pytest.importorskip("starlette")

from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from browser import LAPTOP, needs_browser
from haptid.live import pack_frame
from small_study import columns
from workbenches import pictured

STUDY, RATE = "studies/two-links.toml", 500.0
BEGIN = {"study": STUDY, "name": "live", "rate": "500", "port": "0"}
PATIENCE = 60.0


def until(condition, what):
    """The value of a condition as soon as it is true."""
    end = time.monotonic() + PATIENCE
    while not (found := condition()):
        assert time.monotonic() < end, f"never: {what}"
        time.sleep(0.02)
    return found


def state(bench):
    return bench.ask("GET", "/api/live/state")[1]


@pytest.fixture
def stopped(bench):
    """No recording runs after the test."""
    yield bench
    bench.ask("POST", "/api/live/stop")


def motion(seconds=20.0):
    """Positions and torques of the two links, each (n, 2)."""
    made = columns(7, seconds)
    return tuple(np.column_stack([made[f"{name}{k}"] for k in (1, 2)]) for name in ("q", "tau"))


def test_samples_are_recorded_and_the_file_is_a_log(stopped):
    bench = stopped
    q, tau = motion(6.0)
    status, begun = bench.ask("POST", "/api/live/start", BEGIN)
    assert status == 200, begun
    second, said = bench.ask("POST", "/api/live/start", BEGIN)
    assert (second, "runs already" in said["error"]) == (400, True)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
        for k in range(0, len(q), 20):
            if k != 600:  # a frame that is never sent
                out.sendto(pack_frame(k, q[k : k + 20], tau[k : k + 20]), ("127.0.0.1", begun["port"]))
            time.sleep(1e-4)
        out.sendto(b"nonsense", ("127.0.0.1", begun["port"]))
    until(lambda: state(bench)["broken"] == 1, "the last message")
    counts = state(bench)["counts"]
    assert (counts["written"], counts["lost"]) == (len(q) - 20, 20)
    content = bench.raw("GET", "/api/live/samples?since=0", cookie=bench.cookie).content
    head = json.loads(content[4 : 4 + int.from_bytes(content[:4], "little")])
    assert head["next"] == len(q) - 20
    status, ended = bench.ask("POST", "/api/live/stop")
    assert (status, ended["path"]) == (200, "logs/live.csv")
    made = np.loadtxt(bench.folder / "logs" / "live.csv", delimiter=",", skiprows=1)
    kept = np.delete(np.arange(len(q)), np.arange(600, 620))
    np.testing.assert_array_equal(made[:, 1:], np.hstack([q, tau])[kept])
    np.testing.assert_allclose(made[:, 0], kept / RATE, atol=1e-9)
    assert bench.ask("GET", "/api/log?path=logs/live.csv")[0] == 200
    (bench.folder / "logs" / "live.csv").unlink()


def test_frames_come_by_websocket_too(stopped):
    bench = stopped
    bench.ask("POST", "/api/live/start", BEGIN)
    q, tau = motion(1.0)
    address = f"ws://127.0.0.1:{bench.port}/api/live/frames"
    with connect(address, origin=bench.origin, additional_headers={"Cookie": bench.cookie}, proxy=None) as out:
        for k in range(0, len(q), 50):
            out.send(pack_frame(k, q[k : k + 50], tau[k : k + 50]))
        until(lambda: state(bench)["counts"]["written"] == len(q), "all samples")
    bench.ask("POST", "/api/live/stop")
    (bench.folder / "logs" / "live.csv").unlink()


@pytest.mark.parametrize("given", [{}, {"origin": "http://evil.example"}, {"cookie": ""}, {"host": "evil.example"}])
def test_a_foreign_socket_is_refused(bench, given):
    headers = {"Cookie": given.get("cookie", bench.cookie)}
    origin = given.get("origin") or (bench.origin if given else None)
    if "host" in given:
        headers["Host"] = given["host"]
    address = f"ws://127.0.0.1:{bench.port}/api/live/frames"
    with pytest.raises(InvalidStatus):
        connect(address, origin=origin, additional_headers=headers, proxy=None).close()


@pytest.mark.parametrize(
    "wrong",
    [
        {"study": "../two-links.toml"},
        {"study": "studies/none.toml"},
        {"study": "logs/sweep.csv"},
        {"name": "../evil"},
        {"name": ".hidden"},
        {"name": "con"},
        {"name": ""},
        {"rate": "nan"},
        {"rate": "0"},
        {"rate": "1e9"},
        {"port": "-1"},
        {"port": "65536"},
        {"forgetting": "-3"},
        {"play": "../../etc/passwd"},
        {"play": "logs/none.csv"},
    ],
)
def test_a_wrong_beginning_leaves_nothing(bench, wrong):
    before = sorted(os.listdir(bench.folder / "logs"))
    status, said = bench.ask("POST", "/api/live/start", BEGIN | wrong)
    assert status == 400, said
    assert said["error"]
    assert state(bench) == {"running": False}
    assert sorted(os.listdir(bench.folder / "logs")) == before
    for call in ("stop", "hold"):
        assert bench.ask("POST", f"/api/live/{call}", {"held": "true"})[0] == 400
    assert bench.ask("GET", "/api/live/state?since=0") == (200, {"running": False})
    assert bench.raw("GET", "/api/live/samples?since=0", cookie=bench.cookie).status == 204
    assert bench.raw("GET", "/api/live/samples?since=-1", cookie=bench.cookie).status == 404


@needs_browser
def test_a_device_is_identified_while_it_moves(stopped, tab, tmp_path):
    """A log played as a controller would: curves roll, the score falls, parameters have intervals, a push is said."""
    bench = stopped
    tab.go(f"{bench.origin}/live?play=logs/sweep.csv&rate=500", LAPTOP)
    tab.ask("document.querySelector('form').requestSubmit()")
    tab.wait("document.querySelectorAll('#live-parameters tbody tr').length === 10")
    tab.wait("document.getElementById('prompt').textContent.length > 10")
    tab.wait("Number(document.querySelector('meter').value) < 0.1")
    tab.wait("!document.getElementById('live-parameters').textContent.includes('unknown')")
    tab.wait("Number(document.querySelector('main').dataset.frames) > 20")
    drawn = """[...document.querySelectorAll('.plot canvas')].slice(0, 3).map((c) => {
        const d = c.getContext('2d').getImageData(0, 0, c.width, c.height).data;
        let n = 0; for (let i = 3; i < d.length; i += 4) n += d[i] > 0; return n; })"""
    assert min(tab.ask(drawn)) > 1000
    assert tab.accessibility() == []
    pictured(tab, "live", tmp_path)
    # Who wants less motion has two pictures a second, not thirty.
    tab.call("Emulation.setEmulatedMedia", features=[{"name": "prefers-reduced-motion", "value": "reduce"}])
    tab.go(f"{bench.origin}/live", LAPTOP)
    between = """new Promise((done) => { const times = []; new MutationObserver(() => {
        times.push(performance.now()); if (times.length === 3) done(times[2] - times[1]); })
        .observe(document.querySelector('main'), { attributeFilter: ['data-frames'] }); })"""
    assert tab.ask(between) > 400
    tab.call("Emulation.setEmulatedMedia", features=[])
    tab.ask("[...document.querySelectorAll('button')].find((b) => b.textContent === 'End the recording').click()")
    tab.wait("location.pathname === '/data' && document.querySelector('#plots')?.dataset.drawn")
    made = np.loadtxt(bench.folder / "logs" / "live.csv", delimiter=",", skiprows=1)
    first = np.loadtxt(bench.folder / "logs" / "sweep.csv", delimiter=",", skiprows=1)
    np.testing.assert_array_equal(made[:, 1:], np.resize(first[:, 1:], made[:, 1:].shape))
    # Between two rounds the file has a pause, and is read as parts of their own.
    pauses = np.flatnonzero(np.diff(made[:, 0]) > 0.5)
    np.testing.assert_array_equal(pauses, len(first) * np.arange(1, len(pauses) + 1) - 1)
    tab.go(f"{bench.origin}/", LAPTOP)  # the page may still ask for parts of the log
    (bench.folder / "logs" / "live.csv").unlink()


@needs_browser
def test_a_recording_may_end_at_any_time(stopped, tab):
    """While the page that ends it has asked for samples, and while another one looks on: nobody meets an error."""
    bench = stopped
    bench.ask("POST", "/api/live/start", BEGIN | {"play": "logs/sweep.csv"})
    with tab.another() as other:
        for page in (tab, other):
            page.go(f"{bench.origin}/live", LAPTOP)
            page.wait("document.querySelectorAll('#live-parameters tbody tr').length === 10")
        tab.call("Page.bringToFront")
        # A question of this page is held back until the recording has ended.
        tab.ask(
            """(() => { const real = window.fetch; let over; const ended = new Promise((done) => { over = done; });
            window.fetch = async (address, settings) => {
                if (!String(address).includes('live/stop')) {
                    document.body.dataset.held = '1';
                    await ended;
                    return real(address, settings);
                }
                const answer = await real(address, settings);
                over();
                await new Promise((done) => setTimeout(done, 300));
                return answer;
            }; })()"""
        )
        tab.wait("document.body.dataset.held === '1'")
        tab.ask("[...document.querySelectorAll('button')].find((b) => b.textContent === 'End the recording').click()")
        tab.wait("location.pathname === '/data' && document.querySelector('#plots')?.dataset.drawn")
        other.call("Page.bringToFront")
        other.wait("document.querySelector('form button')?.textContent === 'Begin'")
        assert other.troubles == []
    tab.go(f"{bench.origin}/", LAPTOP)
    (bench.folder / "logs" / "live.csv").unlink()


def paced(q, tau, rate, out, left_out):
    """Send samples in real time, one in a frame, but for those that are left out."""
    begun, tick = time.monotonic(), threading.Event()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as port:
        for k in range(len(q)):
            if k not in left_out:
                port.sendto(pack_frame(k, q[k : k + 1], tau[k : k + 1]), out)
            if k % 4 == 3:
                tick.wait(max(0.0, begun + (k + 1) / rate - time.monotonic()))


@needs_browser
def test_a_thousand_samples_a_second_of_fourteen_channels_are_all_there(stopped, tab):
    """Ten seconds in real time while a page draws and another is frozen: nothing is lost, gaps are counted exactly."""
    bench = stopped
    names = [f"{kind}{k}" for kind in ("q", "tau") for k in range(1, 8)]
    (bench.folder / "studies" / "seven.toml").write_text(
        'schema = 1\nname = "seven"\ndevice = "arm7"\n[channels]\ntime = "t"\n'
        f'position = {{ channels = {json.dumps(names[:7])}, unit = "rad" }}\n'
        f'torque = {{ channels = {json.dumps(names[7:])}, unit = "N m" }}\n[[logs]]\npath = "../logs/sweep.csv"\n'
    )
    begun = bench.ask("POST", "/api/live/start", BEGIN | {"study": "studies/seven.toml", "rate": "1000"})[1]
    rng = np.random.default_rng(1)
    t = 1e-3 * np.arange(10_000)
    q = np.sin(np.outer(t, rng.uniform(1, 4, 7)))
    tau = rng.standard_normal((len(t), 7))
    left_out = {*range(3000, 3017), *range(500, 9000, 977)}
    frames = "Number(document.querySelector('main').dataset.frames)"
    tab.go(f"{bench.origin}/live", LAPTOP)
    with tab.another() as frozen:
        frozen.go(f"{bench.origin}/live", LAPTOP)
        frozen.call("Page.setWebLifecycleState", state="frozen")
        tab.call("Page.bringToFront")
        drawn = tab.ask(frames)
        paced(q, tau, 1000.0, ("127.0.0.1", begun["port"]), left_out)
        until(lambda: state(bench)["counts"]["written"] == len(t) - len(left_out), "all samples")
        assert tab.ask(frames) - drawn > 20
        frozen.call("Page.setWebLifecycleState", state="active")
        frozen.call("Page.bringToFront")
        frozen.wait(f"document.body.textContent.includes('{len(t) - len(left_out)} samples written')")
    assert state(bench)["counts"]["lost"] == len(left_out)
    tab.go(f"{bench.origin}/registry", LAPTOP)
    bench.ask("POST", "/api/live/stop")
    made = np.loadtxt(bench.folder / "logs" / "live.csv", delimiter=",", skiprows=1)
    kept = np.delete(np.arange(len(t)), sorted(left_out))
    np.testing.assert_array_equal(made[:, 1:], np.hstack([q, tau])[kept])
    (bench.folder / "logs" / "live.csv").unlink()
    (bench.folder / "studies" / "seven.toml").unlink()
