"""Apply advice: the best combination written as files, and identified again before it is kept."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from haptid._internal.late import dataclass
from haptid.advice.action import MASKS, Action, Advice
from haptid.advice.edits import written
from haptid.errors import HaptidError
from haptid.study.identify import Identification, identify
from haptid.study.read import read_study


@dataclass(frozen=True, eq=False)
class Applied:
    """A combination of actions, identified.

    Attributes:
        study: path of the study file.
        actions: that are in it.
        before, after: worst error of a log on unseen rows, per cent; of the rows of the fit where none is unseen.
        identification: of the changed study.
    """

    study: Path
    actions: tuple[Action, ...]
    before: float
    after: float
    identification: Identification


def apply_advice(advice: Advice, found: Identification, out: Path, data: Path | None = None) -> Applied | None:
    """Write study and device with the best combination of actions that identifying it again confirms.

    The trials fit on rows that are treated as before; identifying again also chooses the treatment again. Where this
    does not lower the error, the combination is tried without rows left out, then its actions one by one. Where its
    first action alone leaves no more, the others were of the treatment, and are not kept. Proofs that are not of the
    error are kept as they are.

    Args:
        advice: of the identification.
        found: what was identified.
        out: folder of the new files.
        data: where the study's relative log paths start; the study's own folder where None.

    Raises:
        OutputFolderError: the folder cannot be written.
    """
    folder = _Folder(out)
    try:
        made = _confirmed(advice, found, folder, data)
    except BaseException:
        folder.restore()
        raise
    if made is None:
        folder.restore()
    return made


class _Folder:
    """The folder of the new files; it becomes what it was where none is confirmed, and before others are written."""

    def __init__(self, path: Path) -> None:
        self.path, self.new = path, not path.exists()
        own = [path / name for name in ("study.toml", "device.toml")]
        self.before = {one: one.read_bytes() if one.is_file() else None for one in own}

    def restore(self) -> None:
        """Take back what was written; what cannot be written at all is an error of the writing."""
        for path, content in self.before.items():
            with suppress(OSError):
                if content is None:
                    path.unlink()
                else:
                    path.write_bytes(content)
        if self.new:
            with suppress(OSError):
                self.path.rmdir()


def _confirmed(advice: Advice, found: Identification, folder: _Folder, data: Path | None) -> Applied | None:
    """What is written at last; None where identifying again confirms nothing."""
    before = _worst(found)
    for actions in _combinations(advice):
        made = _tried(actions, found, folder, data, before)
        if made is None:
            continue
        if (first := _first(actions)) is None:
            return made
        alone = _tried(first, found, folder, data, before)
        if alone is not None and alone.after <= made.after:
            return alone
        _write(actions, found, folder, data)
        return made
    return None


def _write(actions: tuple[Action, ...], found: Identification, folder: _Folder, data: Path | None) -> Path:
    """The path of the study with the actions, in place of what was tried before."""
    edits = [edit for action in actions for edit in action.edits]
    kinds = ", ".join(action.kind for action in actions)
    folder.restore()
    return written(found.study, data, edits, folder.path, f"{found.study.path.name}, changed by haptid advise: {kinds}")


def _tried(
    actions: tuple[Action, ...], found: Identification, folder: _Folder, data: Path | None, before: float
) -> Applied | None:
    """Actions written and identified; None where that does not confirm them."""
    path = _write(actions, found, folder, data)
    try:
        made = identify(read_study(path))
    except HaptidError:
        return None
    after = _worst(made)
    if after < before or any(action.proof != "unseen error" for action in actions):
        return Applied(path, actions, before, after, made)
    return None


def _first(actions: tuple[Action, ...]) -> tuple[Action, ...] | None:
    """Rows left out and the first other action; None where there is one such action, or a proof not of the error."""
    others = [action for action in actions if action.kind not in MASKS]
    if len(others) < 2 or any(action.proof != "unseen error" for action in actions):
        return None
    return tuple(action for action in actions if action.kind in MASKS or action is others[0])


def _worst(found: Identification) -> float:
    """The largest error of a log on unseen rows, or without any on those of the fit, per cent."""
    unseen = [v.comparable.relative for v in found.unseen]
    return max(unseen or [run.fit_errors.relative for run in found.runs if run.fit_errors])


def _combinations(advice: Advice) -> Iterator[tuple[Action, ...]]:
    """The best combination that files can say, then smaller ones."""
    every = tuple(action for action in advice.combination if action.edits)
    rest = tuple(action for action in every if action.kind not in MASKS)
    tried: list[tuple[Action, ...]] = []
    for actions in (every, rest, *((action,) for action in every)):
        if actions and actions not in tried:
            tried.append(actions)
            yield actions
