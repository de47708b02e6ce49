"""A workbench in a process of its own, its calls without a browser, and pictures of its pages."""

from __future__ import annotations

import base64
import http.client
import json
import os
import re
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from browser import Page

IMAGES = Path(__file__).resolve().parents[1] / "docs" / "images"


@dataclass
class Bench:
    """A running workbench: its folder, its printed address, and its process."""

    folder: Path
    address: str
    process: subprocess.Popen[str]
    cookie: str = field(default="")

    @property
    def port(self) -> int:
        return urlsplit(self.address).port or 0

    @property
    def origin(self) -> str:
        return f"http://127.0.0.1:{self.port}"

    def enter(self) -> None:
        """Take the cookie."""
        answer = self.raw("GET", self.address.removeprefix(self.origin))
        assert answer.status == 303
        self.cookie = (answer.getheader("set-cookie") or "").split(";")[0]

    def raw(self, method: str, path: str, body: Any = None, **headers: str) -> http.client.HTTPResponse:
        """A request with exactly these headers, and Host; its answer is read."""
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=60)
        connection.putrequest(method, path, skip_host="host" in headers, skip_accept_encoding=True)
        for name, value in headers.items():
            connection.putheader(name.replace("_", "-"), value)
        if isinstance(body, bytes):
            connection.putheader("content-length", str(len(body)))
        connection.endheaders(body if isinstance(body, bytes) else None)
        answer = connection.getresponse()
        answer.content = answer.read()  # type: ignore[attr-defined]
        connection.close()
        return answer

    def ask(self, method: str, path: str, body: Any = None, **headers: str) -> tuple[int, Any]:
        """A request of a page of this workbench: status and JSON."""
        given = {"cookie": self.cookie, "origin": self.origin} | headers
        content = body if body is None or isinstance(body, bytes) else json.dumps(body).encode()
        answer = self.raw(method, path, content, **given)
        text = answer.content  # type: ignore[attr-defined]
        return answer.status, json.loads(text) if text[:1] in b"[{" else text


def started(folder: Path, *options: str) -> Bench:
    """A workbench on a folder, as soon as it answers."""
    process = subprocess.Popen(
        [sys.executable, "-m", "haptid", "app", str(folder), "--no-browser", *options],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    )
    assert process.stdout is not None
    line = process.stdout.readline()
    found = re.search(r"http://\S+", line)
    made = Bench(folder, found[0] if found else "", process)
    if not found:
        ended(made)
        raise AssertionError(line)
    made.enter()
    return made


def pictured(tab: Page, name: str, folder: Path) -> None:
    """A picture of what is seen of the page: into the documentation where RENEW_PICTURES is set, else thrown away."""
    folder = IMAGES if os.environ.get("RENEW_PICTURES") else folder
    used = tab.ask("Math.ceil(Math.max(...[...document.body.children].map((e) => e.getBoundingClientRect().bottom)))")
    size = tab.ask("[innerWidth, innerHeight]")
    clip = {"x": 0, "y": 0, "width": size[0], "height": min(used + 20, size[1]), "scale": 1}
    shot = base64.b64decode(tab.call("Page.captureScreenshot", clip=clip)["data"])
    assert len(shot) > 10_000
    (folder / f"workbench-{name}.png").write_bytes(shot)


def ended(bench: Bench) -> None:
    bench.process.terminate()
    bench.process.communicate(timeout=20)
