"""Atomic writing of results: a folder or a file is complete or as it was, and a reader notices files of different runs.

A run writes into a scratch folder next to its destination, which is then exchanged with it in one step. The manifest,
`haptid-files.json`, has the SHA-256 of every file of a folder by sets, one for each run that wrote into it: a set with
a file that a later run writes again is replaced as a whole, so that no picture of an earlier result stays; sets of
other commands and the user's own files are kept.

Where a folder cannot be exchanged (a mount point, the current folder), its files are replaced one by one after the
manifest; until the last one is in place, readers refuse the folder.

A scratch folder is locked while its process lives. Unlocked ones are swept by the next run with the same destination.
"""

from __future__ import annotations

import ctypes
import hashlib
import json
import os
import secrets
import shutil
import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, nullcontext, suppress
from pathlib import Path

from haptid._internal.bounded_files import RESULT_FILE, read_bounded
from haptid.errors import OutputFolderError, ResultFileError

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

MANIFEST = "haptid-files.json"
# Endings of a scratch folder, and of a folder that is about to be replaced where two cannot be exchanged.
_SCRATCH, _ASIDE = ".haptid-scratch", ".haptid-aside"
# Of <fcntl.h> on Linux, and of renameatx_np(2) on macOS.
_AT_FDCWD, _EXCHANGE = -100, 2

# Paths of the files that a run wrote, relative to the folder of the manifest, with their SHA-256.
FileSet = dict[str, str]


@contextmanager
def publishing(out: Path, *, updating: bool = False) -> Iterator[Path]:
    """A scratch folder that becomes `out` if the block ends without an error.

    Args:
        out: the folder; other files in it are kept.
        updating: whether the files of the block belong to the set that is there, whose other files are kept.

    Raises:
        OutputFolderError: nothing can be written there, or a folder has the name of a file to write.
    """
    check_writable(out)
    target = out.resolve()
    try:
        with _scratch(target, target.parent if _exchangeable(target) else target) as scratch:
            yield scratch
            _seal(scratch)
            nested = scratch.parent.name.endswith(_SCRATCH)  # locked already by the run whose scratch folder it is
            with nullcontext() if nested else _locked(scratch.parent):
                _publish(scratch, target, updating)
    except OSError as error:
        raise unwritable(out, _reason(error)) from error


@contextmanager
def publishing_files(first: Path, *others: Path) -> Iterator[Path]:
    """A scratch folder whose files are moved next to each other if the block ends without an error.

    The first file is replaced in one step. Others are removed before it and written after it, so that none is ever
    beside the first one of another run; one that the block does not write stays removed.

    Args:
        first: path of the main file.
        others: paths in the same folder that belong to it.

    Raises:
        OutputFolderError: a file cannot be written there.
    """
    places = [path.resolve() for path in (first, *others)]
    target = places[0]
    try:
        for place in places:
            if place.exists() and not place.is_file():
                raise OSError(f"{place} is not a regular file")
        with _scratch(target, target.parent) as scratch:
            yield scratch
            _move(scratch, places)
    except OSError as error:
        raise unwritable(first, _reason(error), "Choose another path.") from error


def _move(scratch: Path, places: Sequence[Path]) -> None:
    """Move the files of a scratch folder to their places, from which all but the first are removed before."""
    staged = {place: file for place in places if (file := scratch / place.name).exists()}
    for place, file in staged.items():
        _synced(file)
        if place.exists():
            shutil.copymode(place, file)
    for place in places[1:]:
        place.unlink(missing_ok=True)
    for place, file in staged.items():
        os.replace(file, place)


def write_file(path: Path, text: str) -> None:
    """Write a text file in one step.

    Raises:
        OutputFolderError: it cannot be written there.
    """
    with publishing_files(path) as scratch:
        (scratch / path.resolve().name).write_text(text, encoding="utf-8", errors="backslashreplace")


def verified(path: Path, content: bytes) -> bytes:
    """The content of a file, which must be that of the run that wrote the folder; a file without a manifest passes.

    Raises:
        ResultFileError: it is not.
    """
    for known in _sets(path.parent):
        if path.name in known and known[path.name] != hashlib.sha256(content).hexdigest():
            raise ResultFileError(
                f"{path} is not the file that was written with the others of its folder: its SHA-256 differs from that "
                f"in {MANIFEST}.",
                where=str(path),
                found=hashlib.sha256(content).hexdigest(),
                limit=known[path.name],
                advice=f"Run the command again; if the file was changed on purpose, delete {path.parent / MANIFEST}.",
            )
    return content


