"""Trials of advice: fits from Gram matrices are least squares, and no block's error has been minimised."""

from dataclasses import replace
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

import haptid
import small_study
from haptid.advice import Advice, Applied, advise
from haptid.advice.action import Action
from haptid.advice.columns import geometry
from haptid.advice.edits import Edit
from haptid.advice.proof import proven
from haptid.advice.ranking import Stated, in_order, stated
from haptid.advice.recorder import faults
from haptid.advice.rows import TrialRows, trial_rows
from haptid.advice.search import Proven, TriedChange, finer, large_enough
from haptid.advice.trial import Bench, Setting, Trial, gain
from haptid.cli.advise import written_sentences
from haptid.errors import LogTimeError
from haptid.inference.diagnosis.finding import Finding
from haptid.uncertainty.distributions import signed_rank_tail
from motions import motion, truth


def bench(seed=0, extra=0.0, factor=1.0, swapped=False):
    """TrialRows of two motors in 12 blocks: three base columns and one candidate, with unit noise."""
    rng = np.random.default_rng(seed)
    W, beta = rng.normal(size=(2, 1200, 4)), np.array([10.0, -20.0, 30.0, extra])
    y = np.array([factor, 1.0])[:, None] * (W @ beta) + rng.normal(size=(2, 1200))
    block = np.arange(1200) // 100
    y = y[::-1] if swapped else y
    used = np.ones((2, 1200), dtype=bool)
    rows = TrialRows(W, y, used, block, np.arange(1200.0), ((3,),), y, y, block, block)
    return rows, Bench({"used": rows.grams()}, 3, np.arange(3), np.ones(2), np.ones((2, 2)))


def test_what_applying_leaves_out_and_does_not_prove_is_said():
    """A dead channel is in no file, and a unit by prior bodies lowers no error."""
    edit = Edit("study", "set", ("a",), 1)
    unit = Action("unit", ("motor 1",), "correct", "prior bodies", 0.1, 1.0, None, 1.0, True, (edit,))
    dead = Action("dead torque", ("motor 2",), "leave out", "unseen error", 50.0, 40.0, None, 0.2, True, ())
    made = Applied(Path("out/study.toml"), (unit,), 55.0, 57.0, None)
    first, second = written_sentences(Advice((unit, dead), 55.0, 40.0, (), 9), made)
    assert first.endswith("57.0 % instead of 55.0 %; it is no smaller, and the proof is that of prior bodies.")
    assert second.startswith("Not in it, as no file can say it: dead torque (motor 2).")
    (only,) = written_sentences(Advice((unit,), 55.0, 40.0, (), 9), replace(made, after=40.0))
    assert only.endswith("40.0 % instead of 55.0 %.")


def test_what_was_not_judged_behind_a_wrong_mounting_is_to_be_tried_again():
    """An arm on a wall lacked constant torques too, which showed in a second run that nothing asked for."""
    mounting = Action("mounting", ("the base",), "set", "unseen error", 109.0, 5.9, 1.0, 0.99, True, ())
    made = Applied(Path("out/study.toml"), (mounting,), 106.0, 5.04, None)
    *_, last = written_sentences(Advice((mounting,), 109.0, 5.9, (), 9), made)
    assert (
        last
        == "Behind a wrong mounting other changes could not be judged: `haptid advise out/study.toml` tries them now."
    )


def test_rows_without_candidates_are_fitted_as_those_with_them():
    """Positions are tried on matrices of the base columns alone; with every candidate's they fill gigabytes."""
    rows, made = bench(factor=3.0)
    small = replace(rows, W=rows.W[:, :, :3])
    made = made.with_rows("moved", small.grams())
    for change in (Setting(), Setting(free=(0,)), Setting(source=(1, 0))):
        moved = replace(change, rows="moved")
        np.testing.assert_allclose(made.run(moved).errors, made.run(change).errors, rtol=1e-10)
        together = made.run(replace(moved, terms=(((3,),),)))
        np.testing.assert_allclose(together.errors, made.run(change).errors, rtol=1e-10)
        assert made.p_value(together) == 1


