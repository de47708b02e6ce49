"""Recordings of which each quantity is in a file of its own: which files belong together, as paths with one `*`."""

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

from haptid.errors import HaptidError
from haptid.log.formats.folders import log_files, natural, table_files
from haptid.log.survey.families import MEASURED_WORDS, TREATED_WORDS, WANTED_WORDS
from haptid.log.survey.names import NEITHER, is_time, quantity_of
from haptid.log.survey.read import survey

# Words beside a quantity's that tell which one of its kind a file has.
_BESIDE = WANTED_WORDS | MEASURED_WORDS | TREATED_WORDS | {"joint", "joints", "motor", "est", "estimated"}
_WORD = re.compile(r"[^/_\-. ]+")
_BOUNDARY = re.compile(r"[/_\-. ]")
_WHOLE = {"position", "torque"}
# Files of which each is looked at, where their names do not tell what they have.
_LOOKED_AT = 8
# Recordings that are named in a sentence.
_SHOWN = 4


def recordings(paths: Sequence[Path]) -> list[Path]:
    """The recordings that files of one quantity each are parts of, each as a path with one `*`, or as their folder.

    Args:
        paths: of all of the files, or of one folder of them or of folders of them.

    Returns:
        Nothing where a file has positions and torques, where the names and contents of files do not tell that they
        belong together, or where a folder of one recording is given: it is a log itself.
    """
    folder = paths[0] if len(paths) == 1 and paths[0].is_dir() else None
    files = list(paths) if folder is None else _tables_in(folder)
    if len(files) < 2 or not all(file.is_file() for file in files):
        return []
    found = _by_names(files, folder is not None) or ([] if folder else _by_contents(files))
    return [] if folder is not None and len(found) == 1 and table_files(folder) else found


def parts_in_words(found: Sequence[Path]) -> str:
    """What files of one quantity each are, in words."""
    parts = [[file.name for file in log_files(one)] for one in found]
    if len(found) == 1:
        return f"{', '.join(parts[0][:-1])} and {parts[0][-1]} are one recording, each quantity in a file of its own"
    shown = ", ".join(one.name if "*" in one.name else one.as_posix() for one in found[:_SHOWN])
    counts = sorted({len(own) for own in parts})
    files = f"{counts[0]}" if len(counts) == 1 else f"{counts[0]} to {counts[-1]}"
    more = ", ..." if len(found) > _SHOWN else ""
    return f"{len(found)} recordings of {files} files, each quantity in a file of its own: {shown}{more}"


def _tables_in(folder: Path) -> list[Path]:
    """Tables of a folder; where it has none, of the folders in it."""
    if own := table_files(folder):
        return own
    inner = [path for path in folder.iterdir() if path.is_dir() and not path.is_symlink()]
    return [file for path in sorted(inner, key=lambda path: natural(path.name)) for file in table_files(path)]


def _by_names(files: Sequence[Path], others: bool) -> list[Path]:
    """Recordings by the words of files' names.

    Args:
        files: of one folder, or of folders in one.
        others: whether there may be files that are parts of none.
    """
    groups: dict[str, dict[Path, str]] = {}
    for file in files:
        for pattern, quantity in _patterns(file):
            groups.setdefault(pattern, {})[file] = quantity
    whole = {pattern: own for pattern, own in groups.items() if set(own.values()) >= _WHOLE}
    told = {file for own in whole.values() for file in own}
    if not whole or (not others and told != set(files)):
        whole = {}
        quantities = {file: quantity for file in files for _, quantity in _patterns(file)[:1]}
        if not others and len(quantities) == len(files) and set(quantities.values()) >= _WHOLE:
            pattern = _common(files)
            whole = {pattern: quantities} if pattern else {}
    if any(_has_all(next(file for file, q in own.items() if q == "position")) for own in whole.values()):
        return []
    if not (others or all(_is_of(pattern, files, of_quantities=True) for pattern in whole)):
        return []
    return [_folder_of(Path(pattern)) for pattern in sorted(whole, key=natural)]


