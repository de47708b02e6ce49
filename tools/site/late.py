"""Extension of griffe: the package's `dataclass` is that of the standard library, so its classes have their fields."""

from __future__ import annotations

from typing import Any

import griffe


class LateDataclasses(griffe.Extension):
    """The decorator under the name by which griffe knows it."""

    def on_alias_instance(self, *, alias: Any, **_: Any) -> None:
        """Name the standard decorator in place of the package's."""
        if alias.target_path == "haptid._internal.late.dataclass":
            alias.target_path = "dataclasses.dataclass"
