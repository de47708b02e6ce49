"""Recordings of which each quantity is in a file of its own: which files belong together, as paths with one `*`."""

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

from haptid.errors import HaptidError, LogFileError
from haptid.log.formats.folders import is_pattern, log_files, matched_files, natural, root_of, table_files
from haptid.log.survey.families import MEASURED_WORDS, TREATED_WORDS, WANTED_WORDS
from haptid.log.survey.joint_names import owners
from haptid.log.survey.names import NEITHER, is_time, quantity_of, words_of
from haptid.log.survey.read import survey

# Words beside a quantity's that tell which one of its kind a file has.
_BESIDE = WANTED_WORDS | MEASURED_WORDS | TREATED_WORDS | {"joint", "joints", "motor", "est", "estimated"}
_WORD = re.compile(r"[^/_\-. ]+")
_BOUNDARY = re.compile(r"[/_\-. ]")
_WHOLE = {"position", "torque"}
# Words of joints by number.
_NUMBERED_JOINT = r"(?:joint|axis|j|a)_?\d+"
# Names of joints or limbs by number, of runs by number, and words of runs that have none.
_LIMB = re.compile(r"(?<![^\W\d_])(?:joint|axis|j|a|q|motor|servo|leg|arm|finger|limb|link)[_ ]?\d+", re.I)
_RUN = re.compile(r"(?<![^\W\d_])(?:run|trial|test|exp|take|rec|recording|session|log|episode)[_ ]?\d+", re.I)
_RUNS = frozenset({"train", "training", "test", "testing", "val", "valid", "validation", "validate", "identification"})
# Files of which each is looked at, where their names do not tell what they have.
_LOOKED_AT = 8
# Recordings that are named in a sentence.
_SHOWN = 4


def recordings(
    paths: Sequence[Path],
    joints: Sequence[tuple[str, ...]] | None = None,
    drives: Sequence[tuple[str, ...]] = (),
) -> list[Path]:
    """The recordings that files of one quantity each are parts of, each as a path with one `*`, or as their folder.

    Args:
        paths: of all of the files, or of one folder of them or of folders of them.
        joints: name of each joint, and its alias where it has one; None where no device is known. Files whose names
            differ by these, `elbow_*.csv` and `shoulder_*.csv`, are of one recording.
        drives: the same of the motors.

    Returns:
        Nothing where a file has positions and torques, where the names and contents of files do not tell that they
        belong together, or where a folder of one recording is given: it is a log itself.

    Raises:
        LogFileError: a path with one `*` would stand for other files too; or, without a device that tells whether they
            are of all joints, a path or a folder is given of files of which each has positions and torques.
    """
    if joints is None and len(paths) == 1:
        _check_apart(paths[0])
    folder = paths[0] if len(paths) == 1 and paths[0].is_dir() else None
    files = list(paths) if folder is None else _tables_in(folder)
    if len(files) < 2 or not all(file.is_file() for file in files):
        return []
    found = _by_names(files, folder is not None) or ([] if folder else _by_contents(files))
    itself = folder is not None and bool(table_files(folder))
    if len(found) > 1 and (itself or folder is None) and _are_joints(found, joints, drives):
        common = "" if itself or joints is None else _common(files)
        return [_folder_of(Path(common))] if common and _is_of(common, files) else []
    if joints is not None and (found or folder) and _positions((found or files)[0]) == 1:
        found = _runs_of_joints(found or files, joints, drives) or found
    for pattern in found:
        check_alone(pattern)
    return [_folder_of(pattern) for pattern in found] if not itself or len(found) > 1 else []