def _by_contents(files: Sequence[Path]) -> list[Path]:
    """The only recording of files of which none has all quantities, where all have them once, and else nothing."""
    if len(files) > _LOOKED_AT:
        return []
    try:
        found = [survey(file).quantities & _WHOLE for file in files]
    except HaptidError:
        return []
    once = all(sum(quantity in own for own in found) == 1 for quantity in _WHOLE)
    pattern = _common(files)
    apart = once and not any(own >= _WHOLE for own in found)
    return [_folder_of(Path(pattern))] if apart and pattern and _is_of(pattern, files) else []


def _is_of(pattern: str, files: Sequence[Path], of_quantities: bool = False) -> bool:
    """Whether a path stands for these files alone, or also for some whose names tell quantities in its place."""
    extra = set(log_files(Path(pattern))) - set(files)
    return not extra or (of_quantities and all(pattern in dict(_patterns(file)) for file in extra))


def _patterns(file: Path) -> list[tuple[str, str]]:
    """Paths that have `*` in place of the words of a quantity, with that quantity: in the name or the folder."""
    made = []
    for level in (1, 2):
        parts = file.parts[-level:]
        if len(parts) < level:
            break
        name = Path(parts[0]).stem if level == 1 else parts[0]
        words = list(_WORD.finditer(name))
        told = [bool(_kind(word[0])) or word[0].lower() in _BESIDE for word in words]
        runs = [k for k, (before, now) in enumerate(pairwise([False, *told])) if now and not before]
        for first in runs:
            last = next((k for k in range(first, len(told)) if not told[k]), len(told)) - 1
            start, stop = words[first].start(), words[last].end()
            kinds = [kind for word in words[first : last + 1] if (kind := _kind(word[0]))]
            if not kinds:
                continue
            own = [kind for kind in kinds if kind != "position"]  # of `joint_torque` the last word tells
            tail = "/".join((f"{parts[0][:start]}*{parts[0][stop:]}", *parts[1:]))
            made.append(((Path(*file.parts[:-level]) / tail).as_posix(), own[-1] if own else kinds[-1]))
    return made


def _kind(word: str) -> str:
    """The quantity of a word: also times, and accelerations as "other"; empty where it tells none."""
    if is_time(word):
        return "time"
    quantity = quantity_of(word)
    return quantity if quantity != "other" else "other" if word.lower() in NEITHER else ""


def _common(files: Sequence[Path]) -> str:
    """The path with `*` where those of files differ, in whole words; empty where it is more than one name."""
    texts = [file.as_posix() for file in files]
    start = _prefix(texts)
    start = start[: max((m.end() for m in _BOUNDARY.finditer(start)), default=0)]
    end = _prefix([text[len(start) :][::-1] for text in texts])[::-1]
    cut = next((m.start() for m in _BOUNDARY.finditer(end)), None)
    end = "" if cut is None else end[cut:]
    inner = [text[len(start) : len(text) - len(end)] for text in texts]
    return f"{start}*{end}" if all(inner) and not any("/" in part for part in inner) else ""


def _prefix(texts: Sequence[str]) -> str:
    """The characters that all texts begin with."""
    low, high = min(texts), max(texts)
    return low[: next((k for k, (a, b) in enumerate(zip(low, high, strict=False)) if a != b), len(low))]


def _has_all(file: Path) -> bool:
    """Whether a file has positions and torques by itself."""
    try:
        return survey(file).quantities >= _WHOLE
    except HaptidError:
        return False


def _folder_of(pattern: Path) -> Path:
    """The folder in place of a path that stands for all of its tables."""
    tables = table_files(pattern.parent) if "*" in pattern.name and pattern.parent.is_dir() else []
    return pattern.parent if tables and set(tables) == set(log_files(pattern)) else pattern