def test_a_fit_is_least_squares():
    rows, made = bench(extra=1.0)
    fitted = made.fit(Setting(terms=(((3,),),)), np.arange(12))
    expected = np.linalg.lstsq(rows.W.reshape(-1, 4), rows.y.ravel())[0]
    np.testing.assert_allclose(fitted.theta, expected, rtol=1e-8)


def test_fits_on_one_bench_do_not_share_what_differs_between_them():
    """Torque channels, factors, weights and blocks, one after another, each against least squares."""
    rows, plain = bench(extra=1.0)
    weights, term = np.array([1.0, 3.0]), (((3,),),)
    made = replace(plain, weights=weights)
    every, half = np.arange(12), np.arange(0, 12, 2)
    for setting, blocks, factor in (
        (Setting(), every, 1.0),
        (Setting(terms=term), every, 1.0),
        (Setting(terms=term, source=(1, 0)), every, 1.0),
        (Setting(terms=term), half, 1.0),
        (Setting(factors=((0, 2.0),)), every, 2.0),
        (Setting(), every, 1.0),
    ):
        columns = [0, 1, 2, *(setting.terms and (3,))]
        fit, source = np.isin(rows.block, blocks), list(setting.source or (0, 1))
        W = rows.W[:, fit][:, :, columns] * (weights * [factor, 1.0])[:, None, None]
        y = rows.y[source][:, fit] * weights[:, None]
        expected = np.linalg.lstsq(W.reshape(-1, len(columns)), y.ravel())[0]
        np.testing.assert_allclose(made.fit(setting, blocks).theta, expected, rtol=1e-7)


def test_errors_are_those_of_fits_on_the_other_half():
    rows, made = bench(extra=1.0)
    trial = made.run(Setting())
    for half in (0, 1):
        fit, unseen = rows.block % 2 == half, rows.block % 2 != half
        beta = np.linalg.lstsq(rows.W[:, fit, :3].reshape(-1, 3), rows.y[:, fit].ravel())[0]
        e = rows.y[:, unseen] - rows.W[:, unseen, :3] @ beta
        np.testing.assert_allclose(trial.errors[1 - half :: 2].sum(axis=0), (e**2).sum(axis=1), rtol=1e-6)


def test_a_change_that_takes_all_error_away_is_proven_however_the_blocks_differ():
    """A channel a thousand times too large was not named: its blocks' errors spread by half of their sum."""
    rng = np.random.default_rng(1)
    errors = np.exp(2.5 * rng.normal(size=(24, 1)))
    fitted = SimpleNamespace(columns=np.arange(3), factors=np.ones(1))
    before, after = Trial(Setting(), errors, fitted), Trial(Setting(), 0.01 * errors, fitted)
    made = gain(before, after)
    assert made.share == pytest.approx(0.99)
    assert made.share < 3.5 * made.se  # the test of the mean has p above 0.0005
    assert made.p == pytest.approx(2 * 0.5**24)


def test_a_contact_that_spoils_two_blocks_of_many_is_worth_leaving_out():
    """All blocks gain, and two of them most of it: their mean is no two standard errors from zero."""
    errors = np.full((24, 1), 8.0)
    errors[[0, 6]] = 260.0
    fitted = SimpleNamespace(columns=np.arange(3), factors=np.ones(1))
    before, after = (Trial(Setting(), factor * errors, fitted) for factor in (1.0, 0.01))
    made = gain(before, after)
    assert made.share < 2 * made.se
    assert large_enough(made)
    rng = np.random.default_rng(4)
    chance = Trial(Setting(), errors * (1.0 - 0.6 * rng.choice([-1.0, 1.0], size=(24, 1))), fitted)
    assert not large_enough(gain(before, chance))


def test_signed_ranks_are_those_of_scipy():
    rng = np.random.default_rng(2)
    for n in (1, 2, 9, 24, 40):
        differences = rng.normal(0.4, 1.0, n)
        expected = stats.wilcoxon(differences, alternative="greater", method="exact").pvalue
        assert signed_rank_tail(differences) == pytest.approx(expected, rel=1e-9)
    assert signed_rank_tail(np.zeros(5)) == 1.0


