"""The workbench beside NiceGUI on its two hard tasks: curves of a long log, and a stream of 1 kHz on one open page.

One browser for both, with the same questions: canvases are painted when they have ink, a step of zooming is the time
that the main thread of the page is busy with it. NiceGUI is in the environment of peers; its application is
`peers/nicegui_app.py`. Wall times, but for shares of a core: processes of other work disturb them.
"""

from __future__ import annotations

import json
import os
import socket
import subprocess
import tempfile
import threading
import time
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from browser import LAPTOP, Page, page
from compare_peers import PYTHON, left_out
from haptid.live import play
from live import RATE, arm_samples, begun
from workbench import CHANNELS, SAMPLES, STARTS, ZOOMS, Served, written_log

LIVE_S, PATIENCE = 30.0, 60.0
LOG = f"{CHANNELS} channels of {SAMPLES} samples"
STREAM = f"{CHANNELS} channels at {RATE:g} Hz for {LIVE_S:g} s, one page open"
# The time at which two canvases are painted, in window.painted.
PAINTED = """
(() => {
  const inked = (canvas) => {
    const d = canvas.width ? canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data : [];
    let n = 0;
    for (let i = 3; i < d.length; i += 4) n += d[i] > 0;
    return n > 5000;
  };
  const look = () => {
    const all = [...document.querySelectorAll("canvas")];
    if (all.length >= 2 && all.every(inked)) window.painted = performance.now();
    else setTimeout(look, 50);
  };
  look();
})()"""
FRAMES = """new Promise((done) => { const times = []; let before = 0; const end = performance.now() + 10000;
  const frame = (at) => { if (before) times.push(at - before); before = at;
    if (at < end) requestAnimationFrame(frame);
    else done(times.sort((a, b) => a - b)[Math.floor(0.95 * times.length)]); };
  requestAnimationFrame(frame); })"""


class Nice:
    """The application of NiceGUI in a process of its own, answered once."""

    def __init__(self, log: Path) -> None:
        self.port, self.udp = free_port(), free_port()
        program = Path(__file__).parent / "peers" / "nicegui_app.py"
        began = time.perf_counter()
        command = [str(PYTHON), str(program), str(self.port), str(self.udp), str(log)]
        self.process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        while not self.answers():
            assert self.process.poll() is None, "NiceGUI ended"
            time.sleep(0.01)
        self.seconds = time.perf_counter() - began

    def answers(self) -> bool:
        try:
            self.asked("/")
        except OSError:
            return False
        return True

    def asked(self, path: str) -> bytes:
        with urllib.request.urlopen(f"http://127.0.0.1:{self.port}{path}", timeout=PATIENCE) as answer:
            return bytes(answer.read())

    memory, end = Served.memory, Served.end


