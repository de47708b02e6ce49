"""haptid: dynamic models of haptic devices and robots from their own motion logs.

The pipeline, from a device file and logs to a validated model:

    model = haptid.DynamicModel(haptid.read_device("stylus.toml"))
    log = haptid.read_log("sweep.csv")
    motion = haptid.treat(log, haptid.propose(model, log).treatment)
    observation = haptid.observe(model, motion)
    estimate = haptid.estimate(observation, haptid.WLS())
    validation = haptid.validate(estimate, haptid.observe(model, unseen))
"""

import ast
from importlib import import_module
from pathlib import Path

from haptid import errors
from haptid._core import __version__ as __version__


def _homes() -> dict[str, str]:
    """Module of each public name, from the imports in the stub beside: the one list of them."""
    stub = ast.parse(Path(__file__).with_suffix(".pyi").read_text(encoding="utf-8"))
    imports = [node for node in stub.body if isinstance(node, ast.ImportFrom) and node.module != __name__]
    return {alias.name: node.module for node in imports for alias in node.names if node.module}


_HOMES = _homes()
__all__ = ["errors", *_HOMES]


def __getattr__(name: str) -> object:
    """A public name at its first use (PEP 562): a program loads what it calls, and nothing else."""
    if name not in _HOMES:
        raise AttributeError(f"module 'haptid' has no attribute {name!r}")
    value = getattr(import_module(_HOMES[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