def test_gains_that_are_not_there_have_their_level():
    rng, rare = np.random.default_rng(3), 0
    fitted = SimpleNamespace(columns=np.arange(3), factors=np.ones(1))
    for _ in range(2000):
        before, after = (Trial(Setting(), rng.chisquare(4, size=(24, 2)), fitted) for _ in range(2))
        rare += gain(before, after).p < 0.01
    assert stats.binom.sf(rare - 1, 2000, 0.01) > 1e-3


def test_tests_of_columns_that_are_not_there_have_their_level():
    benches = [bench(seed)[1] for seed in range(300)]
    p = [made.p_value(made.run(Setting(terms=(((3,),),)))) for made in benches]
    assert 3 <= sum(value < 0.05 for value in p) <= 30


def test_what_the_simulated_log_has_is_taken_off_and_asked_for_only_where_it_decides():
    rows, plain = bench(extra=0.2)
    asked = []

    def simulated():
        asked.append(True)
        return replace(rows, y=0.5 * rows.y).whole.grams()  # half of the column's parameter is an artefact

    made = replace(plain, artefact=simulated)
    trial, setting = made.run(Setting(terms=(((3,),),))), Setting(terms=(((3,),),))
    less, without = made.p_value(trial), plain.p_value(plain.run(setting))
    assert without < less < 1
    t = trial.whole.theta[3] / made.standard_errors(trial)[0]
    assert stats.t.ppf(less / 2, 11) / stats.t.ppf(without / 2, 11) == pytest.approx(0.5, rel=0.05)
    assert t == pytest.approx(-stats.t.ppf(without / 2, 11), rel=0.05)
    asked.clear()
    assert made.p_value(trial, 0.5 * without) == without  # a lower bound, and above the limit: enough to know
    assert not asked
    assert made.p_value(trial, 2 * without) == less
    assert asked


def test_how_the_simulated_logs_vary_with_the_encoders_steps_is_variance():
    """Of few logs: their variance counts with their degrees of freedom, by Welch and Satterthwaite."""
    rows, plain = bench(extra=0.2)
    setting, spread = Setting(terms=(((3,),),)), np.array([-0.1, -0.05, 0.05, 0.1])
    trial = plain.run(setting)
    simulated = tuple(replace(rows, y=shift * rows.W[:, :, 3]).whole.grams() for shift in spread)
    made = replace(plain, roundings=lambda: simulated)
    of_blocks, of_steps = plain.standard_errors(trial)[0] ** 2, spread.var(ddof=1)
    whole = of_blocks + of_steps
    dof = whole**2 / (of_blocks**2 / plain._clustered(trial)[1] + of_steps**2 / 3)
    expected = 2 * stats.t.sf(trial.whole.theta[3] / np.sqrt(whole), dof)
    assert made.p_value(trial) == pytest.approx(expected, rel=1e-6)
    assert plain.p_value(trial) < 1e-3 < made.p_value(trial)


def test_a_gain_by_chance_proves_no_term():
    """Halves of a log that pass through other states: each fit's error on the other half is one error for all blocks.

    A column that does nothing makes it smaller by chance, in all blocks alike, and their scatter does not show that.
    """
    rng, draws, proofs, term = np.random.default_rng(8), 200, [], Setting(terms=(((4,),),))
    block, used = np.arange(480) // 20, np.ones((1, 480), dtype=bool)
    for _ in range(draws):
        x = rng.uniform(-0.2, 1, 480) * np.where(block % 2, 1, -1)
        W = np.stack([np.ones(480), x, x**2, x**3, np.abs(x)], axis=1)[None]
        y = rng.normal(size=(1, 480))
        rows = TrialRows(W, y, used, block, np.arange(480.0), ((4,),), y, y, block, block)
        made = Bench({"used": rows.grams()}, 4, np.arange(4), np.ones(1), np.ones((1, 1)))
        trial = made.run(term)
        proofs.append((gain(made.run(Setting()), trial).p < 0.01, made.p_value(trial) < 0.01))
    by_gain, by_parameters = np.sum(proofs, axis=0)
    most = stats.binom.ppf(0.9999, draws, 0.01)
    assert by_parameters <= most
    assert by_gain > 3 * most


