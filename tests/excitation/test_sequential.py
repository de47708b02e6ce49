"""The next motion given the logs so far: what is predicted of it is what the bench then gives."""

import base64
import json
import re
from dataclasses import replace

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pytest
from typer.testing import CliRunner

import haptid
from haptid import errors
from haptid.cli import app
from haptid.dynamics.regressor import rows
from haptid.experiment import bench
from haptid.experiment.excitation import (
    FourierSeries,
    Information,
    LargestDeviation,
    Limits,
    LogInformation,
    ScaledCondition,
    Search,
    design_excitation,
    next_motions,
    of_buffer,
    sequential,
)
from haptid.experiment.excitation.sequential import standard_errors_of
from haptid.results.information import log_information
from json_outputs import valid
from small_study import DEVICE, FRICTION, HEAD, KD, KP, two_links
from true_parameters import true_parameters

NOISE, RATE = 0.05, 250.0
SERIES = FourierSeries(8.0, 0.2, 5)
WITHIN = Limits(((-1.2, 1.2), (-1.2, 1.8)), (3.0,), acceleration=(30.0,))
SEARCH = Search(tries=200, seed=1)
# Standard errors of some ten effective blocks scatter by a quarter; those of before and after are in the ratio, and
# what serial correlation adds is not the same along another motion.
MEDIAN, EACH = 1.5, 3.0


def recorded(folder, name, kind, seed):
    """A log of the two links along a motion, as a file."""
    model = two_links()
    setup = bench.Setup(
        model,
        true_parameters(model, **FRICTION),
        bench.Controller(KP, KD, rate_hz=RATE),
        bench.Encoders(),
        bench.Amplifiers(noise=(NOISE,)),
        physics=bench.Physics(5e-4),
    )
    made = bench.simulate(
        setup, bench.plan(kind, model, setup.dt, np.random.default_rng(seed)), np.random.default_rng(seed)
    )
    columns = {"t": made.t, "q1": made.position[:, 0], "q2": made.position[:, 1]}
    columns |= {"tau1": made.command[:, 0], "tau2": made.command[:, 1]}
    pyarrow.csv.write_csv(pa.table(columns), folder / name)


def identified(folder, *names):
    """The result of a study of some of these logs."""
    (folder / "device.toml").write_text(DEVICE)
    entries = "".join(f'[[logs]]\npath = "{name}"\n' for name in names)
    treatment = "[treatment]\ncutoff_hz = 20\ndecimation = 5\n"
    (folder / "study.toml").write_text(HEAD + entries + treatment)
    found = haptid.Result.of(haptid.identify(haptid.read_study(folder / "study.toml")))
    found.save(folder / "-".join(names).replace(".csv", ""))
    return haptid.Result.load(folder / "-".join(names).replace(".csv", ""))


@pytest.fixture(scope="module")
def campaign(tmp_path_factory):
    """A first log along a poor motion, and its result."""
    folder = tmp_path_factory.mktemp("campaign")
    slow = bench.Multisine(8.0, (0.0, 0.5), (0.6, 0.5), speed=(0.8, 0.8))
    recorded(folder, "first.csv", slow, 1)
    return folder, identified(folder, "first.csv")


@pytest.fixture(scope="module")
def further(campaign):
    return next_motions(log_information(campaign[1]), SERIES, WITHIN, accuracy=3.0, search=SEARCH)


def test_predicted_intervals_come_true_on_the_bench(campaign, further):
    folder, first = campaign
    recorded(folder, "second.csv", further.motions[0].kind, 2)
    both = log_information(identified(folder, "first.csv", "second.csv"))
    now = dict(zip(first.names, log_information(first).relative_widths().tolist(), strict=True))
    then = dict(zip(first.names, both.relative_widths().tolist(), strict=True))
    assert max(further.after) < 0.5 * max(further.before)
    ratios = []
    for name, before, after in further.table():
        assert before == pytest.approx(now[name])
        ratios.append(then[name] / after)
        assert 1 / EACH < ratios[-1] < EACH
    assert 1 / MEDIAN < np.median(ratios) < MEDIAN
    assert max(then[name] for name in further.names) < 0.5 * max(further.before)
    assert set(first.names) - set(further.names) == {"MY1"}  # its true value is zero: no torque


def test_motions_are_ranked_by_intervals_behind_the_treatment(campaign, monkeypatch):
    ranks = []

    def spy(*args, rank, **more):
        ranks.append(rank)
        return design_excitation(*args, rank=rank, **more)

    monkeypatch.setattr(sequential, "design_excitation", spy)
    known = log_information(campaign[1])
    made = next_motions(known, SERIES, WITHIN, search=Search(tries=60))
    next_motions(replace(known, treated=None), SERIES, WITHIN, search=Search(tries=60))
    assert ranks[0](made.motions[0]) == pytest.approx(max(made.after))
    assert ranks[1] is None