def check_writable(out: Path) -> None:
    """Raise OutputFolderError if results could not be written, before any work is done."""
    try:
        target = out.resolve()
        if target.exists() and not target.is_dir():
            raise unwritable(out, "it is a file")
        folder = target if target.exists() else target.parent
        if not folder.is_dir():
            raise unwritable(out, f"its parent folder {folder} does not exist")
        if not os.access(folder, os.W_OK | os.X_OK):
            raise unwritable(out, f"the folder {folder} is not writable")
    except (OSError, ValueError) as error:  # a name that is too long, a zero byte
        raise unwritable(out, _reason(error)) from error


def unwritable(path: object, why: str, advice: str = "Choose another folder with --out.") -> OutputFolderError:
    """The error for a folder or file that cannot be written."""
    return OutputFolderError(f"cannot write results to {path}: {why}.", where=str(path), found=why, advice=advice)


def _reason(error: Exception) -> str:
    return getattr(error, "strerror", None) or str(error) or type(error).__name__


def _exchangeable(target: Path) -> bool:
    """Whether a folder can be replaced by renaming: no mount point, no current folder, in a writable one."""
    if not target.exists():
        return True
    try:
        holds_working_folder = Path.cwd().is_relative_to(target)
    except OSError:
        holds_working_folder = False
    return not holds_working_folder and not os.path.ismount(target) and os.access(target.parent, os.W_OK | os.X_OK)


def sweep_beside(out: Path) -> None:
    """Remove what runs that died have left beside a folder of results; nothing where there is none."""
    target = out.resolve()
    if target.parent.is_dir():
        _sweep(target, target.parent, _prefix(target))


def _prefix(target: Path) -> str:
    return f".{target.name[:60]}-"


@contextmanager
def _scratch(target: Path, folder: Path) -> Iterator[Path]:
    """A new folder in `folder`, removed at the end; those that dead runs left there for this target go first."""
    prefix = _prefix(target)
    _sweep(target, folder, prefix)
    with ExitStack() as held:
        while True:
            scratch = folder / f"{prefix}{secrets.token_hex(4)}{_SCRATCH}"
            scratch.mkdir()
            held.callback(shutil.rmtree, scratch, ignore_errors=True)
            held.enter_context(_locked(scratch))
            if scratch.exists():  # not swept by another run before it was locked
                break
        yield scratch


def _sweep(target: Path, folder: Path, prefix: str) -> None:
    """Remove what runs that died have left for a target; the target itself, if one of them had put it aside."""
    for path in list(folder.iterdir()):
        if not path.name.startswith(prefix):
            continue
        if path.name.endswith(_ASIDE):
            _restore(path, target)
            shutil.rmtree(path, ignore_errors=True)
        elif path.name.endswith(_SCRATCH):
            _remove_unlocked(path)


