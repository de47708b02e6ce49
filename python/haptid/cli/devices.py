"""`haptid devices`."""

from __future__ import annotations

from haptid.cli.common import app, out


@app.command()
def devices() -> None:
    """List the shipped devices."""
    from haptid.device import read_device, shipped_devices

    names = shipped_devices()
    for name in names:
        out.print(f"{name:{max(map(len, names))}}  {read_device(name).description}")