def check_alone(pattern: Path) -> None:
    """Refuse a path with one `*` that stands for the files of two recordings: `run1_*.csv` beside `run1_cold_q.csv`.

    Raises:
        LogFileError: in place of the `*`, files have what others have, and words beside it that are no quantity's.
    """
    files = dict(matched_files(pattern)) if is_pattern(pattern) else {}
    more: dict[tuple[bool, str], list[tuple[str, str]]] = {}
    for name in files:
        for cut in _BOUNDARY.finditer(name):
            for leads, own, word in (
                (True, name[cut.end() :], name[: cut.start()]),
                (False, name[: cut.start()], name[cut.end() :]),
            ):
                if own in files and not all(_tells(part) for part in _WORD.findall(word)):
                    more.setdefault((leads, word), []).append((own, name))
    for (leads, word), pairs in more.items():
        # One file more may be a signal more, `tau_sensor` beside `tau`; a number before it is of a recording.
        if len(pairs) > 1 or (leads and any(letter.isdecimal() for letter in word)):
            own, other = (files[name].relative_to(root_of(pattern)).as_posix() for name in pairs[0])
            raise LogFileError(
                f"{pattern} stands for files of two recordings, as {own} and {other}.",
                where=pattern,
                advice="Put the files of each recording into a folder of its own, and name that as the log.",
            )


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
    by_words = bool(whole) and (others or told == set(files))
    if not by_words:
        whole = {}
        quantities = {file: quantity for file in files for _, quantity in _patterns(file)[:1]}
        if not others and len(quantities) == len(files) and set(quantities.values()) >= _WHOLE:
            pattern = _common(files)
            whole = {pattern: quantities} if pattern else {}
    if any(_has_all(next(file for file, q in own.items() if q == "position")) for own in whole.values()):
        return []
    for pattern in () if others else whole:
        if not _is_of(pattern, files, of_quantities=True):
            if not by_words:
                return []
            check_alone(Path(pattern))
            extra = min(set(log_files(Path(pattern))) - set(files))
            raise LogFileError(
                f"{', '.join(file.name for file in whole[pattern])} cannot be one log by a path with `*`: {pattern} "
                f"stands for {extra.name} too.",
                where=pattern,
                advice="Put them into a folder of their own, and name that as the log.",
            )
    return [Path(pattern) for pattern in sorted(whole, key=natural)]


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
    return [Path(pattern)] if apart and pattern and _is_of(pattern, files) else []


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
        told = [_tells(word[0]) for word in words]
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


def _tells(word: str) -> bool:
    """Whether a word is that of a quantity, or tells which one of its kind."""
    return bool(_kind(word)) or word.lower() in _BESIDE


def _are_joints(
    patterns: Sequence[Path], joints: Sequence[tuple[str, ...]] | None, drives: Sequence[tuple[str, ...]]
) -> bool:
    """Whether paths are each of other joints and not of other runs.

    By the joints' names, or by as many positions in all as there are joints; without a device where they differ by
    words without numbers, since runs have numbers or dates.
    """
    texts = [pattern.as_posix() for pattern in patterns]
    if joints is None:
        start = len(_prefix(texts))
        end = len(_prefix([text[start:][::-1] for text in texts]))
        return not any(letter.isdecimal() for text in texts for letter in text[start : len(text) - end])
    names = [
        f"{pattern.parent.name}_{pattern.name}" if "*" in pattern.parent.name else pattern.name for pattern in patterns
    ]
    if any(len(owners(names, known)) == len(names) for known in (joints, drives) if known):
        return True
    return not len(joints) % len(patterns) and _positions(patterns[0]) * len(patterns) == len(joints)


def _positions(log: Path) -> int:
    """Number of positions that a log seems to have; 0 where it cannot be read."""
    try:
        found = survey(log)
    except HaptidError:
        return 0
    return sum(channel.quantity == "position" for topic in found.topics for channel in topic.channels)


