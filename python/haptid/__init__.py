"""haptid: dynamic models of haptic devices and robots from their own motion logs.

The pipeline, from a device file and logs to a validated model:

    model = haptid.DynamicModel(haptid.read_device("stylus.toml"))
    log = haptid.read_log("sweep.csv")
    motion = haptid.treat(log, haptid.propose(model, log).treatment)
    observation = haptid.observe(model, motion)
    estimate = haptid.estimate(observation, haptid.WLS())
    validation = haptid.validate(estimate, haptid.observe(model, unseen))

Here are the functions of that pipeline, its values, the estimators and the covariance estimators. Everything else is
public in its room, which is loaded at first use: `haptid.estimation.Bounds`, `haptid.inference.drift`.
"""

import ast
from importlib import import_module
from pathlib import Path

from haptid import errors
from haptid._core import __version__ as __version__


def _homes() -> tuple[dict[str, str], frozenset[str]]:
    """Module of each public name, and the rooms, from the imports of the stub `__init__.pyi`: the one list of them."""
    stub = ast.parse(Path(__file__).with_suffix(".pyi").read_text(encoding="utf-8"))
    imports = [node for node in stub.body if isinstance(node, ast.ImportFrom)]
    homes = {a.name: node.module for node in imports for a in node.names if node.module and node.module != __name__}
    return homes, frozenset(a.name for node in imports for a in node.names if node.module == __name__)


_HOMES, _ROOMS = _homes()
__all__ = ["errors", *_HOMES]


def __getattr__(name: str) -> object:
    """A public name or a room at its first use (PEP 562), so that a program loads only what it calls."""
    if name in _ROOMS:
        return import_module(f"{__name__}.{name}")
    if name not in _HOMES:
        raise AttributeError(f"module 'haptid' has no attribute {name!r}")
    value = getattr(import_module(_HOMES[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__, *_ROOMS})