@pytest.mark.parametrize("kind", ["stribeck", "load friction", "presliding"])
@pytest.mark.parametrize("size", [0.5, -0.5])
def test_friction_that_gives_energy_has_another_cause(kind, size):
    """In logs with noise inside the loop wrong delays and noise that is fed back look like such terms."""
    made = bench(extra=size)[1]
    one = TriedChange(kind, ("motor 1",), Setting(terms=(((3,),),)))
    found = proven(SimpleNamespace(candidates=(one,), bench=made, base=lambda: made.run(Setting())))
    assert [each.candidate for each in found] == [one] * (size > 0)


@pytest.mark.parametrize(("kind", "tested"), [("length", False), ("spring", True)])
def test_what_is_alone_and_too_small_is_not_tested(kind, tested):
    """A spring at one joint may be one of several; no action is a length that takes one per cent off."""
    asked = []
    made = replace(bench(extra=0.1)[1], artefact=lambda: asked.append(True))
    one = TriedChange(kind, ("there",), Setting(terms=(((3,),),)))
    assert proven(SimpleNamespace(candidates=(one,), bench=made, base=lambda: made.run(Setting()))) == []
    assert bool(asked) is tested


@pytest.mark.parametrize(("longest", "believed"), [(1.0, True), (0.4, False)])
def test_a_length_is_not_corrected_by_more_than_half_of_the_longest(tmp_path, longest, believed):
    """The column's parameter is a correction of 0.27 m or so."""
    joints = f'name = "1"\n[[joints]]\nname = "2"\na = {longest}\n[[joints]]\nname = "3"\na = 0.1\n'
    head = 'schema = 1\nname = "arm"\ngravity = [0, -9.81, 0]\nconvention = "dh"\n[[joints]]\n'
    (tmp_path / "arm.toml").write_text(head + joints)
    model = haptid.DynamicModel(haptid.read_device(tmp_path / "arm.toml"))
    (which,) = (what for what, _ in geometry(model) if what.key == ("joints", 2, "a"))
    made = bench(extra=0.27)[1]
    one = TriedChange("length", (which.name,), Setting(terms=(((3,),),)), geometry=which)
    found = proven(SimpleNamespace(candidates=(one,), bench=made, base=lambda: made.run(Setting())))
    assert [each.candidate for each in found] == [one] * believed


def test_no_artefact_makes_several_columns_more_significant_than_the_bound():
    """Columns that are alike have opposite errors: to take one off alone can make the other one significant."""
    rng = np.random.default_rng(3)
    rows, plain = bench(seed=5)
    W = np.concatenate([rows.W, rows.W[:, :, 3:] + 0.1 * rng.normal(size=(2, 1200, 1))], axis=2)
    rows = replace(rows, W=W, groups=((3, 4),))
    setting, bounds = Setting(terms=(((3, 4),),)), []
    for taken in ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (0.3, 0.9), (1.0, 1.0)):
        made = replace(plain, grams={"used": rows.grams()})
        trial = made.run(setting)
        theta = np.concatenate([np.zeros(3), taken * trial.whole.theta[3:]])
        simulated = replace(rows, y=np.einsum("mrp,p->mr", rows.W, theta)).whole.grams()
        p = replace(made, artefact=lambda simulated=simulated: simulated).p_value(trial)
        bounds.append(made.p_value(trial, 0.0))
        assert bounds[-1] <= p * (1 + 1e-6)
    assert len(set(bounds)) == 1


def test_what_is_there_is_found_with_its_gain():
    _, made = bench(extra=1.0)
    base, more = made.run(Setting()), made.run(Setting(terms=(((3,),),)))
    assert made.p_value(more) < 1e-4
    assert gain(base, more).share == pytest.approx(0.5, abs=0.1)
    assert gain(base, base).share == 0


@pytest.mark.parametrize("factor", [-1.0, 0.001, 1.3, 1000.0])
def test_factors_are_found(factor):
    _, made = bench(factor=factor)
    assert made.run(Setting(free=(0,))).whole.factors[0] == pytest.approx(factor, rel=0.05, abs=0.03)


def test_swapped_channels_are_found():
    _, made = bench(swapped=True)
    assert gain(made.run(Setting()), made.run(Setting(source=(1, 0)))).share > 0.99


