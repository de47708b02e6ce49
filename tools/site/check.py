"""Check the built site: links and anchors exist, no formula is left as TeX, nothing is loaded from elsewhere.

Where there is a browser, no page is wider than a phone either, and no script complains.

Run by `make docs` after the build; prints what is wrong and exits with 1.
"""

from __future__ import annotations

import re
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from html.parser import HTMLParser
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from urllib.parse import unquote, urlsplit

PROJECT = Path(__file__).resolve().parents[2]
PHONE = 390
# What TeX leaves where it was not set.
TEX = re.compile(r"\\\(|\\\[|\$\$|\\(?:frac|dot|ddot|sum|text)\b")
# Elements that load what they name.
LOADING = {"script": "src", "img": "src", "link": "href", "iframe": "src", "source": "src"}


class SitePage(HTMLParser):
    """Links, anchors, loaded addresses, and the text outside code and scripts of a page."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.path = path
        self.links: set[str] = set()
        self.anchors: set[str] = set()
        self.loaded: set[str] = set()
        self.text: list[str] = []
        self._silent: list[str] = []
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = {name: value or "" for name, value in attrs}
        if "id" in values:
            self.anchors.add(values["id"])
        if tag == "a" and "href" in values:
            self.links.add(values["href"])
        if tag in LOADING and values.get("rel") != "canonical":
            self.loaded.add(values.get(LOADING[tag], ""))
        if tag in ("code", "script", "style", "annotation"):
            self._silent.append(tag)

    def handle_endtag(self, tag: str) -> None:
        if self._silent and self._silent[-1] == tag:
            self._silent.pop()

    def handle_data(self, data: str) -> None:
        if not self._silent:
            self.text.append(data)


def faults(site: Path) -> Iterator[str]:
    """What is wrong with the files of a site, a line each."""
    pages = {path.resolve(): SitePage(path) for path in sorted(site.rglob("*.html"))}
    for path, page in pages.items():
        name = path.relative_to(site.resolve())
        yield from (f"{name}: TeX is left: {part.strip()[:60]!r}" for part in page.text if TEX.search(part))
        yield from (f"{name}: loads {url}" for url in page.loaded if urlsplit(url).netloc)
        if name.name == "404.html":
            continue  # its links are from the root of a server
        for link in sorted(page.links | page.loaded):
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                continue
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            if not target.exists():
                yield f"{name}: no file for {link}"
            elif (
                parts.fragment and target in pages and unquote(parts.fragment) not in pages[target].anchors | {"__toc"}
            ):
                yield f"{name}: no anchor for {link}"


def seen_faults(site: Path) -> Iterator[str]:
    """What is wrong with the pages in a browser as wide as a phone; nothing without a browser."""
    sys.path.insert(0, str(PROJECT / "tests"))
    import browser

    if browser.browser() is None:
        return
    # Processes of the browser may outlive its first one, and write into the profile while it is removed.
    profile = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
    with served(site) as address, profile as folder, browser.page(Path(folder)) as tab:
        tab.size(PHONE, 800)
        for path in sorted(site.rglob("*.html")):
            name = path.relative_to(site).as_posix()
            if name == "404.html":
                continue
            tab.troubles.clear()
            tab.call("Page.navigate", url=f"{address}/{name}")
            tab.wait(f"document.readyState === 'complete' && location.pathname === '/{name}'")
            over = tab.ask("document.documentElement.scrollWidth - document.documentElement.clientWidth")
            if over > 0:
                yield f"{name}: {over} pixels wider than {PHONE}"
            yield from (f"{name}: {trouble}" for trouble in tab.troubles)


@contextmanager
def served(site: Path) -> Iterator[str]:
    """The site at an address of this machine, as its search needs a server."""
    handler = partial(_Silent, directory=str(site))
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        try:
            yield f"http://127.0.0.1:{server.server_port}"
        finally:
            server.shutdown()


class _Silent(SimpleHTTPRequestHandler):
    def log_message(self, *_: object) -> None:
        """Requests are not printed."""


if __name__ == "__main__":
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else PROJECT / "site")
    found = [*faults(folder), *seen_faults(folder)]
    print("\n".join(found) or f"{len(list(folder.rglob('*.html')))} pages without a fault")
    sys.exit(bool(found))
