"""Published regroupings with the lengths as symbols, by exact and by numeric elimination."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

import haptid
from changed_devices import SET_B, changed
from haptid.dynamics.symbolic import regroupings

INERTIAL = ("XX", "XY", "XZ", "YY", "YZ", "ZZ", "MX", "MY", "MZ", "M", "IA")


def inertial(model: haptid.DynamicModel) -> int:
    return sum(model.device.parameters.kinds[k] in INERTIAL for k in model.regroupings.independent_columns)


@pytest.mark.parametrize(
    ("name", "count", "inertia"),
    [
        ("cea_medical_branch", 34, 23),  # Janot et al. (2007)
        ("phantom_premium_15", 14, 8),  # Cavusoglu et al. (2002), symmetric bodies
        ("phantom_premium_15_general", 24, 18),
        ("rx90", 40, 40),  # Khalil and Dombre (2002): 36, and the rotors of joints 3 to 6
        ("sr400", 42, 42),  # with 6 rotors
        ("puma560", 36, 36),
        ("arm7", 48, 48),  # 43, and the rotors of joints 3 to 7
        ("staubli_tx40", 60, 39),
        ("kuka_kr300", 59, 40),
        ("emps", 4, 1),
    ],
)
def test_number_of_base_parameters(name: str, count: int, inertia: int) -> None:
    model = haptid.DynamicModel(haptid.read_device(name))
    assert (len(model.regroupings), inertial(model)) == (count, inertia)


def table_of_regroupings(path: Path, kind: str) -> dict[tuple[str, str], str]:
    """Correct coefficients, by base parameter and parameter."""
    made = {}
    for row in csv.DictReader(path.read_text(encoding="utf-8").splitlines()):
        base, other = (row[key] for key in ("base_parameter", "regrouped_parameter"))
        if base.startswith(("fv", "fc")):
            base, other = base[:2].upper() + base[2:], other.upper()
        name = other.upper() if other.startswith(("Ia", "m")) else other
        made[base, name] = row[f"correct_coefficient_set_{kind}"]
    return made


@pytest.mark.parametrize("kind", ["A", "B"])
def test_all_86_regroupings_of_the_cea_branch_by_both_methods(kind: str, tmp_path: Path) -> None:
    """70 inertial parameters, and friction of 5 passive and 3 cut joints, viscous and dry.

    The table has two rows for a parameter in two base parameters; a pair that it does not have has coefficient zero.
    """
    model = changed("cea_medical_branch", tmp_path, *(SET_B if kind == "B" else ()))
    assert model.device.closure.relations[0] == ("q3 = -pi - q2 + q5" if kind == "A" else "q3 = -q2 + q5")
    found, numeric = model.regroupings, model.base
    table = table_of_regroupings(Path(__file__).with_name("medical_regroupings.csv"), kind)
    regrouped = 0
    for k, name in enumerate(found.standard):
        if k in found.independent_columns:
            continue
        regrouped += 1
        for row, base in enumerate(found.names):
            coefficient = found.coefficients[row].get(k)
            text = table.get((base, name), "0").replace("^", "**")
            by_name = dict(zip((s.name for s in found.symbols), (7.0, 11.0, 13.0, 17.0), strict=True))
            wanted = eval(text, {}, dict(by_name))
            assert (coefficient.value(by_name) if coefficient else 0) == pytest.approx(wanted, rel=1e-12), (base, name)
            at = eval(text, {}, dict(model.device.lengths))
            assert numeric.regrouping[row, k] == pytest.approx(at, abs=1e-9), (base, name)
    assert regrouped == 86


def test_cea_counts(tmp_path: Path) -> None:
    """No-effect list, friction and offsets, and fewer parameters without gravity or with z1 upright."""
    model = haptid.DynamicModel(haptid.read_device("cea_medical_branch"))
    found = model.regroupings
    kinds = [model.device.parameters.kinds[k] for k in found.independent_columns]
    assert sum(kind in ("FV", "FC") for kind in kinds) == 8
    assert kinds.count("OFF") == 3
    assert len(found.no_effect) == 21
    keep = ('gravity = [9.81, 0.0, 0.0]', 'gravity = [{}]')  # fmt: skip
    for gravity, count in (("0, 0, 0", 17), ("0, 0, 9.81", 21), ("3, 4, 5", 23)):
        other = changed("cea_medical_branch", tmp_path, (keep[0], keep[1].format(gravity)))
        assert inertial(other) == count, gravity


def test_formulas_are_written_as_in_the_paper() -> None:
    found = haptid.DynamicModel(haptid.read_device("cea_medical_branch")).regroupings
    text = dict(zip(found.names, found.formulas, strict=True))
    assert text["ZZ2R"] == "ZZ2 + IA2 + ZZ6 + ZZ7 + (M3 + M4 + M8 + M9) d3^2"
    assert text["XX3R"] == "XX3 - YY3 + XX5 - YY5 + XX9 - YY9 - M4 d4^2 - M6 d6^2"
    assert text["MX1R"] == "MX1 - M7 d7 + MX7 d7/d3"
    latex = dict(zip(found.names, found.latex, strict=True))
    assert latex["MX1R"] == r"MX_{1R} = MX_{1} - M_{7} d_{7} + MX_{7} \frac{d_{7}}{d_{3}}"
    texts = dict(zip(found.names, found.texts, strict=True))
    assert texts["ZZ1R"]["M4"] == "d3^2 + d4^2"
    assert texts["XX3R"]["YY3"] == "-1"


def test_rank_drops_where_a_length_is_zero(tmp_path: Path) -> None:
    """Without the lever's length its loop settles nothing, so that its relations are given."""
    model = changed(
        "cea_medical_branch",
        tmp_path,
        ("d6 = 0.06", "d6 = 0"),
        ('passive = ["3", "6"]', 'relations = ["q3 = q5 - q2 - pi", "q6 = q2 - q5"]'),
        ("guess = { 3", "# guess = { 3"),
        ('"MY5", "MY6"', '"MY5"'),
    )
    assert inertial(model) == 22