def test_rows_of_many_logs_are_as_many_as_those_of_a_long_one(monkeypatch):
    monkeypatch.setattr("haptid.inference.diagnosis.subsample.MOST_SAMPLES", 20_000)
    model = haptid.DynamicModel(haptid.read_device("arm3"))
    beta = truth(model)
    every, long = (
        [finer(motion(model, beta, seed=k, seconds=seconds)) for k in range(count)]
        for count, seconds in ((30, 2.0), (1, 60.0))
    )
    many, one = (trial_rows(model, motions, beta) for motions in (every, long))
    assert many.W.shape[1] == pytest.approx(one.W.shape[1], rel=0.25)
    assert np.unique(many.log).size >= 20


def log(position, torque):
    n = len(position)
    channels = haptid.Channels(
        position=haptid.Signal(("q",), "rad"), torque=haptid.Signal(("u",), "N m"), rate_hz=1000.0
    )
    return haptid.Log("x.csv", "", np.arange(n) / 1000, position[:, None], torque[:, None], channels)


def test_faults_of_channels_are_seen_and_good_channels_have_none():
    t = np.arange(4000) / 1000
    rng = np.random.default_rng(0)
    q, u = np.sin(6 * t), np.cos(6 * t) + 0.01 * rng.normal(size=4000)
    assert not list(faults(log(q, u)))
    assert not list(faults(log(1e-4 * np.round(1e4 * q), u)))
    assert [f.kind for f in faults(log(q, np.where(t > 1.0, 0.0, u)))] == ["dead torque"]
    assert [f.kind for f in faults(log(q, np.clip(u, -0.98, 0.98)))] == ["clipped torque"]
    assert [f.kind for f in faults(log(q, 0.1 * np.round(10 * u)))] == ["coarse torque"]
    stuck = q.copy()
    stuck[2000:2100] = stuck[2000]
    (fault,) = faults(log(stuck, u))
    assert fault.kind == "stuck position"
    assert fault.samples[2000:2100].all()
    assert fault.samples.sum() < 110


@pytest.mark.parametrize("dwell", [0.05, 0.2, 0.4])
@pytest.mark.parametrize(
    "way", [lambda u: 10 * u**3 - 15 * u**4 + 6 * u**5, lambda u: 2 * u**2 - (2 * u - 1).clip(0) ** 2]
)
def test_a_joint_that_is_held_between_two_motions_is_not_stuck(way, dwell):
    """A counter that loses what passes goes on at speed; motion from point to point sets off slowly."""
    t = np.arange(4000) / 1000
    x = way((t - 1.0).clip(0, 0.3) / 0.3) + way((t - 1.3 - dwell).clip(0, 0.3) / 0.3)
    held = 1e-4 * np.round(1e4 * x)
    assert not list(faults(log(held, np.cos(t))))
    lost = np.concatenate([x[:1150], np.full(200, x[1149]), x[1150:-200]])
    assert [f.kind for f in faults(log(1e-4 * np.round(1e4 * lost), np.cos(t)))] == ["stuck position"]


@pytest.mark.parametrize("rounding", [0.0, 1e-13])
def test_a_position_that_stops_at_once_for_good_is_stuck_and_one_that_is_held_is_not(rounding):
    """An encoder that fails at 3 s of 6 s; a joint that is brought to rest there; also in a log that was resampled."""
    t = np.arange(6000) / 1000
    q, u = np.sin(4 * t), np.cos(4 * t) + 0.01 * np.random.default_rng(0).normal(size=6000)
    failed = np.where(t < 3.0, q, q[3000]) + rounding * np.random.default_rng(1).normal(size=6000)
    (fault,) = faults(log(failed, u))
    assert (fault.kind, fault.channel) == ("stuck position", 0)
    assert fault.share == pytest.approx(0.5, abs=0.01)
    late = np.where(t > 3.0, q, q[3000]) + rounding * np.random.default_rng(1).normal(size=6000)
    assert [fault.kind for fault in faults(log(late, u))] == ["stuck position"]
    speed = 4 * np.cos(4 * t) * np.clip((3.0 - t) / 0.5, 0.0, 1.0)  # within half a second
    for step in (0.0, 1e-4):
        held = np.cumsum(speed) / 1000
        held = np.round(held / step) * step if step else held
        assert not list(faults(log(held, u)))


