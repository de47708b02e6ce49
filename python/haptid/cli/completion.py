"""`haptid completion`."""

from __future__ import annotations

import sys
from typing import Annotated

import typer

from haptid.cli.common import COMPLETION_VARIABLE, AsJson, command, errors_shown, print_json
from haptid.errors import OptionError, suggestion

HELP = """\
Print the script that completes commands, options, devices and formats in bash, zsh or fish.

Nothing is written into the shell's configuration. To have it in every session:

- bash: `haptid completion bash >> ~/.bashrc`
- zsh: `haptid completion zsh > ~/.zfunc/_haptid`, with `fpath+=~/.zfunc; autoload -Uz compinit; compinit` in ~/.zshrc
- fish: `haptid completion fish > ~/.config/fish/completions/haptid.fish`

Exit status: 0 on success, 2 for another shell.

Example: `haptid completion bash`
"""
_SHELLS = ("bash", "zsh", "fish")


@command(HELP)
def completion(
    shell: Annotated[
        str, typer.Argument(help="bash, zsh or fish", show_default=False, autocompletion=lambda: list(_SHELLS))
    ],
    as_json: AsJson = False,
) -> None:
    from typer.completion import get_completion_script  # type: ignore[attr-defined]

    with errors_shown():
        if shell not in _SHELLS:
            advice = suggestion(shell, _SHELLS)
            raise OptionError(f"there is no script for {shell!r}.", found=shell, limit=_SHELLS, advice=advice)
    script = get_completion_script(prog_name="haptid", complete_var=COMPLETION_VARIABLE, shell=shell) + "\n"
    if as_json:
        print_json("completion", {"shell": shell, "script": script})
    else:
        sys.stdout.write(script)