def test_time_needed_is_that_of_the_accuracy(campaign, further):
    known = log_information(campaign[1])
    more = known.of_motion(further.motions[0])
    times = further.needed / further.seconds
    widths = known.relative_widths(more * times, further.needed)[further_order(further, known)]
    assert widths.max() == pytest.approx(3.0, rel=0.02)
    np.testing.assert_allclose(
        known.relative_widths(more, further.seconds)[further_order(further, known)], further.after
    )
    assert "3 % is reached after" in further.sentences[1]
    far = next_motions(known, SERIES, WITHIN, accuracy=1e-3, search=replace(SEARCH, tries=100))
    assert np.isinf(far.needed)
    assert "out of reach" in far.sentences[1]
    near = next_motions(known, SERIES, WITHIN, accuracy=1e3)
    assert near.reached
    assert near.motions == ()
    assert "is reached" in near.sentences[0]


def further_order(found, known):
    return [known.model.base.names.index(name) for name in found.names]


def test_it_beats_the_motion_that_knows_nothing(campaign, further):
    """Against the D-optimal motion of the same family, limits and number of evaluations, and the same once more."""
    known = log_information(campaign[1])
    plain = design_excitation(
        known.model, SERIES, WITHIN, beta=known.values, criterion=Information(), noise=(NOISE,), search=SEARCH
    )
    which = further_order(further, known)
    other = known.relative_widths(known.of_motion(plain), plain.seconds)[which]
    assert max(further.after) < max(other)
    again = known.relative_widths(known.information, known.seconds)[which]
    assert max(further.after) < max(again)


def test_information_is_that_of_the_explicit_rows_where_the_treatment_is_not_known(campaign, further):
    known = replace(log_information(campaign[1]), treated=None)
    made = further.motions[0].trajectory(1 / SEARCH.rows_hz)
    model = known.model
    W = rows(model, *(np.ascontiguousarray(x.T) for x in (made.q, made.qd, made.qdd)))
    W = np.einsum("apk,pb->akb", W, model.device.parameters.S[:, list(model.base.independent_columns)])
    W = W / (known.noise * np.sqrt(SEARCH.rows_hz))[:, None, None]
    W = W.reshape(-1, len(known.values))
    np.testing.assert_allclose(
        known.of_motion(further.motions[0]), W.T @ W, rtol=0.01, atol=1e-6 * np.abs(W.T @ W).max()
    )


def test_single_parameters_and_several_motions(campaign):
    known = log_information(campaign[1])
    few = replace(SEARCH, tries=60)
    one = next_motions(known, SERIES, WITHIN, parameters=("FV1",), search=few)
    assert one.names == ("FV1",)
    assert one.accuracy is one.needed is None
    two = next_motions(known, SERIES, WITHIN, parameters=("FV1",), count=2, search=few)
    assert len(two.motions) == 2
    assert two.seconds == pytest.approx(2 * one.seconds)
    assert two.after[0] < one.after[0] < one.before[0]
    assert two.motions[0].kind == one.motions[0].kind


@pytest.mark.parametrize("samples", [501, 1500, 3001])
def test_a_series_fits_its_buffer(samples):
    made = of_buffer(FourierSeries(), samples, 250.0)
    model = two_links()
    found = design_excitation(model, made, WITHIN, beta=np.ones(len(model.base)), search=Search(tries=40, rows_hz=50.0))
    assert len(found.trajectory(1 / 250.0)) == samples
    assert made.highest_hz <= FourierSeries().highest_hz + 1e-9
    assert (made.seconds - 2 * made.ramp) * made.fundamental_hz == pytest.approx(1.0)
    with pytest.raises(errors.SettingError, match="too short"):
        of_buffer(FourierSeries(), 200, 250.0)


def test_standard_errors_of_information():
    rng = np.random.default_rng(0)
    W = rng.normal(size=(40, 5)) * [1e-6, 1.0, 1e4, 1.0, 1e-2]
    expected = np.sqrt(np.diag(np.linalg.inv((W / W.std(axis=0)).T @ (W / W.std(axis=0))))) / W.std(axis=0)
    np.testing.assert_allclose(standard_errors_of(W.T @ W), expected, rtol=1e-8)
    W[:, 3] = W[:, 1]
    found = standard_errors_of(W.T @ W)
    assert np.isinf(found[[1, 3]]).all()
    assert np.isfinite(found[[0, 2, 4]]).all()
    assert np.isinf(standard_errors_of(np.diag([1.0, 0.0]))[1])