def _restore(aside: Path, target: Path) -> None:
    """Rename a folder that was put aside back to the target, unless there is one."""
    with _locked(aside.parent), suppress(OSError):
        if not target.exists():
            os.rename(aside, target)


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Hold the lock of a folder, which the system releases when the process dies; none where it has no such locks."""
    handle = None
    with suppress(OSError):
        if fcntl is not None:
            handle = os.open(folder, os.O_RDONLY)
            fcntl.flock(handle, fcntl.LOCK_EX)
    try:
        yield
    finally:
        if handle is not None:
            os.close(handle)


def _remove_unlocked(folder: Path) -> None:
    """Remove a folder whose lock no live process holds; none where the system has no such locks."""
    if fcntl is None:
        return
    with suppress(OSError):
        handle = os.open(folder, os.O_RDONLY)
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            shutil.rmtree(folder, ignore_errors=True)
        finally:
            os.close(handle)


def _synced(path: Path) -> None:
    """Have the system write a file to its disk, so that a rename is never there before the content."""
    with path.open("rb+") as file:
        os.fsync(file.fileno())


def _files(folder: Path) -> Iterator[Path]:
    """Files of a folder and its subfolders, except of subfolders with a manifest of their own, and no manifest."""
    for path in sorted(folder.iterdir()):
        if path.is_dir() and not path.is_symlink():
            if not (path / MANIFEST).exists():
                yield from _files(path)
        elif path.name != MANIFEST:
            yield path


def _seal(scratch: Path) -> None:
    """Write the manifest of a scratch folder that has files of its own."""
    digests: FileSet = {}
    for path in _files(scratch):
        _synced(path)
        with path.open("rb") as file:
            digests[path.relative_to(scratch).as_posix()] = hashlib.file_digest(file, "sha256").hexdigest()
    if digests:
        _write_manifest(scratch, [digests])


def _write_manifest(folder: Path, sets: list[FileSet]) -> None:
    (folder / MANIFEST).write_text(json.dumps({"schema": 1, "sets": sets}, indent=1) + "\n", encoding="utf-8")
    _synced(folder / MANIFEST)


def _sets(folder: Path) -> list[FileSet]:
    """The sets of a folder's manifest; none where it has none, or one that is damaged."""
    try:
        sets = json.loads(read_bounded(folder / MANIFEST, RESULT_FILE))["sets"]
        return [{str(name): str(digest) for name, digest in digests.items()} for digests in sets]
    except (FileNotFoundError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return []


def _publish(scratch: Path, target: Path, updating: bool) -> None:
    """Replace the target by the scratch folder and what is to be kept of the target."""
    if not target.exists():
        os.rename(scratch, target)
        return
    _check_kinds(scratch, target)
    dropped = {
        path for manifest in scratch.rglob(MANIFEST) for path in _merge(manifest.parent, scratch, target, updating)
    }
    kept = scratch.parent != target and _keep(scratch, target, dropped)
    if kept and (_exchange(scratch, target) or _exchange_in_two(scratch, target)):
        return
    for name in dropped:
        (target / name).unlink(missing_ok=True)
    for path in sorted(scratch.rglob("*"), key=lambda path: path.name != MANIFEST):
        if not path.is_dir():
            place = target / path.relative_to(scratch)
            place.parent.mkdir(parents=True, exist_ok=True)
            os.replace(path, place)


def _check_kinds(scratch: Path, target: Path) -> None:
    """Raise OSError if a file is to be written where a folder is, or a folder where a file is."""
    for path in scratch.rglob("*"):
        place = target / path.relative_to(scratch)
        if place.exists() and place.is_dir() != path.is_dir():
            kinds = ("a file", "a folder") if path.is_dir() else ("a folder", "a file")
            raise OSError(f"{place} is {kinds[0]}, {kinds[1]} of that name is to be written")


def _merge(folder: Path, scratch: Path, target: Path, updating: bool) -> Iterator[str]:
    """Merge the sets of the target's folder into the manifest of the same folder in `scratch`; yield dropped files.

    Yields:
        Paths relative to the target.
    """
    within = folder.relative_to(scratch)
    merged: FileSet = {name: digest for digests in _sets(folder) for name, digest in digests.items()}
    sets = [merged]
    for old in _sets(target / within):
        if not old.keys() & merged.keys():
            sets.append(old)
        elif updating:
            merged |= {name: digest for name, digest in old.items() if name not in merged}
        else:
            yield from ((within / name).as_posix() for name in old.keys() - merged.keys())
    _write_manifest(folder, sets)


def _keep(scratch: Path, target: Path, dropped: set[str]) -> bool:
    """Link what is to be kept of the target into the scratch folder; False where that is not possible."""

    def left_out(folder: str, names: list[str]) -> list[str]:
        within = Path(folder).relative_to(target)
        return [name for name in names if (within / name).as_posix() in dropped or _written(scratch / within / name)]

    try:
        shutil.copytree(target, scratch, symlinks=True, ignore=left_out, copy_function=_link, dirs_exist_ok=True)
    except (OSError, shutil.Error):
        return False
    return True


def _written(path: Path) -> bool:
    return path.is_symlink() or (path.exists() and not path.is_dir()) or path.name.endswith((_SCRATCH, _ASIDE))


def _link(source: str, place: str) -> None:
    """Another name for a file where the file system has links; else a copy."""
    try:
        os.link(source, place, follow_symlinks=False)
    except OSError:
        shutil.copy2(source, place)


def _exchange(scratch: Path, target: Path) -> bool:
    """Exchange two folders in one step; False where the system or the file system cannot."""
    if sys.platform not in ("linux", "darwin"):
        return False
    library, names = ctypes.CDLL(None, use_errno=True), (os.fsencode(scratch), os.fsencode(target))
    if sys.platform == "linux" and hasattr(library, "renameat2"):
        return bool(library.renameat2(_AT_FDCWD, names[0], _AT_FDCWD, names[1], _EXCHANGE) == 0)
    return hasattr(library, "renamex_np") and bool(library.renamex_np(*names, _EXCHANGE) == 0)


def _exchange_in_two(scratch: Path, target: Path) -> bool:
    """Put the target aside, then rename; False where the target cannot be renamed, as in a layer of a container.

    A run that dies in between leaves the target aside, for the next sweep.
    """
    aside = scratch.with_name(scratch.name.removesuffix(_SCRATCH) + _ASIDE)
    try:
        os.rename(target, aside)
    except OSError:
        return False
    try:
        os.rename(scratch, target)
    except OSError:
        os.rename(aside, target)
        raise
    shutil.rmtree(aside, ignore_errors=True)
    return True
