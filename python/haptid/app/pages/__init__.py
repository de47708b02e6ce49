"""Calls of the pages, a module each."""

from __future__ import annotations

from starlette.routing import BaseRoute, Route

from haptid.app.answers import call
from haptid.app.pages.data import DATA_CALLS
from haptid.app.pages.device import DEVICE_CALLS
from haptid.app.pages.experiment import EXPERIMENT_CALLS
from haptid.app.pages.forms import FORMS_CALLS
from haptid.app.pages.home import HOME_CALLS
from haptid.app.pages.live import LIVE_CALLS
from haptid.app.pages.registry import REGISTRY_CALLS
from haptid.app.pages.results import RESULTS_CALLS
from haptid.app.pages.solve import SOLVE_CALLS
from haptid.app.session import Session

# Names of the pages; the first part of their addresses.
PAGES = ("device", "experiment", "data", "solve", "results", "use", "live", "registry")
_CALLS = (
    HOME_CALLS,
    DEVICE_CALLS,
    EXPERIMENT_CALLS,
    DATA_CALLS,
    SOLVE_CALLS,
    RESULTS_CALLS,
    LIVE_CALLS,
    REGISTRY_CALLS,
    FORMS_CALLS,
)


def routes(session: Session) -> list[BaseRoute]:
    """The calls of all pages."""
    made: list[BaseRoute] = []
    for calls in _CALLS:
        made += [Route(f"/api/{path}", call(session, each), methods=["POST"]) for path, each in calls.changes.items()]
        made += [Route(f"/api/{path}", call(session, each)) for path, each in calls.reads.items()]
        made += calls.streams(session)
    return made