def test_weighted_cost_with_earlier_logs_has_its_slope():
    rng, step = np.random.default_rng(1), 1e-6
    V, D = rng.normal(size=(9, 4)), rng.normal(size=(4, 4))
    C, D = V.T @ V, D + D.T
    criterion = LargestDeviation((1.0, 0.0, 3.0, 0.5))
    for power in (2.0, 8.0):
        _, B = criterion.smooth(C, power)
        difference = (criterion.smooth(C + step * D, power)[0] - criterion.smooth(C - step * D, power)[0]) / (2 * step)
        assert (B * D).sum() == pytest.approx(difference, rel=1e-6)
    assert criterion.smooth(C, np.inf)[0] == pytest.approx(
        np.log(np.max(np.sqrt(np.diag(np.linalg.inv(C))) * criterion.weights))
    )


def test_what_cannot_be_continued(campaign):
    folder, first = campaign
    known = log_information(first)
    with pytest.raises(errors.SettingError, match="accuracy"):
        next_motions(known, SERIES, WITHIN, accuracy=0.0)
    with pytest.raises(errors.UnknownNameError, match="ZZ9"):
        next_motions(known, SERIES, WITHIN, parameters=("ZZ9",))
    with pytest.raises(errors.SettingError, match="fixed in the result"):
        next_motions(replace(known, estimated=known.estimated[1:]), SERIES, WITHIN, parameters=(first.names[0],))
    with pytest.raises(errors.SettingError, match="no parameter has a value"):
        next_motions(LogInformation.none(known.model), SERIES, WITHIN)
    with pytest.raises(errors.SettingError, match="condition number"):
        design_excitation(known.model, SERIES, WITHIN, criterion=ScaledCondition(), information=known.information)
    with pytest.raises(errors.ModelMismatchError, match="other base parameters"):
        log_information(first, haptid.DynamicModel(haptid.read_device("phantom_premium_15")))
    lone = haptid.Result.model_validate(json.loads((folder / "first" / "result.json").read_text()))
    lone._model = first.model
    with pytest.raises(errors.ResultFileError, match="the information of its logs"):
        log_information(lone)


def test_the_command_continues_a_campaign(campaign, tmp_path):
    folder, _ = campaign
    options = ("--centre", "0,0.3", "--stroke", "1.2", "--speed", "3", "--seconds", "8", "--max-evaluations", "40")
    common = ("excite", str(folder / "device.toml"), "--after", str(folder / "first"), *options)
    done = CliRunner().invoke(app, [*common, "--accuracy", "4", "--out", str(tmp_path / "next.toml"), "--json"])
    assert done.exit_code == 0, done.output
    found = valid("excite", done.stdout)
    assert {"name", "before_percent", "after_percent"} == set(found["intervals"][0])
    assert found["seconds_needed"] > 0
    assert bench.read_experiment(tmp_path / "next.toml").kind.fundamental_hz == 0.1
    page = tmp_path / "motions.html"
    more = (
        "--page",
        str(page),
        "--motions",
        "2",
        "--buffer",
        "1000",
        "--rate-hz",
        "250",
        "--out",
        str(tmp_path / "few.toml"),
    )
    done = CliRunner().invoke(app, [*(x for x in common if x not in ("--seconds", "8")), *more])
    assert done.exit_code == 0, done.output
    assert "Widest 95 % interval so far" in done.stdout
    for name in ("few-1.csv", "few-2.csv"):
        assert len((tmp_path / name).read_text().splitlines()) == 1001
    drawn = re.search(r'id="drawings"[^>]*>(.*?)</script>', page.read_text(), re.DOTALL)
    charts = json.loads(drawn[1])
    assert {"information", "q-0-0-0", "qd-1-1-0", "tau-0-1-0"} <= set(charts)
    low, high = (np.frombuffer(base64.b64decode(one["y"]["f32"]), "<f4") for one in charts["q-0-0-0"]["series"][1:])
    planned = np.frombuffer(base64.b64decode(charts["q-0-0-0"]["series"][0]["y"]["f32"]), "<f4")
    assert low[0] == pytest.approx(-1.2)
    assert (low <= planned).all()
    assert (planned <= high).all()
    assert np.ptp(planned) > 0.1
    assert len(charts["information"]["series"]) == 2
    done = CliRunner().invoke(app, [*common, "--accuracy", "500", "--out", str(tmp_path / "none.toml")])
    assert done.exit_code == 0, done.output
    assert "is reached" in done.stdout
    assert not (tmp_path / "none.toml").exists()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--accuracy", "5"), "--after or --like too"),
        (("--after", "none", "--criterion", "condition"), "no criterion"),
        (("--motions", "2", "--criterion", "d-optimal"), "no criterion"),
        (("--buffer", "100", "--seconds", "8"), "one of them"),
        (("--after", "none"), "there is no such file"),
    ],
)
def test_options_that_do_not_fit(options, words, tmp_path):
    within = ("--centre", "0,0.2,0.3", "--stroke", "0.4", "--speed", "3", "--out", str(tmp_path / "x.toml"))
    done = CliRunner().invoke(app, ["excite", "phantom_premium_15", *options, *within])
    assert done.exit_code == 2
    assert words in done.stderr
