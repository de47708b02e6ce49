"""Check that every public top-level name of the package is defined in one module only.

A reader who greps for a name then finds its one definition. Names with a leading underscore are private to their
module and may recur. Run by `make check`; exits with 1 and lists the names otherwise.
"""

from __future__ import annotations

import ast
import sys
from collections import defaultdict
from pathlib import Path

PACKAGE = Path(__file__).parents[1] / "python" / "haptid"
# Rooms whose modules implement one interface, each under the same names: commands, papers, file formats.
APART = ("cli", "demos", "log/formats")


def targets(node: ast.expr) -> set[str]:
    """Names that an assignment to this expression binds: `A`, `A, B` and `[A, *B]`, but no attribute or item."""
    return {part.id for part in ast.walk(node) if isinstance(part, ast.Name) and isinstance(part.ctx, ast.Store)}


def definitions(path: Path) -> set[str]:
    """Public names that a module defines at its top level: functions, classes, constants and type aliases."""
    names: set[str] = set()
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            names.add(node.name)
        elif isinstance(node, ast.Assign):
            names |= set().union(*(targets(target) for target in node.targets))
        elif isinstance(node, ast.AnnAssign):
            names |= targets(node.target)
    return {name for name in names if not name.startswith("_")}


def repeated(package: Path = PACKAGE) -> dict[str, list[str]]:
    """Public names that are defined in two modules or more, with these modules."""
    homes: dict[str, list[str]] = defaultdict(list)
    for path in sorted(package.rglob("*.py")):
        place = path.relative_to(package)
        if any(str(place).startswith(f"{apart}/") for apart in APART):
            continue
        for name in definitions(path):
            homes[name].append(str(place))
    return {name: places for name, places in sorted(homes.items()) if len(places) > 1}


def main() -> int:
    """Print what is defined twice; 1 if anything is."""
    found = repeated()
    for name, places in found.items():
        print(f"{name} is defined in {', '.join(places)}: rename one, or make it private (_{name})", file=sys.stderr)
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
