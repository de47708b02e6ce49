"""The report of a demonstration's mounting is that of a study which found the same."""

from haptid.demos.phantom_configurations.fits import fitted
from haptid.demos.phantom_configurations.tables import identification
from haptid.report import make_report
from reported import found


def test_a_mounting_has_a_report_like_a_study_s():
    study = found()
    fit = fitted("encoders", study.model, [run.motion for run in study.runs])
    made = identification("A mounting", "normal.parquet", fit, study.proposal)
    assert made.meets_criteria is None
    assert [run.entry.role for run in made.runs] == ["identify", "validate"]
    sections = make_report(made).sections
    assert list(sections) == list(make_report(study).sections)
    assert sections["errors"].rows[-1]["relative"] == study.runs[1].unseen[0].relative
