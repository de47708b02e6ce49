"""`haptid advise`."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from haptid.cli.common import (
    AsJson,
    DataFolder,
    Quiet,
    StudyFile,
    command,
    errors_shown,
    out,
    print_json,
    print_lines,
    progress_bars,
    progress_callback,
)

if TYPE_CHECKING:
    from haptid.advice import Advice, Applied

HELP = """\
Try changes of a study and its device on the study's own logs, and list those that are proven, by their gain.

Tried are missing terms (friction, springs, rotor inertia, ripple), signs, gains and assignments of channels, time
shifts, lengths and zeros, dead, coarse, clipped or stuck channels, contact, payloads and drift. Fits on every other
time block are judged on the blocks between. Where a change would only rescale parameters, the proof is by bodies that
can exist, or by the device file's prior bodies. What cannot be determined from the log is said.

With --apply OUT, the best combination is written as OUT/study.toml, with OUT/device.toml where the device changes, and
identified again: it is kept where this confirms it, and both errors are printed. The study itself is not changed.

Exit status: 0 on success, 2 on an error; the message says what to do.

Example: `haptid advise examples/emps/study.toml --data ../shared/data/emps --apply emps-advised`
"""


@command(HELP)
def advise(
    study: StudyFile,
    data: DataFolder = None,
    apply: Annotated[Path | None, typer.Option(help="folder for study and device with the best combination")] = None,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    from haptid.advice import advise as advised
    from haptid.advice import apply_advice as applied
    from haptid.inference.diagnosis import diagnose
    from haptid.study import read_study
    from haptid.study.identify import identify

    with errors_shown(), progress_bars(quiet or as_json) as bars:
        progress = progress_callback(bars)
        plan = read_study(study)
        identification = identify(plan, data, progress)
        progress("trying changes", 0.0)
        advice = advised(identification, diagnose(identification.estimate, None, plan.controller))
        progress("trying changes", 1.0)
        after = applied(advice, identification, apply, data) if apply is not None else None
    if as_json:
        values = advice.to_dict()
        if after is not None:
            values["applied"] = {"kinds": [a.kind for a in after.actions], "before": after.before, "after": after.after}
        print_json("advise", values)
    elif not quiet:
        none = f"None of {advice.tried} changes is proven to lower the error on unseen blocks."
        print_lines(*(advice.sentences or (none,)))
        if after is not None:
            print_lines(*written_sentences(advice, after))
        elif apply is not None:
            out.print("Nothing is written: no change that files can hold is confirmed by identifying again.")


def written_sentences(advice: Advice, made: Applied) -> Iterator[str]:
    """What was written, with its error; proofs that this error says nothing of; and what is not in it."""
    from haptid.advice.action import MASKS, WHOLE_LOG
    from haptid.inference.diagnosis.finding import joined_names
    from haptid.uncertainty.figures import per_cent

    kinds = ", ".join(action.kind for action in made.actions)
    errors = f"{per_cent(made.after, 3)} instead of {per_cent(made.before, 3)}"
    others = dict.fromkeys(action.proof for action in made.actions if action.proof != "unseen error")
    higher = f"; it is no smaller, and the proof is that of {' and '.join(others)}" if made.after >= made.before else ""
    yield f"{made.study} has {kinds}: identified again, the error on unseen rows is {errors}{higher}."
    without = [f"{a.kind} ({joined_names(a.places)})" for a in advice.combination if a.kind in MASKS and not a.edits]
    if without:
        yield f"Not in it, as no file can say it: {joined_names(without)}. Mend that, and record again."
    reversed_ = [a.kind for a in made.actions if a.kind == "torque sign" and a.proof == "unseen error"]
    if first := dict.fromkeys([*(a.kind for a in made.actions if a.kind in WHOLE_LOG), *reversed_]):
        again = f"`haptid advise {made.study}` tries them now."
        yield f"Behind a wrong {joined_names(list(first))} other changes could not be judged: {again}"
