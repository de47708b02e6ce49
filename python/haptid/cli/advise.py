"""`haptid advise`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

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
    from haptid.uncertainty.figures import per_cent

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
            kinds = ", ".join(action.kind for action in after.actions)
            errors = f"{per_cent(after.after, 3)} instead of {per_cent(after.before, 3)}"
            print_lines(f"{after.study} has {kinds}: identified again, the error on unseen rows is {errors}.")
        elif apply is not None:
            out.print("Nothing is written: no change that files can hold is confirmed by identifying again.")