@pytest.mark.parametrize("rate", [200, 1000])
def test_a_quick_motion_between_long_holds_is_none_of_a_stuck_position(rate):
    """In a slow log it bends more than all other motion, and yet slows down."""
    t = np.arange(60 * rate) / rate
    slow = 0.5 * np.sin(2 * np.pi * 0.1 * t) * np.clip((30 - t) / 5, 0, 1)
    u = ((t - 40.0) / 0.3).clip(0, 1)
    x = np.round((slow + 0.4 * (10 * u**3 - 15 * u**4 + 6 * u**5)) / 1e-4) * 1e-4
    assert not list(faults(log(x, np.cos(t))))


def test_parts_of_a_log_are_left_out_with_a_split():
    t = np.arange(100) / 1000
    whole = log(np.sin(t), np.cos(t))
    part = whole.without([(0.0495, 0.0595)])
    assert part.segments == ((0, 50), (50, 90))
    np.testing.assert_array_equal(part.t[50:], whole.t[60:])
    assert whole.without([]) is whole
    with pytest.raises(LogTimeError, match="leaves no part"):
        whole.without([(-1.0, 1.0)])


def proven_change(kind, left, places, columns=3):
    """A change that leaves a share of the squared errors, with what is stated of it where one motor is all."""
    noise = np.random.default_rng(4).uniform(0.9, 1.1, (24, 2))
    before, trial = (
        Trial(Setting(), noise, None),
        Trial(Setting(), left * noise, SimpleNamespace(columns=np.arange(columns))),
    )
    made = Proven(TriedChange(kind, places, Setting()), trial, gain(before, trial))
    return made, Stated(10.0, 10.0 * np.sqrt(left), 0.1, None)


def kinds(found):
    return [one.candidate.kind for one in in_order(found)]


def test_coulomb_friction_comes_before_what_refines_it():
    """Load-dependent friction explains much of dry friction that the model lacks, and here a little more."""
    load, dry = (
        proven_change("load friction", 0.2, ("motor 1", "motor 2")),
        proven_change("coulomb", 0.4, ("motor 2",)),
    )
    spring, elsewhere = proven_change("spring", 0.3, ("motor 1",)), proven_change("coulomb", 0.5, ("motor 3",))
    assert kinds([dry, spring, load]) == ["coulomb", "load friction", "spring"]
    assert kinds([elsewhere, load]) == ["load friction", "coulomb"]


def test_actions_are_in_the_order_of_the_errors_that_are_stated():
    """They were in that of the errors in units of each motor's residual, which no sentence has."""
    large, _ = proven_change("spring", 0.5, ("motor 1",))
    small, _ = proven_change("ripple", 0.3, ("motor 2",))
    shown, less, of_one = Stated(10.0, 6.0, 0.1, None), Stated(10.0, 8.0, 0.1, None), Stated(60.0, 20.0, 0.1, 1)
    assert kinds([(small, less), (large, shown)]) == ["spring", "ripple"]
    assert kinds([(small, of_one), (large, less)]) == ["spring", "ripple"]  # what shows in the error of all comes first
    simple, _ = proven_change("offset", 0.51, ("motor 1",), columns=2)
    assert kinds([(large, shown), (simple, Stated(10.0, 6.1, 0.1, None))]) == ["offset", "spring"]


@pytest.mark.parametrize(
    ("left", "shown", "places", "first"),
    [
        (0.53, 6.25, ("motor 1",), "offset"),  # 94 % of the gain: the spring's rest is far outside of the range
        (0.57, 6.6, ("motor 1",), "spring"),  # 85 %
        (0.53, 6.25, ("motor 2",), "spring"),  # on another joint
        (0.08, 6.25, ("motor 1",), "spring"),  # of a far rest all the same, as it leaves nearly nothing
    ],
)
def test_a_constant_torque_comes_before_a_spring_that_has_its_gain_from_it(left, shown, places, first):
    """Of two public arms' logs the first advice was a spring without torque at 2.6 to 5.9 times half the range."""
    spring = proven_change("spring", 0.5 if left > 0.5 else 0.05, ("motor 1",))[0], Stated(10.0, 6.0, 0.1, None)
    offset = proven_change("offset", left, places, columns=2)[0], Stated(10.0, shown, 0.1, None)
    assert kinds([spring, offset])[0] == first


