"""Apply advice: the best combination written as files, and identified again before it is kept."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

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
    before = _worst(found)
    for actions in _combinations(advice):
        made = _tried(actions, found, out, data, before)
        if made is None:
            continue
        if (first := _first(actions)) is None:
            return made
        alone = _tried(first, found, out, data, before)
        if alone is not None and alone.after <= made.after:
            return alone
        return _tried(actions, found, out, data, before)  # written again
    if out.is_dir() and not _others(out):
        shutil.rmtree(out, ignore_errors=True)
    return None


def _tried(
    actions: tuple[Action, ...], found: Identification, out: Path, data: Path | None, before: float
) -> Applied | None:
    """Actions written and identified; None where that does not confirm them."""
    edits = [edit for action in actions for edit in action.edits]
    kinds = ", ".join(action.kind for action in actions)
    path = written(found.study, data, edits, out, f"{found.study.path.name}, changed by haptid advise: {kinds}")
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


def _others(folder: Path) -> bool:
    """Whether a folder has other files than those that are written."""
    return any(path.name not in ("study.toml", "device.toml") for path in folder.iterdir())
