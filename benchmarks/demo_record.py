"""Run a demonstration and keep the sections of its page for docs: python benchmarks/demo_record.py phantom medical

With --flaws, only the section on the flaws of a real device is recorded again, and replaced in the existing record.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path
from typing import Any

import haptid
from haptid.demos import demo_names, kind_of, read_demo, run_demo
from haptid.demos.cea_branches import results as medical
from haptid.demos.flaws import flaws_section
from haptid.demos.phantom_configurations import fits
from haptid.demos.phantom_configurations import results as phantom
from haptid.demos.recordings import read_recording, record_all
from haptid.report.document import DocumentSection
from haptid.treatment_choice.propose import propose
from run import HERE, machine


def main() -> None:
    """Run what was asked for, keep it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="+", choices=demo_names())
    parser.add_argument("--flaws", action="store_true", help="only the section on flaws")
    given = parser.parse_args()
    for name in given.names:
        path = HERE / "results" / f"{name}-demo.json"
        with tempfile.TemporaryDirectory() as folder:
            if given.flaws:
                record = json.loads(path.read_text(encoding="utf-8"))
                record["sections"]["flaws"] = {"where": machine(), **as_record(flaws_alone(name, Path(folder)))}
            else:
                record = recorded(name, Path(folder))
        path.write_text(json.dumps(record, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


def recorded(name: str, folder: Path) -> dict[str, object]:
    """Where and with which settings a demonstration was run, and the texts and tables of its page."""
    demo = read_demo(name)
    found = run_demo(demo, folder, lambda _what, _share: None)
    sections = {section.key: as_record(section) for section in kind_of(demo).sections(found)}
    return {"where": machine(), "settings": settings(name, found), "sections": sections}


def as_record(section: DocumentSection) -> dict[str, object]:
    """Texts and tables of a section."""
    tables = [{"title": table.title, "cells": [list(row) for row in table.cells]} for table in section.tables]
    return {"text": list(section.text), "tables": tables}


def flaws_alone(name: str, folder: Path) -> DocumentSection:
    """The section on flaws, from the logs that it needs and no others."""
    demo: Any = read_demo(name)
    model, plan = haptid.DynamicModel(haptid.read_device(demo.device)), demo.flawed
    first = next(iter(demo.mountings)) if name == "phantom" else demo.branches[0].key
    keys = list(dict.fromkeys([first, plan.fit, *([] if name == "phantom" else [f"{first}_unseen", plan.unseen])]))
    for _ in record_all([demo.take(key, folder) for key in keys]):
        pass
    made = [read_recording(model, folder / f"{key}.toml", folder / f"{key}.parquet") for key in keys]
    if name == "phantom":
        halves = (demo.stretch.fit, demo.stretch.unseen)
        treatment = propose(model, made[0].log(halves[0])).treatment
        fit = fits.fitted("", model, [made[0].motion(half, treatment) for half in halves])
        return flaws_section(phantom.flawed(demo, fit, *made))
    pairs = made[::2], made[1::2]
    one = medical.identified(demo.branches[0], demo.tables[first], demo.stretch, made[0], made[2])
    return flaws_section(medical.flawed(demo, one, *pairs))


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
