"""Several logs of one device: scatter of the parameters between days, and intervals that hold a repeat."""

from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console
from scipy import stats

import haptid
from days import Days
from haptid.report.tables import show_identification
from haptid.results import Result
from haptid.study.identify import identify
from haptid.study.read import read_study
from motions import multisine
from small_study import DEVICE, HEAD, two_links
from true_parameters import true_parameters


@pytest.fixture(scope="module")
def model():
    return two_links()


def day(model, rng, size=1.0, seed=1):
    return Days(model, size).log(rng, seed)


def estimated(model, motions, method=None):
    return haptid.estimate(haptid.observe(model, *motions), method or haptid.OLS())


def test_of_logs_of_one_motion_it_is_students_interval(model):
    """Balanced: the mean of the logs' own estimates, their sample variance, Student's interval of one more."""
    rng = np.random.default_rng(0)
    logs = [day(model, rng) for _ in range(4)]
    logs = [replace(log, q=logs[0].q) for log in logs]
    found = estimated(model, logs)
    each = np.array([estimated(model, [log]).beta for log in logs])
    between = found.between_logs
    np.testing.assert_allclose(found.beta, each.mean(axis=0), rtol=1e-9)
    np.testing.assert_allclose(between.across.se, each.std(axis=0, ddof=1) / 2, rtol=1e-6)
    np.testing.assert_allclose(between.effective, 4.0)
    np.testing.assert_allclose(between.across.dof, 3.0)
    inside = np.array([estimated(model, [log]).se ** 2 for log in logs]).sum(axis=0) / 16
    np.testing.assert_allclose(between.within.se**2, inside, rtol=1e-6)
    half = stats.t.ppf(0.975, 3) * each.std(axis=0, ddof=1) * np.sqrt(1 + 1 / 4)
    far = between.across.se > 2 * found.se
    assert far.any()
    np.testing.assert_allclose(between.repeat_conf_int()[far, 1] - found.beta[far], half[far], rtol=1e-6)
    lower, upper = between.conf_int().T
    assert (lower <= found.conf_int()[:, 0]).all()
    assert (upper >= found.conf_int()[:, 1]).all()


def test_fewer_than_three_logs_say_nothing(model):
    rng = np.random.default_rng(0)
    assert estimated(model, [day(model, rng), day(model, rng)]).between_logs is None


def test_two_time_ranges_of_one_log_are_one_day(model):
    """Blocks are told apart by the file that they are from."""
    rng = np.random.default_rng(0)
    rows = haptid.observe(model, *(day(model, rng) for _ in range(3)))
    names = sorted({block.log for block in rows.blocks})
    moved = tuple(replace(b, log=names[0], start=b.start + 100) if b.log == names[1] else b for b in rows.blocks)
    assert haptid.estimate(rows, haptid.WLS()).between_logs.logs == 3
    assert haptid.estimate(replace(rows, blocks=moved), haptid.WLS()).between_logs is None


@pytest.mark.parametrize(("size", "logs"), [(1.0, 4), (0.0, 3)])
def test_they_hold_a_repeat_on_another_day(model, size, logs):
    """Drift of friction, temperature and home offset between logs of different motions; and nothing of it.

    With drift the intervals of blocks do not hold the mean; without it, no interval is narrower than theirs.
    """
    rng, runs, p = np.random.default_rng(logs), 30, len(model.base)
    truth = Days(model).beta
    held, repeat, blocks, false = np.zeros(p), np.zeros(p), np.zeros(p), 0
    for _ in range(runs):
        motions = [day(model, rng, size, seed) for seed in range(logs)]
        again = estimated(model, [day(model, rng, size, logs)]).beta
        found = estimated(model, motions, haptid.WLS())
        between = found.between_logs
        (low, high), (low_again, high_again), (a, b) = (
            ends.T for ends in (between.conf_int(), between.repeat_conf_int(), found.conf_int())
        )
        held += (low <= truth) & (truth <= high)
        repeat += (low_again <= again) & (again <= high_again)
        blocks += (a <= truth) & (truth <= b)
        false += bool(between.differs())
    # Of parameters with correlated errors the mean share of a run counts once.
    assert held.mean() > 0.93 * runs
    assert repeat.mean() > 0.93 * runs
    assert stats.binom.cdf(held.min(), runs, 0.95) > 1e-3 / p
    assert stats.binom.cdf(repeat.min(), runs, 0.95) > 1e-3 / p
    if size:
        assert blocks.mean() < 0.85 * runs
    else:
        assert stats.binom.sf(false - 1, runs, 0.05) > 1e-3


def test_a_log_that_alone_tells_a_parameter_leaves_it_empty(model):
    """Two logs move the first joint alone: from one log nothing can be said of another day."""
    rng = np.random.default_rng(0)
    whole, *still = (day(model, rng, seed=seed) for seed in range(3))
    still = [replace(log, q=log.q * [1, 0], rates=tuple(rate * [1, 0] for rate in log.rates)) for log in still]
    found = estimated(model, [whole, *still])
    between = found.between_logs
    alone = [found.names[k] for k in between.across.unbounded]
    assert "FC2" in alone
    assert "FV1" not in alone
    assert not np.isfinite(between.repeat_conf_int()[list(between.across.unbounded)]).any()
    assert np.isnan(between.deviation[list(between.across.unbounded)]).all()


def test_a_study_shows_and_stores_them(tmp_path):
    """Table, note, result file and CSV; the drifting friction is named."""
    (tmp_path / "device.toml").write_text(DEVICE)
    model, logs = two_links(), ""
    for k in range(3):
        rng = np.random.default_rng(k)
        chi = true_parameters(model, FV=0.05, FC=0.2 * (1 + 0.3 * (k - 1)))
        q, qd, qdd = multisine(2, 6.0, 2e-3, 1)
        tau = haptid.inverse_dynamics(model, model.base.of(chi), q, qd, qdd)
        tau += 0.01 * rng.standard_normal(tau.shape)
        table = np.column_stack([2e-3 * np.arange(len(q.T)), q.T, tau.T])
        np.savetxt(tmp_path / f"{k}.csv", table, delimiter=",", header="t,q1,q2,tau1,tau2", comments="")
        logs += f'[[logs]]\npath = "{k}.csv"\n'
    (tmp_path / "study.toml").write_text(f"{HEAD}{logs}[treatment]\ncutoff_hz = 30\ndecimation = 5\n")
    found, console = identify(read_study(tmp_path / "study.toml")), Console(record=True, width=160)
    show_identification(console, found)
    assert "Between 3 logs" in console.export_text()
    made = Result.of(found)
    made.save(tmp_path / "out")
    assert Result.load(tmp_path / "out").to_dict() == made.to_dict()
    friction = made.estimate.parameters[found.estimate.names.index("FC1")].between_logs
    assert friction.p < 1e-3
    assert friction.deviation == pytest.approx(0.06, rel=0.2)
    assert any("FC1" in note and "quote the interval of a repeat" in note for note in made.notes)
    head, *rows = (tmp_path / "out" / "parameters.csv").read_text().splitlines()
    assert head.endswith("log_to_log_deviation,repeat_low,repeat_high")
    assert not any(row.endswith(",,") for row in rows)
