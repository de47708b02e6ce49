"""Check the scripts of the report and of the workbench: their types as `tsc --checkJs` does, and their lengths.

The checker is TypeScript's own, of the package deno: its wheel needs no registry of JavaScript, and the check opens no
connection. The parts of the report's script have no imports; they are joined as the workbench loads them, and a finding
is named by its part and line. Run by `make check`; exits with 1 and prints what was found otherwise.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

from haptid.report.page import SCRIPTS, module_of_scripts

PACKAGE = Path(__file__).parents[1] / "python" / "haptid"
STATIC, TEMPLATES = PACKAGE / "app" / "static", PACKAGE / "report" / "templates"
MOST_LINES = 200
# uPlot's own declarations are not shipped: its calls are in one module, and tested in a browser.
UPLOT = "declare const uPlot: any;\nexport default uPlot;\n"
OPTIONS = {
    "checkJs": True,
    "strict": False,
    "noImplicitAny": False,
    "noImplicitOverride": False,
    "lib": ["es2023", "dom", "dom.iterable"],
}


def scripts() -> list[Path]:
    """Own scripts of both; what is vendored is not ours to change."""
    return [*sorted(STATIC.glob("*.js")), *sorted(STATIC.glob("pages/*.js")), *sorted(TEMPLATES.glob("*.js"))]


def long(paths: list[Path]) -> list[str]:
    """Scripts with too many lines."""
    counts = {path: len(path.read_text(encoding="utf-8").splitlines()) for path in paths}
    return [
        f"{path.name} has {n} lines; at most {MOST_LINES} are readable" for path, n in counts.items() if n > MOST_LINES
    ]


def origins() -> list[tuple[str, int]]:
    """Part and line of every line of the joined module; its first line is a comment."""
    made = [("", 0)]
    for name in SCRIPTS[:-1]:
        count = len((TEMPLATES / name).read_text(encoding="utf-8").split("\n"))
        made += [(name, k + 1) for k in range(count)]
    return [*made, ("exports", 1)]


def mistyped() -> list[str]:
    """Findings of the checker."""
    import deno

    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        (folder / "charts.js").write_text(module_of_scripts(), encoding="utf-8")
        (folder / "uPlot.d.ts").write_text(UPLOT, encoding="utf-8")
        vendored = (STATIC / "vendor" / "uPlot.esm.js").as_uri()
        imports = {"/report/": f"{folder.as_uri()}/", vendored: (folder / "uPlot.d.ts").as_uri()}
        (folder / "deno.json").write_text(
            json.dumps({"compilerOptions": OPTIONS, "imports": imports}), encoding="utf-8"
        )
        own = [str(path) for path in scripts() if path.parent != TEMPLATES]
        command = [deno.find_deno_bin(), "check", "--quiet", "--no-remote", "--config", str(folder / "deno.json"), *own]
        settings = {"DENO_DIR": str(folder / "cache"), "DENO_NO_UPDATE_CHECK": "1", "NO_COLOR": "1"}
        run = subprocess.run(command, capture_output=True, text=True, env=os.environ | settings)
    if not run.returncode:
        return []
    known = origins()

    def named(found: re.Match[str]) -> str:
        part, line = known[int(found[1]) - 1]
        return f"report/templates/{part}:{line}"

    return re.sub(rf"{re.escape(folder.as_uri())}/charts\.js:(\d+)", named, run.stderr).splitlines()


def main() -> int:
    """Print the findings; 1 if there are any."""
    found = [*long(scripts()), *mistyped()]
    print("\n".join(found) or f"{len(scripts())} scripts: types and lengths hold")
    return int(bool(found))


if __name__ == "__main__":
    sys.exit(main())
