"""Demonstrations: a published identification, reproduced on the virtual bench, and what can be done better."""

from haptid.demos.plan import Demo, demo_names, read_demo
from haptid.demos.run import Results, run_demo

__all__ = ["Demo", "Results", "demo_names", "read_demo", "run_demo"]
