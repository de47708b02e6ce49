"""A page in a real headless browser, driven through its own DevTools protocol."""

from __future__ import annotations

import base64
import json
import shutil
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.metadata import distribution
from pathlib import Path
from typing import Any

import pytest
from websockets.sync.client import ClientConnection, connect

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
SETTINGS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--hide-scrollbars",
    "--remote-debugging-port=0",
)
# What a slow machine may take to start, or to draw, s.
PATIENCE = 60.0
# Widths of windows, pixels.
LAPTOP, PHONE, NARROW = 1280, 390, 320
# A window of 4K, width and height.
HUGE = 3840, 2160


def browser() -> str | None:
    """The path of a browser, if there is one."""
    return next((path for name in NAMES if (path := shutil.which(name))), None)


needs_browser = pytest.mark.skipif(
    browser() is None, reason="no browser: install Debian's chromium, or Chrome, to test the report in one"
)


# axe-core, which another package brings.
AXE = Path(str(distribution("axe-playwright-python").locate_file("axe_playwright_python/axe.min.js")))


class Navigated(Exception):
    """The page was left while it was asked."""


class Page:
    """One tab. `troubles` are the errors and warnings of its console, and what it threw; `asked` what it requested."""

    def __init__(self, socket: ClientConnection, address: str) -> None:
        self.socket, self.address = socket, address
        self.count = 0
        self.troubles: list[str] = []
        self.asked: list[str] = []
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.call(f"{domain}.enable")

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """One command, and its answer."""
        self.count += 1
        self.socket.send(json.dumps({"id": self.count, "method": method, "params": parameters}))
        while True:
            message = json.loads(self.socket.recv(timeout=PATIENCE))
            self.note(message)
            if message.get("id") == self.count:
                if "navigated" in message.get("error", {}).get("message", ""):
                    raise Navigated
                assert "error" not in message, message
                return message["result"]

    def note(self, message: dict[str, Any]) -> None:
        """Keep what the page complains of."""
        values = message.get("params", {})
        if message.get("method") == "Runtime.exceptionThrown":
            self.troubles.append(str(values["exceptionDetails"].get("exception", values).get("description", values)))
        elif message.get("method") == "Runtime.consoleAPICalled" and values["type"] in ("error", "warning", "assert"):
            self.troubles.append(str([argument.get("value") for argument in values["args"]]))
        elif message.get("method") == "Network.requestWillBeSent":
            self.asked.append(values["request"]["url"])
        elif message.get("method") == "Network.webSocketCreated":
            self.asked.append(values["url"])
        elif message.get("method") == "Log.entryAdded" and values["entry"]["level"] in ("error", "warning"):
            self.troubles.append(values["entry"]["text"])

    @contextmanager
    def another(self) -> Iterator[Page]:
        """A second tab of the same browser."""
        target = self.call("Target.createTarget", url="about:blank", background=True)["targetId"]
        with _tab(f"{self.address.rpartition('/')[0]}/{target}") as opened:
            opened.call("Page.bringToFront")
            yield opened
        self.call("Target.closeTarget", targetId=target)

    def open(self, path: Path, width: int, height: int = 900) -> None:
        """Load a file and wait until its charts are drawn."""
        self.go(path.resolve().as_uri(), width, height)

    def go(self, address: str, width: int, height: int = 900) -> None:
        """Load an address, and wait until the page says that it is ready."""
        self.size(width, height)
        # By way of an empty page: one that is left may become ready just now.
        self.call("Page.navigate", url="about:blank")
        self.wait("location.href === 'about:blank'")
        self.call("Page.navigate", url=address)
        self.wait("document.body && 'ready' in document.body.dataset")

    def press(self, key: str, shift: bool = False) -> None:
        """A key, as by a person."""
        text = {"Enter": "\r", "Space": " "}.get(key, key if len(key) == 1 else "")
        name = " " if key == "Space" else key
        codes = {"Tab": 9, "Enter": 13, "Space": 32, "End": 35, "Home": 36, "ArrowLeft": 37, "ArrowRight": 39}
        about = {"key": name, "code": key, "windowsVirtualKeyCode": codes.get(key, 0), "modifiers": 8 * shift}
        self.call("Input.dispatchKeyEvent", type="keyDown", text=text, **about)
        self.call("Input.dispatchKeyEvent", type="keyUp", **about)

    def tabs(self, count: int) -> None:
        """The Tab key this many times; answers of the browser are read at the end."""
        first = self.count + 1
        for _ in range(count):
            for kind in ("keyDown", "keyUp"):
                self.count += 1
                about = {"type": kind, "key": "Tab", "code": "Tab", "windowsVirtualKeyCode": 9}
                self.socket.send(json.dumps({"id": self.count, "method": "Input.dispatchKeyEvent", "params": about}))
        left = set(range(first, self.count + 1))
        while left:
            message = json.loads(self.socket.recv(timeout=PATIENCE))
            self.note(message)
            left.discard(message.get("id", 0))

    def write(self, selector: str, text: str) -> None:
        """Put a text into a field, as if it were typed."""
        field, value = json.dumps(selector), json.dumps(text)
        self.ask(
            f"(() => {{ const f = document.querySelector({field}); f.focus(); f.value = {value};"
            "f.dispatchEvent(new Event('input', {bubbles: true}));"
            "f.dispatchEvent(new Event('change', {bubbles: true})); })()"
        )

    def accessibility(self) -> list[str]:
        """What axe-core finds in the page as it is: impact, rule and the first element of each finding."""
        before = len(self.troubles)
        self.ask(AXE.read_text(encoding="utf-8") + ";0")
        found = self.ask("axe.run(document, {resultTypes: ['violations']}).then((r) => r.violations)")
        del self.troubles[before:]  # styles that it tries to apply, and a strict policy refuses
        return [f"{one['impact']} {one['id']}: {one['nodes'][0]['html'][:150]}" for one in found]

    def size(self, width: int, height: int) -> None:
        """Of the window."""
        mobile = width < 600
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=mobile)

    def ask(self, expression: str) -> Any:
        """The value of an expression in the page."""
        result = self.call("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in result, result["exceptionDetails"]
        return result["result"].get("value")

    def wait(self, expression: str) -> None:
        """Until an expression is true."""
        end = time.monotonic() + PATIENCE
        while not self._holds(expression):
            assert time.monotonic() < end, f"never true: {expression}"
            time.sleep(0.05)

    def _holds(self, expression: str) -> bool:
        """Whether an expression is true now; not in a page that is being left."""
        try:
            return bool(self.ask(f"Boolean({expression})"))
        except Navigated:
            return False

    def drag(self, selector: str, start: tuple[float, float], end: tuple[float, float]) -> None:
        """With the mouse over an element, between two points in shares of its size."""
        self.ask(f"document.querySelector({json.dumps(selector)}).scrollIntoView({{behavior: 'instant'}})")
        box = self.ask(f"document.querySelector({json.dumps(selector)}).getBoundingClientRect().toJSON()")
        points = [(box["x"] + share[0] * box["width"], box["y"] + share[1] * box["height"]) for share in (start, end)]
        kinds = (("mousePressed", points[0]), ("mouseMoved", points[1]), ("mouseReleased", points[1]))
        for kind, (x, y) in kinds:
            self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", buttons=1, clickCount=1)

    def picture(self, path: Path, selector: str = "html") -> Path:
        """A PNG of an element, as long as it is."""
        box = self.ask(
            f"(() => {{ const r = document.querySelector({json.dumps(selector)}).getBoundingClientRect();"
            "return {x: r.x + scrollX, y: r.y + scrollY, width: r.width, height: r.height}; })()"
        )
        shot = self.call("Page.captureScreenshot", captureBeyondViewport=True, clip={**box, "scale": 1})
        path.write_bytes(base64.b64decode(shot["data"]))
        return path


@contextmanager
def page(folder: Path) -> Iterator[Page]:
    """A new browser with one empty tab; its profile is kept in a folder of the test."""
    program = browser()
    assert program is not None
    profile = folder / "profile"
    process = subprocess.Popen(
        [program, *SETTINGS, f"--user-data-dir={profile}", "about:blank"],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        with _tab(_address(profile, process)) as opened:
            yield opened
    finally:
        process.terminate()
        process.wait(timeout=PATIENCE)


@contextmanager
def _tab(address: str) -> Iterator[Page]:
    """The tab with this socket; a busy page may be late, and is not given up."""
    with connect(address, max_size=None, proxy=None, ping_interval=None) as socket:
        yield Page(socket, address)


def _address(profile: Path, process: subprocess.Popen[bytes]) -> str:
    """Of the first tab's socket, as soon as the browser has said on which port it listens."""
    import urllib.request

    told, end = profile / "DevToolsActivePort", time.monotonic() + PATIENCE
    while not (told.is_file() and told.read_text().count("\n") >= 1):
        assert process.poll() is None, f"the browser ended with status {process.returncode}"
        assert time.monotonic() < end, "the browser did not start"
        time.sleep(0.05)
    port = told.read_text().split("\n")[0]
    opener = urllib.request.build_opener(urllib.request.ProxyHandler({}))
    with opener.open(f"http://127.0.0.1:{port}/json/list", timeout=PATIENCE) as answer:
        tabs = json.loads(answer.read())
    return str(next(tab["webSocketDebuggerUrl"] for tab in tabs if tab["type"] == "page"))
