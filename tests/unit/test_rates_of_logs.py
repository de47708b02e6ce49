"""Logs of one study at different rates: the treatment that one carries is lowered to what a slower one does."""

from __future__ import annotations

from pathlib import Path

import pyarrow as pa
import pyarrow.csv
import pytest

import haptid
import small_study
from haptid.treatment_choice import propose

SLOWER = 10


def written(folder: Path, names: tuple[str, ...], given: str = "") -> haptid.Study:
    """The study with logs of this many parts of the rate, without settings but those that are given."""
    path = small_study.write_study(folder)
    for seed, name in ((1, "log.csv"), (2, "check.csv")):
        every = SLOWER if name in names else 1
        table = {key: column[::every] for key, column in small_study.columns(seed, 10.0).items()}
        pyarrow.csv.write_csv(pa.table(table), folder / name)
    text = path.read_text()
    path.write_text(text[: text.index("[treatment]")] + given)
    return haptid.read_study(path)


@pytest.mark.parametrize("slow", ["check.csv", "log.csv"])
def test_either_log_may_be_slower(tmp_path: Path, slow: str) -> None:
    """The slower one to validate had a cut-off above half the rate of its decimated rows, which was an error."""
    made = haptid.identify(written(tmp_path, (slow,)))
    assert made.unseen[0].comparable.relative < 1.0
    said = [reason for reason in made.proposal.reasons if "Hz that the treatment is for" in reason]
    assert [reason.split()[0] for reason in said] == ["check.csv"] * (slow == "check.csv")


def test_what_is_given_stays_and_is_refused_where_a_log_does_not_carry_it(tmp_path: Path) -> None:
    with pytest.raises(haptid.errors.TreatmentError, match=r"parallel_cutoff_hz is 40 Hz"):
        haptid.identify(written(tmp_path, ("check.csv",), "[treatment]\nparallel_cutoff_hz = 40\n"))
    model = haptid.DynamicModel(haptid.read_device(tmp_path / "device.toml"))
    channels = haptid.read_study(tmp_path / "study.toml").logs[0].channels
    fast, slow = (haptid.read_log(tmp_path / name, channels) for name in ("log.csv", "check.csv"))
    proposal = propose(model, fast, decimation=2)
    assert proposal.carried_by(fast) == proposal.treatment
    assert proposal.carried_by(slow).decimation == 2
    assert proposal.reference_of(fast) == proposal.reference
    assert proposal.reference_of(slow).parallel(float(slow.dt)) < 0.25 * slow.rate_hz
