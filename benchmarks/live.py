"""Live: the cost of recursive identification, and a recording by UDP while pages look on.

Wall times; processes of other work disturb them.
"""

from __future__ import annotations

import json
import os
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np

import haptid
from haptid.estimation import RecursiveIdentification
from haptid.live import play
from haptid.observation import RowStream
from workbench import Served

# Joints of the recorded arm, length, s, and sampling rate, Hz; number of pages that look on.
JOINTS, LIVE_S, RATE, TABS = 7, 600.0, 1000.0, 8


def run() -> dict[str, float]:
    """Microseconds a sample, seconds, samples, share of a core, MiB."""
    with tempfile.TemporaryDirectory() as made:
        return {**recursion(), **recorded(Path(made) / "live")}


def arm_samples(seconds: float) -> tuple[haptid.DynamicModel, np.ndarray, np.ndarray]:
    """A seven-joint arm, and positions and torques of known parameters with noise, each (n, joints)."""
    model = haptid.DynamicModel(haptid.read_device("arm7"))
    rng, t = np.random.default_rng(1), np.arange(round(seconds * RATE)) / RATE
    omega, phase = rng.uniform(1, 8, (JOINTS, 4, 1)), rng.uniform(0, 6, (JOINTS, 4, 1))
    q, qd, qdd = (
        (0.3 / omega * factor * wave(omega * t + phase)).sum(axis=1)
        for factor, wave in ((1.0, np.sin), (omega, np.cos), (-(omega**2), np.sin))
    )
    beta = rng.uniform(0.5, 1.5, len(model.base))
    tau = haptid.inverse_dynamics(model, beta, q, qd, qdd)
    return model, q.T, (tau + 0.02 * rng.standard_normal(tau.shape)).T


def recursion() -> dict[str, float]:
    """From raw samples to the triangle, and to parameters with intervals, a sample of seven joints."""
    model, q, tau = arm_samples(60.0)
    names = [
        haptid.Signal(tuple(f"{kind}{k}" for k in range(JOINTS)), unit) for kind, unit in (("q", "rad"), ("t", "N m"))
    ]
    channels = haptid.Channels(*names, rate_hz=RATE)
    stream, found = (
        RowStream(model, channels, 1 / RATE, haptid.Treatment(decimation=10)),
        RecursiveIdentification(model),
    )
    rows, added, estimated = [], [], []
    second = round(RATE)
    for begin in range(0, len(q), second):
        began = time.perf_counter()
        made = list(stream.push(q[begin : begin + second], tau[begin : begin + second]))
        treated = time.perf_counter()
        for part in made:
            found.add(part)
        rows.append(treated - began)
        added.append(time.perf_counter() - treated)
        if begin % (5 * second) == 0 and begin:
            began = time.perf_counter()
            found.estimate()
            estimated.append(time.perf_counter() - began)
    many = 1e6 / second
    return {
        "seven joints: samples filtered and reduced to rows, us": many * float(np.median(rows)),
        "seven joints: recursion, us": many * float(np.median(added)),
        "seven joints: all parameters with intervals, once, s": float(np.median(estimated)),
    }


def recorded(folder: Path) -> dict[str, float]:
    """Fourteen channels by UDP while pages look on: what is lost, and what it takes of the server."""
    served = Served(folder)
    state = begun(served, folder)
    _, q, tau = arm_samples(60.0)
    end, over = time.monotonic() + LIVE_S, threading.Event()

    def looks_on() -> None:
        following = 0
        while not over.wait(1 / 10):
            answer = served.asked(f"/api/live/samples?since={following}").content
            following = json.loads(answer[4 : 4 + int.from_bytes(answer[:4], "little")])["next"]

    pages = [threading.Thread(target=looks_on) for _ in range(TABS)]
    for one in pages:
        one.start()
    sent = play(q, tau, RATE, ("127.0.0.1", state["port"]), again=True, stop=lambda: time.monotonic() > end)
    over.set()
    for one in pages:
        one.join()
    time.sleep(2.0)
    counts, memory = json.loads(served.asked("/api/live/state").content)["counts"], served.memory
    times = Path(f"/proc/{served.process.pid}/stat").read_text().split() if Path("/proc").exists() else []
    used = (int(times[13]) + int(times[14])) / os.sysconf("SC_CLK_TCK") if times else float("nan")
    served.asked("/api/live/stop", {"end": True})
    served.end()
    what = f"{2 * JOINTS} channels at {RATE:g} Hz for {LIVE_S:g} s, {TABS} pages looking on"
    return {
        f"{what}: sent, samples": float(sent),
        f"{what}: lost, samples": float(sent - counts["written"]),
        f"{what}: of one core, %": 100 * used / LIVE_S,
        f"{what}: memory, MiB": memory,
    }


def begun(served: Served, folder: Path) -> dict[str, Any]:
    """A recording of a seven-joint arm, waiting for samples: its state."""
    names = [f"{kind}{k + 1}" for kind in ("q", "tau") for k in range(JOINTS)]
    for name in ("studies", "logs"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    text = f"""schema = 1
name = "seven"
device = "arm7"
[channels]
time = "t"
position = {{ channels = {json.dumps(names[:JOINTS])}, unit = "rad" }}
torque = {{ channels = {json.dumps(names[JOINTS:])}, unit = "N m" }}
[[logs]]
path = "../logs/live.csv"
"""
    (folder / "studies" / "seven.toml").write_text(text)
    begin = {"study": "studies/seven.toml", "name": "live", "rate": f"{RATE:g}", "port": "0"}
    return dict(json.loads(served.asked("/api/live/start", begin).content))
