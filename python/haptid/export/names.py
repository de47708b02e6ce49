"""Names of files and of what is in them, after the device's."""

from __future__ import annotations

import re

from haptid.errors import CodeNameError

# Names of C functions are told apart by their first 31 characters at least (C99, 5.2.4.1): so much is left for ours.
LONGEST_NAME = 24


def check_name(name: str) -> None:
    """Raise CodeNameError unless names in C can begin so."""
    if not re.fullmatch(rf"[a-z][a-z0-9_]{{0,{LONGEST_NAME - 1}}}", name):
        raise CodeNameError(name, LONGEST_NAME)


def default_name(model: str) -> str:
    """The device's name, as far as C allows."""
    plain = re.sub(r"[^a-z0-9]+", "_", model.lower()).strip("_")
    plain = plain if plain[:1].isalpha() else f"device_{plain}"
    return plain[:LONGEST_NAME].rstrip("_")
