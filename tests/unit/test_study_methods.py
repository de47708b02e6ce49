"""The [estimate] table of a study, key by key."""

import json

import pytest
from typer.testing import CliRunner

import haptid
from haptid import estimation as e
from haptid.cli import app
from haptid.errors import StudyFileError
from small_study import write_study


@pytest.fixture
def study(tmp_path):
    """A study whose [estimate] table is the given text."""
    write_study(tmp_path)
    path = tmp_path / "study.toml"
    before = path.read_text()

    def write(text):
        path.write_text(before.partition("[estimate]")[0] + f"\n[estimate]\n{text}\n")
        return path

    return write


@pytest.mark.parametrize(
    ("text", "method"),
    [
        ("", haptid.WLS()),
        ('method = "ols"', haptid.OLS()),
        ('method = "wls"\npasses = 5', haptid.WLS(5)),
        ('method = "sur"', e.SUR()),
        ('method = "gls"\npasses = 2', e.GLS(2)),
        ('method = "irls"', e.IRLS()),
        ('method = "irls"\nloss = "huber"', e.IRLS(e.Huber())),
        ('method = "irls"\nloss = "student-t"', e.IRLS(e.StudentT())),
        ('method = "heteroscedastic"', e.Heteroscedastic()),
        ('method = "total-least-squares"', e.TLS()),
        ('method = "errors-in-variables"\nresolution = [1e-4, 2e-4]', e.ErrorsInVariables((1e-4, 2e-4))),
        ('method = "ridge"\nshare = 0.1\nstrength = 2.0', e.Ridge(0.1, 2.0)),
        ('method = "gls"\nconstraints = "physical"', haptid.PhysicallyConsistent(e.GLS())),
        ("bounds = { FC1 = { low = 0.0 } }", e.Bounds({"FC1": (0.0, None)})),
        ('equality_constraints = { "FC1 - FC2" = 0.0 }', e.EqualityConstraints({"FC1 - FC2": 0.0})),
    ],
)
def test_every_key_reaches_its_method(study, text, method):
    assert haptid.read_study(study(text)).method == method


@pytest.mark.parametrize(
    ("text", "where"),
    [
        ('method = "best"', "estimate.method"),
        ('method = "ols"\npasses = 2', "estimate.passes"),
        ('method = "wls"\nloss = "huber"', "estimate.loss"),
        ('method = "total-least-squares"\nconstraints = "physical"', "estimate"),
        ('constraints = "physical"\nequality_constraints = { FC1 = 0.0 }', "estimate.equality_constraints"),
        ("bounds = { FC1 = { low = 1.0, high = 0.0 } }", "estimate"),
        ('method = "entropic"\nintervals = "profile"', "estimate.intervals"),
    ],
)
def test_what_does_not_go_together_is_rejected(study, text, where):
    with pytest.raises(StudyFileError, match=where):
        haptid.read_study(study(text))


@pytest.mark.parametrize("method", ["gls", "irls"])
def test_the_result_says_the_method(study, tmp_path, method):
    path = study(f'method = "{method}"')
    done = CliRunner().invoke(app, ["identify", str(path), "--out", str(tmp_path / "out"), "--quiet", "--no-report"])
    assert done.exit_code == 0, done.output
    found = json.loads((tmp_path / "out" / "result.json").read_text())["estimate"]
    assert found["method"] == method
    assert found["intervals"] == "cluster-robust"
    assert found["intervals_description"].startswith("CR2 over time blocks")
