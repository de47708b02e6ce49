"""`haptid devices`."""

from __future__ import annotations

from haptid.cli.common import AsJson, command, out, print_json


@command("List the shipped devices.")
def devices(as_json: AsJson = False) -> None:
    from haptid.device import read_device, shipped_devices

    descriptions = {name: read_device(name).description for name in shipped_devices()}
    if as_json:
        print_json(
            "devices", [{"name": name, "description": description} for name, description in descriptions.items()]
        )
        return
    for name, description in descriptions.items():
        out.print(f"{name:{max(map(len, descriptions))}}  {description}", highlight=False)
