"""Demonstrations: two published identifications reproduced on the virtual bench, compared with the printed tables."""

from haptid.demos.plan import Demo
from haptid.demos.run import demo_names, kind_of, read_demo, run_demo

__all__ = ["Demo", "demo_names", "kind_of", "read_demo", "run_demo"]
