"""The HTML report of one mounting: the one whose handle a hand pushes."""

from __future__ import annotations

from pathlib import Path

from haptid.demos.mountings.finding import Results
from haptid.demos.mountings.fits import Fit
from haptid.observation.observation import observe
from haptid.report import Hand, make_report
from haptid.study import LogEntry, Study
from haptid.study.identify import Identification, Run
from haptid.treatment_choice.propose import Proposal
from haptid.validation.validation import direct


def write_page(found: Results, folder: Path) -> None:
    """Write `report.html`, and the data that it can be made from again, into a folder."""
    key = found.demo.hand.mounting
    fits, felt = found.fits[key], found.felt
    title = f"{found.demo.title}: {fits.mounting.title}"
    made = identification(title, f"{key}.parquet", fits["encoders"], fits.proposal)
    pushed = Path(found.demo.hand.experiment).with_suffix(".parquet").name
    hand = Hand(pushed, felt.t, felt.modelled, measured=felt.measured)
    make_report(made, command=f"haptid demo {found.demo.name}", hands=[hand]).write(folder)


def identification(title: str, log: str, fit: Fit, proposal: Proposal) -> Identification:
    """A fit of one half of a log, validated on the other, as a study would have found it.

    Args:
        title: of the report.
        log: name of the log.
        fit: of its first half.
        proposal: the treatment of both halves, and why so.
    """
    made, model = fit.estimate, fit.estimate.model
    first = LogEntry(f"{log}, first half", "identify", None, None)
    second = LogEntry(f"{log}, second half", "validate", None, None)
    study = Study(title, Path(), model.device.name, (first, second), {}, made.method, None, None)
    runs = (
        Run(first, made.observation, direct(made), ()),
        Run(second, observe(model, fit.unseen), None, (fit.validation,)),
    )
    return Identification(study, model, proposal, made, runs)
