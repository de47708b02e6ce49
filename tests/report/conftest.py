"""The tab of a browser, and the folder of what it opens; its pictures stay in the run's folder."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from browser import Page


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of what a module writes."""
    return tmp_path_factory.mktemp("report")


@pytest.fixture(scope="module")
def tab(browser_tab: Page) -> Iterator[Page]:
    """A tab of the module's own."""
    with browser_tab.another() as opened:
        yield opened
