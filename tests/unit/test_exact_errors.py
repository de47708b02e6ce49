"""What keeps groupings from being exact: each cause has its error, and `haptid model` falls back on numbers."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

import haptid
from haptid import errors
from haptid.cli import app
from haptid.dynamics.symbolic import regrouping as module
from haptid.dynamics.symbolic import regroupings
from haptid.dynamics.symbolic.arithmetic import UnluckyDrawError
from json_outputs import valid

FOUR_BAR = """
name = "four-bar"
gravity = [0, -9.81, 0]
[lengths]
arm = 0.3
coupler = 0.3
lever = 0.1
[[joints]]
name = "arm"
[[joints]]
name = "lever"
parent = "base"
[[joints]]
name = "forearm"
parent = "arm"
d = "arm"
[[joints]]
name = "coupler"
parent = "lever"
d = "lever"
[[loops]]
passive = ["forearm", "coupler"]
cut = { body_a = "coupler", frame_a = { d = "coupler" }, body_b = "forearm", frame_b = { d = "lever" } }
"""
LINK = 'name = "two links"\ngravity = [0, -9.81, 0]\n[[joints]]\nname = "1"\n[[joints]]\nname = "2"\nd = 0.25\n'


def device_of(folder: Path, text: str) -> haptid.DynamicModel:
    path = folder / "device.toml"
    path.write_text(text, encoding="utf-8")
    return haptid.DynamicModel(haptid.read_device(path))


def test_bars_that_are_equal_by_accident(tmp_path: Path) -> None:
    model = device_of(tmp_path, FOUR_BAR)
    with pytest.raises(errors.RegroupingError) as raised:
        regroupings(model)
    assert raised.value.where == ("coupler", "forearm")
    for shared in ('coupler = "arm"', 'coupler = "2*arm - arm"'):
        assert len(device_of(tmp_path, FOUR_BAR.replace("coupler = 0.3", shared, 1)).regroupings) == len(model.base)
    raw = FOUR_BAR.replace('d = "arm"', "d = 0.4").replace('{ d = "coupler" }', "{ d = 0.4 }")
    assert "darm" not in [s.name for s in device_of(tmp_path, raw).regroupings.symbols]
    assert [s.name for s in device_of(tmp_path, raw).regroupings.symbols] == ["lever", "dforearm"]


def test_angles_that_are_many(tmp_path: Path) -> None:
    joints = [f'[[joints]]\nname = "{k}"\nxyz = [0.1, 0, 0]\nrpy = [0.{k}1, 0.{k}2, 0.{k}3]\n' for k in (1, 2)]
    model = device_of(
        tmp_path, 'name = "tilted"\nconvention = "placement"\ngravity = [0, 0, -9.81]\n' + "".join(joints)
    )
    with pytest.raises(errors.RegroupingError) as raised:
        regroupings(model)
    assert (raised.value.found, raised.value.limit) == (6, 4)


def test_a_column_that_is_another_in_disguise(tmp_path: Path) -> None:
    column = '[[terms]]\nkind = "custom"\njoints = ["1"]\nname = "D1"\nunit = "N m s/rad"\nexpression = "2*v_1"\n'
    model = device_of(tmp_path, LINK + '[[terms]]\nkind = "viscous"\njoints = "all"\n' + column)
    with pytest.raises(errors.RegroupingError) as raised:
        regroupings(model)
    assert raised.value.found == (len(model.base) + 1, len(model.base))


def test_a_column_of_accelerations_that_others_make_up(tmp_path: Path) -> None:
    column = '[[terms]]\nkind = "custom"\njoints = ["1"]\nname = "J1"\nunit = "kg m^2"\nexpression = "{}"\n'
    model = device_of(tmp_path, LINK + column.format("a_1"))
    with pytest.raises(errors.RegroupingError) as raised:
        regroupings(model)
    assert raised.value.where == "J1"
    assert "J1" in "".join(device_of(tmp_path, LINK + column.format("abs(a_1)")).regroupings.names)


def test_coefficients_that_differ(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    model = device_of(tmp_path, LINK)
    exact = regroupings(model)
    wrong = exact.values.copy()
    wrong[0, exact.standard.index("M2")] += 1e-3
    monkeypatch.setitem(exact.__dict__, "values", wrong)
    with pytest.raises(errors.RegroupingError, match="M2 in ZZ1R"):
        module.check_agreement(exact, model)


def test_a_coefficient_without_a_form(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "fit_coefficient", lambda *_: None)
    with pytest.raises(errors.RegroupingError) as raised:
        regroupings(device_of(tmp_path, LINK))
    assert raised.value.where == ("ZZ1", "M2")


def test_a_relation_that_fails_its_check(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    model = device_of(tmp_path, LINK)
    found = module.fit_coefficient

    def doubled(*arguments: object) -> object:
        made = found(*arguments)  # type: ignore[arg-type]
        return type(made)(made.numerator + made.numerator)  # type: ignore[union-attr]

    monkeypatch.setattr(module, "fit_coefficient", doubled)
    with pytest.raises(errors.RegroupingError) as raised:
        regroupings(model)
    assert raised.value.where == "M2"

    def unlucky(*_: object) -> None:
        raise UnluckyDrawError

    monkeypatch.setattr(module, "_coefficients", unlucky)
    with pytest.raises(errors.RegroupingError, match="draws in a row"):
        regroupings(model)


def other_model(*arguments: str) -> str:
    done = CliRunner().invoke(app, ["model", *arguments])
    assert done.exit_code == 0, done.output
    return done.stdout


def test_model_shows_formulas_with_symbols() -> None:
    text = other_model("sr400")
    assert "ZZ2 + IA2 + ZZ8 + (M3 + M4 + M5 + M6) d3^2" in text
    assert "With d2 = 0.3, d3 = 0.45, d4 = 0.15, rl4 = 0.5, d8 = 0.2" in text
    values = valid("model", other_model("sr400", "--json"))
    row = next(p for p in values["base_parameters"] if p["name"] == "MX7R")
    assert row["formula"] == "MX7 + M8 d8 - MX8 d8/d3"
    assert row["latex"] == r"MX_{7R} = MX_{7} + M_{8} d_{8} - MX_{8} \frac{d_{8}}{d_{3}}"
    assert row["exact"] == {"MX7": "1", "MX8": "-d8/d3", "M8": "d8"}
    assert row["grouping"]["MX8"] == pytest.approx(-0.2 / 0.45)
    assert values["symbols"]["d8"] == 0.2
    assert values["notes"] == []


def test_model_falls_back_on_numbers_and_says_why(tmp_path: Path) -> None:
    device_of(tmp_path, FOUR_BAR)
    text = other_model(str(tmp_path / "device.toml"))
    assert "0.09 Mforearm" in text
    assert "with symbolic lengths" in " ".join(text.split())
    values = json.loads(other_model(str(tmp_path / "device.toml"), "--json"))
    assert "does not close" in values["notes"][0]
    assert "formula" not in values["base_parameters"][0]
