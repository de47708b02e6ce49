"""The workbench: how fast it starts and what memory it takes, curves of a long log, and the index of many results.

Wall times; the browser's where one is installed. Processes of other work disturb them.
"""

from __future__ import annotations

import http.client
import json
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np

from haptid.registry import Index

STARTS, RESULTS, SAMPLES, CHANNELS, ZOOMS = 5, 10_000, 100_000, 14, 60
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))


class Served:
    """A workbench on a folder, answered once."""

    def __init__(self, folder: Path) -> None:
        began = time.perf_counter()
        command = [sys.executable, "-m", "haptid", "app", str(folder), "--no-browser"]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        assert self.process.stdout is not None
        found = re.search(r"http://\S+", self.process.stdout.readline())
        assert found is not None
        self.address, self.port = found[0], urlsplit(found[0]).port
        self.printed = time.perf_counter() - began
        self.cookie = ""
        self.cookie = (
            self.asked(self.address.partition(str(self.port))[2]).getheader("set-cookie", "").partition(";")[0]
        )
        self.asked("/")
        self.seconds = time.perf_counter() - began

    def asked(self, path: str, body: object = None) -> http.client.HTTPResponse:
        """The answer to a page, read."""
        connection = http.client.HTTPConnection("127.0.0.1", self.port)
        headers = {"cookie": self.cookie, "origin": f"http://127.0.0.1:{self.port}"}
        connection.request("POST" if body else "GET", path, json.dumps(body) if body else None, headers)
        answer = connection.getresponse()
        answer.content = answer.read()  # type: ignore[attr-defined]
        connection.close()
        return answer

    @property
    def memory(self) -> float:
        """Resident, MiB; NaN where the system does not say."""
        status = Path(f"/proc/{self.process.pid}/status")
        found = re.search(r"VmRSS:\s+(\d+) kB", status.read_text()) if status.exists() else None
        return float(found[1]) / 1024 if found else float("nan")

    def end(self) -> None:
        """Terminate it."""
        self.process.terminate()
        self.process.communicate()


def run() -> dict[str, float]:
    """Seconds, MiB."""
    with tempfile.TemporaryDirectory() as made:
        return {**starts(Path(made)), **many(Path(made) / "many"), **curves(Path(made) / "curves")}


def starts(folder: Path) -> dict[str, float]:
    """Of an empty folder."""
    served = []
    for _ in range(STARTS):
        served.append(Served(folder))
        memory = served[-1].memory
        if len(served) < STARTS:
            served[-1].end()
    last = served[-1]
    text = last_device()
    body = {"path": "devices/a.toml", "text": text}
    last.asked("/api/device/check", body)
    began = time.perf_counter()
    last.asked("/api/device/check", body)
    typed, after = time.perf_counter() - began, last.memory
    last.end()
    return {
        "start to the first page, s": min(one.seconds for one in served),
        "memory at the start, MiB": memory,
        "a device text checked, base parameters and drawing, s": typed,
        "memory after a device page, MiB": after,
    }


def last_device() -> str:
    """The text of a device with a loop."""
    from haptid.app.pages.device import shipped_text

    return shipped_text("phantom_premium_15")


def many(folder: Path) -> dict[str, float]:
    """Results listed and searched."""
    for k in range(RESULTS):
        place = folder / "results" / f"device-{k % 100:02d}-run-{k:05d}"
        place.mkdir(parents=True)
        error = {"rows": "unseen", "motor": "all", "relative_error_percent": 1.0 + k % 7}
        result = {
            "study": f"study {k % 37}",
            "device": f"device {k % 100}",
            "estimate": {"method": "WLS", "parameters": [{"name": "FV1"}] * 14},
            "criteria": {"relative_error_percent": 5.0, "met": True},
            "validation": [error],
            "logs": [{"path": f"../logs/{k}.csv", "sha256": f"{k:064x}"}],
        }
        (place / "result.json").write_text(json.dumps(result))
    index = Index(folder, folder / "index.sqlite")
    figures = {}
    for what, act in (
        ("made", index.refresh),
        ("brought up to date, nothing changed", index.refresh),
        ("listed, 200 of them", lambda: index.search("result")),
        ("searched by two words", lambda: index.search("result", "device-42 study")),
    ):
        began = time.perf_counter()
        act()
        figures[f"{RESULTS} results, {what}, s"] = time.perf_counter() - began
    index.close()
    return figures


def curves(folder: Path) -> dict[str, float]:
    """A long log in a browser: until it is drawn, and a step of zooming all charts."""
    from browser import LAPTOP, browser, page

    if browser() is None:
        return {}
    written_log(folder / "logs" / "long.csv")
    served = Served(folder)
    try:
        with page(folder) as tab:
            tab.go(served.address, LAPTOP)
            tab.go(f"http://127.0.0.1:{served.port}/data", LAPTOP)  # the server has read the log once
            tab.go(f"http://127.0.0.1:{served.port}/data", LAPTOP)
            drawn = tab.ask("Number(document.getElementById('plots').dataset.drawn)")
            step = tab.ask(f"""(() => {{
              const plot = document.querySelector('.plot'), times = [];
              for (let k = 0; k < {ZOOMS}; k++) {{
                const began = performance.now();
                plot.dispatchEvent(new KeyboardEvent("keydown", {{ key: k % 10 ? "+" : "0" }}));
                times.push(performance.now() - began);
              }}
              return times.sort((a, b) => a - b)[{ZOOMS // 2}];
            }})()""")
    finally:
        served.end()
    what = f"{CHANNELS} channels of {SAMPLES} samples"
    return {f"{what}, page opened until drawn, s": drawn / 1e3, f"{what}, a step of zooming, s": step / 1e3}


def written_log(path: Path) -> None:
    """Noisy sines of as many channels as a seven-joint arm has."""
    path.parent.mkdir(parents=True)
    t, rng = np.arange(SAMPLES) * 1e-3, np.random.default_rng(1)
    names = [f"{kind}{k + 1}" for kind in ("q", "tau") for k in range(CHANNELS // 2)]
    table = np.column_stack([t, *(np.sin(t * (1 + k)) + 0.01 * rng.standard_normal(SAMPLES) for k in range(CHANNELS))])
    np.savetxt(path, table, "%.7g", delimiter=",", header=",".join(["t", *names]), comments="")
