"""Export formats."""

from __future__ import annotations

import csv
from pathlib import Path

from haptid.export import Export, ExportSource, provenance


def export_csv(identified: ExportSource, folder: Path, *, anyway: bool = False) -> Export:
    """Write the parameters as a table: name, value, unit.

    Raises:
        UnvalidatedModelError: the model does not meet its validation criterion, and `anyway` is False.
    """
    source = provenance(identified, anyway=anyway)
    base = source.model.base
    folder.mkdir(parents=True)
    with (folder / "parameters.csv").open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow(["name", "value", "unit"])
        table.writerows(zip(base.names, source.beta.tolist(), base.units, strict=True))
    return Export(folder, ("parameters.csv",), source.verdict)
