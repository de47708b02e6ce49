"""The workbench's two hard tasks as an application of NiceGUI: curves of a log, and signals that come by UDP.

Called with a port of the server, one for datagrams, and a log of columns as `.npy`; run by `beside_nicegui.py`.
"""

import asyncio
import struct
import sys
import time

import numpy as np
from nicegui import app, ui

PORT, UDP, LOG = int(sys.argv[1]), int(sys.argv[2]), sys.argv[3]
# Points of a thinned curve (least and greatest of each stretch), seconds that are seen, pictures a second.
POINTS, SECONDS, PICTURES = 2200, 10.0, 30
CHANNELS = 14


def curves(t, y):
    """Two charts of seven curves."""
    for part in (y[:, :7], y[:, 7:]):
        series = [
            {"type": "line", "showSymbol": False, "animation": False, "data": np.column_stack([t, one]).tolist()}
            for one in part.T
        ]
        axes = {"xAxis": {"type": "value", "min": float(t[0]), "max": float(t[-1])}, "yAxis": {"type": "value"}}
        yield ui.echart({**axes, "animation": False, "dataZoom": [{"type": "inside"}], "series": series}).classes(
            "h-60"
        )


def thinned(t, y, points):
    """Least and greatest of every stretch, as two points at its beginning."""
    each = max(1, len(t) // (points // 2))
    n = len(t) // each * each
    stretches = y[:n].reshape(-1, each, y.shape[1])
    both = np.stack([stretches.min(axis=1), stretches.max(axis=1)], axis=1).reshape(-1, y.shape[1])
    return np.repeat(t[:n:each], 2), both


@ui.page("/")
def home():
    """The least page."""
    ui.label("ready")


@ui.page("/log", response_timeout=120)
def log(points: int = 0):
    """The whole log, or thinned here."""
    table = np.load(LOG)
    t, y = table[:, 0], table[:, 1:]
    list(curves(*(thinned(t, y, points) if points else (t, y))))


class Samples(asyncio.DatagramProtocol):
    """The frames of haptid, a sample in each; a ring of the seconds that are seen."""

    def __init__(self):
        self.values, self.count = np.zeros((round(SECONDS * 1000), CHANNELS)), 0

    def datagram_received(self, data, _):
        """Sample after sample of the datagram."""
        for begin in range(16, len(data), 8 * CHANNELS):
            self.values[self.count % len(self.values)] = struct.unpack_from(f"<{CHANNELS}d", data, begin)
            self.count += 1


samples = Samples()


@app.on_startup
async def listen():
    """Take datagrams in the server's own loop."""
    await asyncio.get_running_loop().create_datagram_endpoint(lambda: samples, local_addr=("127.0.0.1", UDP))


@ui.page("/live")
def live():
    """The last seconds, thinned, thirty times a second."""
    charts = list(curves(np.zeros(2), np.zeros((2, CHANNELS))))

    def draw():
        end = samples.count
        index = np.arange(max(0, end - len(samples.values)), end)
        if len(index) < 2:
            return
        t, y = thinned(index / 1000.0, samples.values[index % len(samples.values)], 600)
        for k, chart in enumerate(charts):
            chart.options["xAxis"] |= {"min": float(t[0]), "max": float(t[-1])}
            for one, values in zip(chart.options["series"], y.T[7 * k :], strict=False):
                one["data"] = np.column_stack([t, values]).tolist()
            chart.update()

    ui.timer(1.0 / PICTURES, draw)


@app.get("/counts")
def counts():
    """Samples so far."""
    return {"samples": samples.count, "at": time.time()}


ui.run(port=PORT, host="127.0.0.1", show=False, reload=False, show_welcome_message=False)
