"""Run a demonstration and keep the sections of its page for docs: python benchmarks/demo_record.py phantom medical"""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path
from typing import Any

from haptid.demos import demo_names, kind_of, read_demo, run_demo
from run import HERE, machine


def main() -> None:
    """Run what was asked for, keep it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="+", choices=demo_names())
    for name in parser.parse_args().names:
        with tempfile.TemporaryDirectory() as folder:
            record = recorded(name, Path(folder))
        text = json.dumps(record, indent=1, ensure_ascii=False)
        (HERE / "results" / f"{name}-demo.json").write_text(text + "\n", encoding="utf-8")


def recorded(name: str, folder: Path) -> dict[str, object]:
    """Where and with which settings a demonstration was run, and the texts and tables of its page."""
    demo = read_demo(name)
    found = run_demo(demo, folder, lambda _what, _share: None)
    sections = {
        section.key: {
            "text": list(section.text),
            "tables": [{"title": table.title, "cells": [list(row) for row in table.cells]} for table in section.tables],
        }
        for section in kind_of(demo).sections(found)
    }
    return {"where": machine(), "settings": settings(name, found), "sections": sections}


def settings(name: str, found: Any) -> dict[str, str]:
    """The command, and the method and intervals of its fits."""
    estimate = found.fits["normal"]["encoders"].estimate if name == "phantom" else found.found["upper"].full
    return {
        "command": f"haptid demo {name}",
        "method": repr(estimate.method),
        "intervals": repr(estimate.intervals),
    }


if __name__ == "__main__":
    main()
