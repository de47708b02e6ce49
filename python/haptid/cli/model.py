"""`haptid model`."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated

import typer

from haptid.cli.common import AsJson, DeviceName, command, err, errors_shown, out, print_json

if TYPE_CHECKING:
    from haptid.dynamics.model import DynamicModel


@command("Print a device's tree, loops, motors, base parameters and regroupings.")
def model(
    device: DeviceName,
    keep: Annotated[list[str] | None, typer.Option("--keep", help="a parameter to prefer as a base parameter")] = None,
    latex: Annotated[bool, typer.Option("--latex", help="only the regroupings, as LaTeX")] = False,
    as_json: AsJson = False,
) -> None:
    from haptid.device import read_device
    from haptid.device.toml.reader import keeping
    from haptid.dynamics.model import DynamicModel
    from haptid.report import model_tables

    with errors_shown():
        read = DynamicModel(keeping(read_device(device), keep) if keep else read_device(device))
        for sentence in _not_kept(read) if keep else ():
            err.print(sentence, soft_wrap=True)
        if latex:
            sys.stdout.write("".join(f"{line}\n" for line in read.regroupings.latex))
        elif as_json:
            print_json("model", model_tables.model_values(read))
        else:
            model_tables.show_model(out, read)


def _not_kept(model: DynamicModel) -> Iterator[str]:
    """Preferred parameters that cannot be base parameters, with the reason."""
    base = model.base
    cache = {base.standard[k] for k in base.independent_columns}
    for name in model.device.keep:
        if name in base.no_effect:
            yield f"{name} cannot be a base parameter: it has no effect on the torque."
        elif name not in cache:
            yield f"{name} cannot be a base parameter: it depends linearly on preferred parameters before it."
