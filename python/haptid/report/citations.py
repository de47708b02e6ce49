"""Papers to cite for the methods of a result, as BibTeX."""

from __future__ import annotations

from collections.abc import Iterator
from importlib.resources import files

from haptid.estimation import OLS, PhysicallyConsistent
from haptid.report.source import ReportSource
from haptid.results.tables import weighting


def bibtex(source: ReportSource) -> str:
    """Entries of the methods that were used, in the order of the pipeline."""
    known = entries()
    return "\n\n".join(known[key] for key in dict.fromkeys(_used(source)))


def entries() -> dict[str, str]:
    """Every entry by its key."""
    text = files("haptid.report").joinpath("templates/methods.bib").read_text(encoding="utf-8")
    parts = [part.strip() for part in text.split("\n\n") if part.strip()]
    return {part[part.index("{") + 1 : part.index(",")]: part for part in parts}


def _used(source: ReportSource) -> Iterator[str]:
    """Keys of the methods that were used."""
    estimate, model = source.estimate, source.estimate.model
    if model.device.convention == "modified-dh":
        yield "khalil1986"
    yield "gautier1991"
    if model.device.closure.cuts:
        yield "khalil1995"
    yield "gautier2013"
    yield from () if isinstance(weighting(estimate.method), OLS) else ("gautier2001",)
    yield "bell2002"
    if isinstance(estimate.method, PhysicallyConsistent):
        yield from ("sousa2014", "wensing2018")
    yield "belsley1980"
    if any(source.decompositions):
        yield "tahmasebi2005"
    if model.device.handle is not None:
        yield "janot2007"
