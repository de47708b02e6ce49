"""What tests of every kind share."""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
import typer.testing
from hypothesis import settings

if TYPE_CHECKING:
    from browser import Page

# How long an example takes is no claim: other processes decide on it. Laws that need more examples than 50 say so.
settings.register_profile("untimed", deadline=None, max_examples=50)
settings.load_profile("untimed")

# A command line is put together once, as in a process of its own, and not at every call.
typer.testing._get_command = cache(typer.testing._get_command)

PROJECT = Path(__file__).resolve().parents[1]


def pytest_collection_finish() -> None:
    """What the modules have made stays for the whole run: the garbage collector does not go through it again."""
    gc.collect()
    gc.freeze()


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of the measured data sets, which are not part of the project; without it the test is skipped."""
    folder = PROJECT.parent / "shared" / "data"
    if not folder.is_dir():
        pytest.skip(f"measured data sets are not here: no folder {folder}")
    return folder


@pytest.fixture(autouse=True, scope="session")
def small_pictures() -> Iterator[Callable[..., None]]:
    """Plots that are put together and not rendered, as few tests are about them; the plain `savefig`."""
    from matplotlib.figure import Figure

    plain = Figure.savefig

    def saved(figure: Figure, to: object, **given: object) -> None:
        if isinstance(to, str | Path):
            Path(to).write_bytes(b"\x89PNG\r\n\x1a\n")
        else:  # a page of a PDF
            plain(figure, to, **given)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Figure, "savefig", saved)
        yield plain


@pytest.fixture
def full_pictures(small_pictures: Callable[..., None], monkeypatch: pytest.MonkeyPatch) -> None:
    """Pictures as users get them."""
    monkeypatch.setattr("matplotlib.figure.Figure.savefig", small_pictures)


@pytest.fixture(scope="session")
def browser_tab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    """The first tab of the worker's one browser; modules open tabs of their own beside it."""
    from browser import page

    with page(tmp_path_factory.mktemp("browser")) as opened:
        yield opened
