"""Layer check of the Rust core: a folder of `crates/core/src` may use only folders before it in LAYERS, and itself.

Run `python tools/check_rust_layers.py [SOURCE]`: one line for each path that points up, as `file:line: arrow`, and exit
status 1 if there is one. `violations(source)` returns the same lines to a test. Code under `#[cfg(test)]`, comments and
string literals do not count; the crate root, which only re-exports, may use every folder.
"""

import re
import sys
from collections.abc import Iterator
from pathlib import Path

LAYERS = (
    "error",
    "simd",
    "memory",
    "exact",
    "linalg",
    "mechanism",
    "batch",
    "regressor",
    "dynamics",
    "reduction",
    "loops",
    "end_effector",
)
SOURCE = Path(__file__).parent.parent / "crates" / "core" / "src"

# What is no code: comments, raw and plain strings, and characters (but not lifetimes).
_NO_CODE = re.compile(
    r"""//[^\n]*|/\*.*?\*/|b?r(#*)".*?"\1|b?"(?:\\.|[^"\\])*"|b?'(?:\\(?:x..|u\{[^}]*\}|.)|[^'\\])'""", re.DOTALL
)
_TEST_ITEM = re.compile(r"#\[cfg\(test\)\]\s*(?:#\[[^\]]*\]\s*)*[^;{]*[;{]")
_PATH = re.compile(r"\b(crate|super(?:\s*::\s*super)*)\s*::\s*(\{|\*|\w+)")


def violations(source: Path = SOURCE) -> list[str]:
    """Paths that point up, one line each: `file:line: from -> to (path)`."""
    found = []
    exported = _exported(_code((source / "lib.rs").read_text(encoding="utf-8")))
    for file in sorted(source.rglob("*.rs")):
        module = list(file.relative_to(source).with_suffix("").parts)
        if module[-1] == "mod":
            module.pop()
        if module == ["lib"]:
            continue
        text = _code(file.read_text(encoding="utf-8"))
        for position, path in _paths(text, module):
            place = f"{file.relative_to(source)}:{text.count(chr(10), 0, position) + 1}"
            own, other = module[0], exported.get(path[0], path[0])
            arrow = f"{own} -> {other} (crate::{'::'.join(path)})"
            if own not in LAYERS:
                found.append(f"{place}: {own} is not one of the layers: {', '.join(LAYERS)}")
            elif other not in LAYERS:
                found.append(f"{place}: {arrow}: {other} is neither a layer nor re-exported by the crate root")
            elif LAYERS.index(other) > LAYERS.index(own):
                found.append(f"{place}: {arrow} points up")
    return found


def _code(text: str) -> str:
    """The code outside tests: everything else is blanked, so that lines keep their numbers."""
    text = _NO_CODE.sub(lambda match: _blank(match[0]), text)
    while match := _TEST_ITEM.search(text):
        end = match.end() if match[0].endswith(";") else _closing(text, match.end() - 1) + 1
        text = text[: match.start()] + _blank(text[match.start() : end]) + text[end:]
    return text


def _blank(text: str) -> str:
    return re.sub(r"[^\n]", " ", text)


def _closing(text: str, opening: int) -> int:
    """Index of the brace that closes the one at `opening`."""
    depth = 0
    for index in range(opening, len(text)):
        depth += {"{": 1, "}": -1}.get(text[index], 0)
        if depth == 0:
            return index
    raise ValueError("a brace is never closed")


def _paths(text: str, module: list[str]) -> Iterator[tuple[int, list[str]]]:
    """Paths from the crate root, with their position: what `crate` or `super` begins, groups member by member."""
    for match in _PATH.finditer(text):
        prefix = [] if match[1] == "crate" else module[: len(module) - match[1].count("super")]
        if match[2] != "{":
            yield match.start(), [*prefix, match[2]]
            continue
        opening = match.end() - 1
        start, depth = opening + 1, 0
        for index in range(opening + 1, _closing(text, opening) + 1):
            if depth == 0 and text[index] in ",}":
                if name := re.search(r"\w+|\*", text[start:index]):
                    yield start + name.start(), [*prefix, name[0]]
                start = index + 1
            depth += {"{": 1, "}": -1}.get(text[index], 0)


def _exported(root: str) -> dict[str, str]:
    """The layer of every name that the crate root re-exports."""
    layers = {}
    for statement in re.finditer(r"\bpub\s+use\s+(?:crate\s*::\s*)?(\w+)\s*::([^;]*);", root):
        for name in re.findall(r"(\w+)\s*(?=[,}]|$)", statement[2]):
            layers[name] = statement[1]
    return {name: layer for name, layer in layers.items() if name not in LAYERS}


def main(arguments: list[str]) -> int:
    """Print the violations; 1 if there are any."""
    found = violations(Path(arguments[0]) if arguments else SOURCE)
    print("\n".join(found) or f"{len(LAYERS)} layers: no path points up")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
