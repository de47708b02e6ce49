"""Demonstrations: a published identification, reproduced on the virtual bench, and what can be done better."""

from haptid.demos.known import demo_names, kind_of, read_demo
from haptid.demos.plan import Demo
from haptid.demos.run import run_demo

__all__ = ["Demo", "demo_names", "kind_of", "read_demo", "run_demo"]
