"""Names of signals in MATLAB structs that say them in a field, as dSPACE and Simulink write them."""

from __future__ import annotations

import re

# Fields of the name, the values and the unit of a signal's struct, and samples that it has at least.
NAMES, VALUES, UNITS, SAMPLES = ("name", "label", "signalname"), frozenset({"values", "data"}), ("unit", "units"), 16
# The port of a Simulink block.
_PORT = re.compile(r"/(?:Out|In)\d+$")


def title_of(name: str, unit: str) -> str:
    """The name of a signal, with its unit where it has one and the name does not say it."""
    title = _PORT.sub("", name.replace('"', ""))
    return f"{title} [{unit}]" if title and unit and not title.endswith((f"[{unit}]", f"({unit})")) else title
