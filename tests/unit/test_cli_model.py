"""`haptid model`: parameters that cannot be kept, and what is printed once."""

import json

from typer.testing import CliRunner

from haptid.cli import app


def call(*arguments):
    return CliRunner().invoke(app, list(arguments))


def names(done):
    return [parameter["name"] for parameter in json.loads(done.stdout)["base_parameters"]]


def test_a_parameter_without_effect_is_reported_to_be_kept_in_vain():
    done = call("model", "cea_medical_branch", "--keep", "MX4", "--json")
    assert done.exit_code == 0
    assert "MX4 cannot be a base parameter: it has no effect" in done.stderr
    assert "MX4" not in names(done)


def test_a_parameter_that_others_to_be_kept_tell_is_reported_to_be_kept_in_vain():
    done = call("model", "cea_medical_branch", "--keep", "FC2", "--keep", "FC7", "--json")
    assert "FC7 cannot be a base parameter: it depends linearly" in done.stderr
    assert "FC2 cannot" not in done.stderr


def test_nothing_is_reported_of_what_is_kept():
    assert call("model", "cea_medical_branch", "--keep", "FC7", "--json").stderr == ""


def test_relations_of_loops_are_printed_once():
    printed = call("model", "cea_medical_branch").stdout
    assert printed.count("q3 = -pi - q2 + q5") == 1
    assert "closed within" in printed
