"""Where in a device file something stands, for errors."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Place:
    """A file and a key path in it, such as `stylus.toml: joints[3].alpha`."""

    file: str
    key: str = ""

    def at(self, *steps: str | int) -> Place:
        """The place `steps` further down: names and list indices."""
        key = self.key
        for step in steps:
            key += f"[{step}]" if isinstance(step, int) else f".{step}" if key else step
        return Place(self.file, key)

    def __str__(self) -> str:
        return f"{self.file}: {self.key}" if self.key else self.file