def eq_4(of: dict[str, float], L1: float, L2: float, L3: float, L5: float, L6: float) -> list[float]:
    """The parameters of Tahmasebi et al. (2005), eq. (4) with its first entry mended, gravity left out of 7 and 8."""
    ma, mc, mbe, mdf = (of[f"m{body}"] for body in ("a", "c", "be", "df"))
    inertia = {axis: {b: of[f"I{b}{axis}"] for b in ("a", "c", "be", "df")} for axis in ("xx", "yy", "zz")}
    xx, yy, zz = inertia["xx"], inertia["yy"], inertia["zz"]
    return [
        (4 * sum(yy.values()) + 4 * sum(zz.values()) + 8 * of["Iba"] + L1**2 * mc + L2**2 * ma) / 8
        + (4 * L3**2 * mc + 4 * L1**2 * ma) / 8,
        (4 * (yy["be"] - zz["be"] + yy["c"] - zz["c"]) + 4 * L1**2 * ma + L1**2 * mc) / 8,
        (4 * (yy["a"] - zz["a"] + yy["df"] - zz["df"]) - L2**2 * ma - 4 * L3**2 * mc) / 8,
        L1 * (L2 * ma + L3 * mc),
        (4 * (xx["be"] + xx["c"]) + 4 * L1**2 * ma + L1**2 * mc) / 4,
        (4 * (xx["a"] + xx["df"]) + L2**2 * ma + 4 * L3**2 * mc) / 4,
        (2 * L1 * ma + 2 * L5 * mbe + L1 * mc) / 2,
        (L2 * ma + 2 * L3 * mc - 2 * L6 * mdf) / 2,
    ]


def standard(of: dict[str, float], L1: float, L2: float, L5: float, L6: float, **_: float) -> dict[str, float]:
    """The device's standard parameters from the paper's: its x is our z, its axis along a bar our x."""
    made = {"ZZba": of["Iba"]}
    along = {"a": "yy", "c": "zz", "be": "zz", "df": "yy"}
    for body, arm in (("a", L2 / 2), ("c", L1 / 2), ("be", 0.0), ("df", 0.0)):
        other = "zz" if along[body] == "yy" else "yy"
        lever = of[f"m{body}"] * arm**2
        made[f"XX{body}"] = of[f"I{body}{along[body]}"]
        made[f"YY{body}"] = of[f"I{body}{other}"] + lever
        made[f"ZZ{body}"] = of[f"I{body}xx"] + lever
        made[f"M{body}"] = of[f"m{body}"]
        made[f"MX{body}"] = of[f"m{body}"] * arm
    made["MXbe"], made["MXdf"] = of["mbe"] * L5, -of["mdf"] * L6
    return made


def test_phantom_groupings_are_those_of_equation_4() -> None:
    """pi_1 to pi_8 are combinations of the eight groupings, for any bodies and lengths: found once, they hold again."""
    found = haptid.DynamicModel(haptid.read_device("phantom_premium_15")).regroupings
    rng = np.random.default_rng(0)
    bodies = ("a", "c", "be", "df")
    names = ["Iba", *(f"I{b}{axis}" for b in bodies for axis in ("xx", "yy", "zz")), *(f"m{b}" for b in bodies)]
    L = dict(zip(("L1", "L2", "L3", "L5", "L6"), rng.uniform(0.1, 1, 5), strict=True))

    def both(of: dict[str, float]) -> tuple[list[float], list[float]]:
        chi = standard(of, **L)
        base = [
            sum(c.value(L) * chi.get(found.standard[k], 0.0) for k, c in row.items()) for row in found.coefficients[:8]
        ]
        return base, eq_4(of, **L)

    pairs = [both(dict(zip(names, rng.uniform(0, 1, len(names)), strict=True))) for _ in range(40)]
    base, pi = (np.array(side) for side in zip(*pairs, strict=True))
    combination, _, rank, _ = np.linalg.lstsq(base[:20], pi[:20], rcond=None)
    assert rank == 8
    assert np.linalg.matrix_rank(combination) == 8
    np.testing.assert_allclose(base[20:] @ combination, pi[20:], atol=1e-10)
    beta = dict(zip(found.names, base[0], strict=False))
    assert pi[0, 4] == pytest.approx(beta["ZZbeR"])
    assert pi[0, 5] == pytest.approx(beta["ZZdfR"])
    assert pi[0, 3] == pytest.approx(2 * L["L1"] * beta["MXaR"])
    assert pi[0, 1] == pytest.approx(-beta["XXbeR"] / 2)


@pytest.mark.parametrize("name", ["cea_medical_branch", "sr400", "arm7", "staubli_tx40", "kuka_kr300"])
def test_result_does_not_depend_on_the_seed(name: str) -> None:
    model = haptid.DynamicModel(haptid.read_device(name))
    first = model.regroupings
    for seed in range(1, 6):
        again = regroupings(model, seed)
        assert again.coefficients == first.coefficients
        assert again.no_effect == first.no_effect
