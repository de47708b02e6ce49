"""Shipped devices with parts of their files replaced."""

from __future__ import annotations

from pathlib import Path

import haptid

DEVICES = Path(haptid.__file__).parent / "device/library"
# Set B of the branch of the medical interface: lever axis and forearm turned by half a turn, as the printed
# regroupings have it.
SET_B = (
    ('frame_b = { d = "-d6" } }\nguess = { 3 = "-pi", 6 = 0 }', 'frame_b = { d = "d6" } }\nguess = { 3 = 0, 6 = 0 }'),
    ('frame_b = { gamma = "-pi/2", d = "-d7" }', 'frame_b = { gamma = "pi/2", d = "-d7" }'),
    ('guess = { 7 = 0, 8 = "pi/2" }', 'guess = { 7 = 0, 8 = "-pi/2" }'),
)


def changed(name: str, folder: Path, *changes: tuple[str, str]) -> haptid.Device:
    """A shipped device, read from a file in a folder in which each first text stands as the second."""
    text = (DEVICES / f"{name}.toml").read_text(encoding="utf-8")
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    path = folder / f"{name}.toml"
    path.write_text(text, encoding="utf-8")
    return haptid.DynamicModel(haptid.read_device(path))
