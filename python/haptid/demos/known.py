"""The demonstrations that there are, and reading one."""

from __future__ import annotations

import tomllib

from haptid.demos.branches.kind import BRANCHES
from haptid.demos.kind import Kind
from haptid.demos.mountings.kind import MOUNTINGS
from haptid.demos.plan import CLAIMS, HERE, PLAN, Demo
from haptid.errors import UnknownDemoError

KINDS: dict[str, Kind] = {"mountings": MOUNTINGS, "branches": BRANCHES}


def kind_of(demo: Demo) -> Kind:
    """How a demonstration is walked."""
    return KINDS[demo.kind]


def demo_names() -> tuple[str, ...]:
    """Names of all demonstrations."""
    return tuple(sorted(path.parent.name for path in HERE.glob(f"*/{PLAN}")))


def read_demo(name: str) -> Demo:
    """A demonstration by its name.

    Raises:
        UnknownDemoError: there is none of that name.
    """
    if name not in demo_names():
        raise UnknownDemoError(name, demo_names())
    plan, claims = (tomllib.loads((HERE / name / file).read_text(encoding="utf-8")) for file in (PLAN, CLAIMS))
    return KINDS[plan["kind"]].plan.model_validate({**plan, **claims, "name": name})