def test_the_error_of_a_motor_is_stated_where_a_change_does_not_show_in_that_of_all():
    device = SimpleNamespace(torque_units=("N m",) * 2, free_rows=(False,) * 2)
    model = SimpleNamespace(device=device, known_rows=range(2))
    squares = np.tile([1e4, 1.0], (24, 1))
    bench = SimpleNamespace(weights=np.array([0.01, 1.0]), sizes=lambda _: squares.sum(axis=0))
    noise = np.random.default_rng(0).uniform(0.5, 1.5, (2, 24, 2))
    search = SimpleNamespace(model=model, bench=bench)
    before, after = Trial(Setting(), 0.1 * noise[0], None), Trial(Setting(), 0.1 * noise[1] * [1.0, 0.2], None)
    made = stated(search, before, after)
    assert made.motor == 1
    assert made.before == pytest.approx(100 * np.sqrt(0.1 * noise[0, :, 1].mean()))
    everywhere = stated(search, before, Trial(Setting(), 0.01 * noise[0], None))
    assert everywhere.motor is None
    assert everywhere.size > made.size
    # Of one motor that is the error of all: a payload that is clear by two standard errors was behind a drift.
    device.torque_units, device.free_rows, model.known_rows = ("N m",), (False,), range(1)
    bench.weights, squares = np.ones(1), np.ones((24, 1))
    assert (
        stated(search, *(Trial(Setting(), 0.1 * noise[k, :, :1] * left, None) for k, left in ((0, 1), (1, 0.9)))).motor
        is None
    )


@pytest.mark.parametrize(("share", "refused"), [(0.1, False), (0.2, True)])
def test_the_rate_is_blamed_where_it_limits_the_filter(tmp_path: Path, share: float, refused: bool) -> None:
    """The filter is lower than the motion in both cases; only in one is the motion too fast for the log's rate."""
    small_study.write_study(tmp_path)
    found = haptid.identify(haptid.read_study(tmp_path / "study.toml"))
    (motion, *_) = found.estimate.observation.motions
    limit = motion.treatment.parallel(motion.dt)
    assert limit is not None
    fast = share / motion.dt
    assert fast > limit
    told = advise(replace(found, proposal=replace(found.proposal, bandwidth_hz=fast)))
    assert any("faster than" in sentence for sentence in told.sentences) is refused
    assert (told.tried == 0) is refused


@pytest.mark.parametrize(("factor", "kinds"), [(1000.0, ["unit"]), (0.037, []), (-1.2, ["torque sign"])])
def test_a_unit_is_advised_where_a_known_confusion_explains_the_size(factor, kinds, monkeypatch):
    """Beside another motor whose unit is wrong, a motor that hardly turns its link has some factor or other."""
    module = import_module("haptid.advice.advise")
    left = {"mended": 0.2}
    monkeypatch.setattr(module, "unseen_percent", lambda _model, _bench, trial, _k: left.get(trial, 1.0))
    monkeypatch.setattr(module, "right_signs", lambda *_: frozenset())
    device = SimpleNamespace(motors=(SimpleNamespace(gear_ratio=1.0, torque_constant=1.0),))
    motors = (SimpleNamespace(label="motor 1"),)
    diagnosis = SimpleNamespace(
        findings=(Finding("units and signs", "bad", {"factor motor 1": factor}, ""),),
        estimate=SimpleNamespace(
            model=SimpleNamespace(device=device), observation=SimpleNamespace(motors=motors, motions=())
        ),
    )
    torques = SimpleNamespace(of=lambda motor: motor)
    search = SimpleNamespace(model=SimpleNamespace(device=device), bench=None, rows=None, torques=torques)
    assert [action.kind for action in module._units(search, ("", ""), diagnosis, set())] == kinds
    # Not where the parameters make up for what another proven change mends, nor beside a gain of the channel.
    assert not list(module._units(search, ("", "mended"), diagnosis, set()))
    assert not list(module._units(search, ("", ""), diagnosis, {("gain", "motor 1")}))