def run() -> dict[str, float]:
    """Seconds, milliseconds, MiB, per cent of a core, samples; nothing without NiceGUI."""
    if subprocess.run([PYTHON, "-c", "import nicegui"], capture_output=True, check=False).returncode:
        left_out("NiceGUI", "it is not in the environment of peers: see `make bench`")
        return {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        return {**ours(folder / "ours"), **theirs(folder / "theirs")}


def ours(folder: Path) -> dict[str, float]:
    """Of haptid app."""
    written_log(folder / "logs" / "long.csv")
    with last_of(lambda: Served(folder)) as (server, figures), tab_of(folder) as tab:
        address = f"http://127.0.0.1:{server.port}"
        tab.go(server.address, LAPTOP)
        figures[f"{LOG}: painted, s"] = painted(tab, f"{address}/data?path=logs/long.csv")
        tab.ask("window.plot = document.querySelector('.plot'); 0")
        key = "{ key: k % 10 ? '+' : '0' }"
        figures[f"{LOG}: a step of zooming, ms"] = zoomed(
            tab, f"plot.dispatchEvent(new KeyboardEvent('keydown', {key}))"
        )
        state = begun(server, folder)
        tab.go(f"{address}/live", LAPTOP)
        figures |= streamed(tab, server.process.pid, state["port"])
        written = json.loads(server.asked("/api/live/state").content)["counts"]["written"]
        server.asked("/api/live/stop", {"end": True})
    return {f"haptid: {what}": figure for what, figure in {**figures, f"{STREAM}: received, samples": written}.items()}


def theirs(folder: Path) -> dict[str, float]:
    """Of NiceGUI: all samples in the page, and thinned in Python to what a screen shows."""
    path = folder / "logs" / "long.csv"
    written_log(path)
    np.save(folder / "log.npy", np.loadtxt(path, delimiter=",", skiprows=1))
    with last_of(lambda: Nice(folder / "log.npy")) as (server, figures):
        address = f"http://127.0.0.1:{server.port}"
        with tab_of(folder / "thinned") as tab:
            figures |= of_thinned(tab, server, address)
        with tab_of(folder / "raw") as tab:
            figures[f"{LOG}: painted, s"] = painted(tab, f"{address}/log")
    return {f"NiceGUI: {what}": figure for what, figure in figures.items()}


def of_thinned(tab: Page, server: Nice, address: str) -> dict[str, float]:
    """Curves of as many points as a screen shows, and the stream."""
    thinned = painted(tab, f"{address}/log?points=2200")
    charts = "[...document.querySelectorAll('[_echarts_instance_]')].map((d) => getElement(d.id.slice(1)).chart)"
    assert tab.ask(f"(window.plots = {charts}).length") == 2
    half = "50 / 2 ** (k % 10)"
    to = f"{{ type: 'dataZoom', startValue: 50 - {half}, endValue: 50 + {half} }}"
    step = zoomed(tab, f"plots.forEach((c) => c.dispatchAction({to}))")
    tab.call("Page.navigate", url=f"{address}/live")
    tab.wait("document.querySelectorAll('canvas').length >= 2")
    before = json.loads(server.asked("/counts"))["samples"]
    stream = streamed(tab, server.process.pid, server.udp)
    received = json.loads(server.asked("/counts"))["samples"] - before
    return {
        f"{LOG}: painted, thinned, s": thinned,
        f"{LOG}: a step of zooming, thinned, ms": step,
        **stream,
        f"{STREAM}: received, samples": received,
    }


@contextmanager
def last_of(start: Any) -> Iterator[tuple[Any, dict[str, float]]]:
    """The last of several starts, and the figures of the fastest."""
    seconds = []
    for k in range(STARTS):
        server = start()
        seconds.append(server.seconds)
        if k < STARTS - 1:
            server.end()
    try:
        yield server, {"start to the first page, s": min(seconds), "memory at the start, MiB": server.memory}
    finally:
        server.end()


@contextmanager
def tab_of(folder: Path) -> Iterator[Page]:
    with page(folder) as tab:
        tab.busy_in_threads()
        tab.call("Page.addScriptToEvaluateOnNewDocument", source=PAINTED)
        yield tab


def painted(tab: Page, address: str) -> float:
    """Seconds from the request of a page until its canvases have ink, of a second load; NaN where it takes a minute."""
    for _ in range(2):
        try:
            tab.call("Page.navigate", url="about:blank")
            tab.wait("location.href === 'about:blank'")
            tab.call("Page.navigate", url=address)
            tab.wait("window.painted")
        except (AssertionError, TimeoutError):
            return float("nan")
    return float(tab.ask("painted")) / 1e3


def zoomed(tab: Page, step: str) -> float:
    """Milliseconds for which the page's main thread is busy with one step, drawing included."""
    before = tab.busy()
    tab.ask(f"""(async () => {{
      const drawn = () => new Promise((done) => requestAnimationFrame(() => setTimeout(done)));
      for (let k = 0; k < {ZOOMS}; k++) {{ {step}; await drawn(); }}
    }})()""")
    return 1e3 * (tab.busy() - before) / ZOOMS


def streamed(tab: Page, pid: int, port: int) -> dict[str, float]:
    """Samples in real time to a port while the page draws: what it takes of the server, and how even the frames are."""
    _, q, tau = arm_samples(60.0)
    end = time.monotonic() + LIVE_S
    sent: list[int] = []

    def send() -> None:
        sent.append(play(q, tau, RATE, ("127.0.0.1", port), stop=lambda: time.monotonic() > end))

    sender, before = threading.Thread(target=send), used(pid)
    sender.start()
    frame = tab.ask(FRAMES)
    sender.join()
    share = (used(pid) - before) / LIVE_S
    time.sleep(1.0)
    return {
        f"{STREAM}: sent, samples": sent[0],
        f"{STREAM}: of one core, %": 100 * share,
        f"{STREAM}: frame, 95 %, ms": frame,
    }


def used(pid: int) -> float:
    """Processor time of a process and its children that live, s; NaN where the system does not say."""
    if not Path("/proc").exists():
        return float("nan")
    children = [int(k) for task in Path(f"/proc/{pid}/task").glob("*/children") for k in task.read_text().split()]
    times = [Path(f"/proc/{one}/stat").read_text().rpartition(")")[2].split() for one in (pid, *children)]
    return sum(int(one[11]) + int(one[12]) for one in times) / os.sysconf("SC_CLK_TCK")


def free_port() -> int:
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return int(one.getsockname()[1])