def _runs_of_joints(
    patterns: Sequence[Path], joints: Sequence[tuple[str, ...]], drives: Sequence[tuple[str, ...]]
) -> list[Path]:
    """Runs of which each has files for each joint, `run1_elbow_*.csv`, `run1_wrist_*.csv`, `run2_elbow_*.csv`, ...

    Returns:
        A path for each run, `run1_*.csv`; nothing where the paths are no such runs.

    Raises:
        LogFileError: they are, and the files of one cannot be named by a path with one `*`.
    """
    texts = [f"{pattern.parent.name}/{pattern.name}" for pattern in patterns]
    every = [name for joint in (*joints, *drives) for name in joint]
    for known in ("|".join(re.escape(name) for name in sorted(every, key=len, reverse=True)), _NUMBERED_JOINT):
        own = re.compile(rf"(?<![^\W_])(?:{known})(?![^\W_])", re.I)
        runs: dict[str, dict[str, Path]] = {}
        for pattern, text in zip(patterns, texts, strict=True):
            found = {match[0].lower() for match in own.finditer(text)}
            if len(found) == 1:
                runs.setdefault(own.sub("#", text), {})[found.pop()] = pattern
        of_joints = {frozenset(run) for run in runs.values()}
        if len(runs) < 2 or len(of_joints) != 1 or sum(map(len, runs.values())) < len(patterns):
            continue
        if len(next(iter(of_joints))) == len(joints) > 1:
            return [_of_one_run(list(run.values())) for run in runs.values()]
    return []


def _of_one_run(patterns: Sequence[Path]) -> Path:
    """The path with one `*` of the files of all joints of a run."""
    files = [file for pattern in patterns for file in log_files(pattern)]
    common = _common(files)
    if not common or not _is_of(common, files):
        raise LogFileError(
            f"{patterns[0].name} and {patterns[1].name} are of two joints of one run, whose files cannot be one log by "
            "a path with one `*`.",
            where=patterns[0],
            advice="Put the files of each run into a folder of its own.",
        )
    return Path(common)


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


def _check_apart(path: Path) -> None:
    """Refuse a path with one `*`, or a folder of runs, that stands for files of which each has all by itself."""
    files = table_files(path) if path.is_dir() else log_files(path) if is_pattern(path) else []
    whole = [file for file in files[:_LOOKED_AT] if _has_all(file)] if len(files) > 1 else []
    if path.is_dir():
        apart, what = _are_runs([file.stem for file in whole]), "a folder is one log, of a file for each signal"
    else:
        apart, what = len(whole) == len(files[:_LOOKED_AT]), "`*` stands for files of one quantity each"
    if len(whole) > 1 and apart:
        raise LogFileError(
            f"{path}: {what}; {whole[0].name} and {whole[1].name} have positions and torques each.",
            where=path,
            advice="Name one of them; with --device DEVICE they are drafted as several logs, or as one where each is "
            "of other joints.",
        )


def _are_runs(stems: Sequence[str]) -> bool:
    """Whether names of files differ by numbers, or words, of runs, and not by those of joints or limbs.

    What all names have, `test_joint1` and `test_joint2` or `leg1_run1` and `leg1_run2`, tells nothing.
    """
    start = len(_prefix(stems)) if stems else 0
    end = len(_prefix([stem[start:][::-1] for stem in stems])) if stems else 0
    own = [stem[start : len(stem) - end] for stem in stems]
    numbered = any(letter.isdecimal() for text in own for letter in text)
    if all(_apart([frozenset(match[0].lower() for match in _RUN.finditer(stem)) for stem in stems])):
        return True  # of whatever limb each is: those of other runs have other times
    limbs = _apart([frozenset(match[0].lower() for match in _LIMB.finditer(stem)) for stem in stems])
    return (numbered and not (all(limbs) and len({*limbs}) == len(limbs))) or any(
        words & _RUNS for words in _apart([words_of(stem) for stem in stems])
    )


def _apart(found: Sequence[frozenset[str]]) -> list[frozenset[str]]:
    """Of each set what not all of them have."""
    common = frozenset.intersection(*found) if found else frozenset()
    return [own - common for own in found]


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
