"""Arithmetic in device files: values as written, and nothing is executed."""

from __future__ import annotations

import gc
import math
import weakref
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from haptid.device import expressions
from haptid.device.expressions import column, number, relation
from haptid.device.toml.errors_at import Place
from haptid.errors import DeviceError, DeviceFileError

HERE = Place("arm.toml", "joints[0].alpha")
LENGTHS = {"d3": 0.45, "_r": -2.0}

HOSTILE = [
    "__import__('os').system('true')",
    "().__class__",
    "open('x')",
    "[1 for _ in (1,)]",
    "lambda: 1",
    "d3.real",
    "d3 if d3 else 1",
    "1 < 2",
    "'a'",
    "True",
    "1j",
    "...",
    "d3 @ d3",
    "1 // 2",
    "9**9**9",
    "(d3 := 3)",
    "f'{d3}'",
    "sin(1, 2)",
    "*d3",
    "",
    "d3\x00",
    "(" * 300,
    "-" * 399 + "1",
    "1" * 390,
    "x" * 5000,
]


def outcome(read: Callable[[], object]) -> str:
    """The sentence of the error, or nothing where there is none; any other exception is a failure."""
    try:
        made = read()
    except DeviceError as error:
        return str(error)
    return "" if made is not False else "False"


@st.composite
def sums(draw: st.DrawFn) -> tuple[str, float]:
    """Nested arithmetic, and its value worked out alongside."""
    leaves = st.one_of(
        st.floats(0.1, 9).map(lambda x: (repr(x), x)),
        st.integers(1, 9).map(lambda x: (str(x), float(x))),
        st.sampled_from([("pi", math.pi), ("d3", 0.45), ("_r", -2.0)]),
    )

    def grow(inner: st.SearchStrategy[tuple[str, float]]) -> st.SearchStrategy[tuple[str, float]]:
        pairs = st.tuples(inner, inner)
        return st.one_of(
            pairs.map(lambda p: (f"({p[0][0]} + {p[1][0]})", p[0][1] + p[1][1])),
            pairs.map(lambda p: (f"({p[0][0]}) - ({p[1][0]})", p[0][1] - p[1][1])),
            pairs.map(lambda p: (f"({p[0][0]}) * ({p[1][0]})", p[0][1] * p[1][1])),
            inner.map(lambda x: (f"-({x[0]})", -x[1])),
            inner.map(lambda x: (f"({x[0]}) / 4", x[1] / 4)),
        )

    return draw(st.recursive(leaves, grow, max_leaves=6))


@given(sums())
def test_arithmetic_means_what_is_documented(case: tuple[str, float]) -> None:
    text, value = case
    assert number(text, LENGTHS, HERE) == pytest.approx(value, rel=1e-12, abs=1e-12)


@pytest.mark.parametrize("text", HOSTILE)
def test_nothing_but_arithmetic_is_read(text: str) -> None:
    for read in (
        lambda: number(text, LENGTHS, HERE),
        lambda: column(text, ["1"], LENGTHS, HERE).values({}, 3),
        lambda: relation(f"q1 = {text}", ["q1", "q2"], LENGTHS, HERE),
    ):
        refused = outcome(read)
        # Powers in columns, and a long row of signs, are arithmetic after all.
        assert refused.startswith("arm.toml: joints[0].alpha: ") or (not refused and text[0] in "9-")


@given(st.text(max_size=60))
def test_any_text_is_a_number_or_one_clear_error(text: str) -> None:
    assert outcome(lambda: math.isfinite(number(text, LENGTHS, HERE))) != "False"


@given(st.floats(-3, 3), st.floats(-3, 3), st.floats(-3, 3))
def test_relations_are_linear_maps(a: float, b: float, c: float) -> None:
    left, polynomial = relation(f"q3 = ({a!r})*(q2 - {b!r}*q7)/2 + {c!r} - -q2", ["q2", "q3", "q7"], {}, HERE)
    assert left == "q3"
    linear = polynomial.linear
    assert linear is not None
    assert linear.constant == pytest.approx(c)
    assert linear.factors.get("q2", 0.0) == pytest.approx(a / 2 + 1)
    assert linear.factors.get("q7", 0.0) == pytest.approx(-a * b / 2)


@pytest.mark.parametrize(
    "text", ["q3 = q2**0.5", "q3 = 1/q2", "q3 = q2 / 0", "q3 + 1 = q2", "q3", "q3 = q2 = q7", "2 = q2", "= q2"]
)
def test_relations_that_are_no_polynomials_are_rejected(text: str) -> None:
    with pytest.raises(DeviceFileError, match="q3 = pi/2 - q2"):
        relation(text, ["q2", "q3", "q7"], {}, HERE)


def test_columns_see_the_joints_and_the_lengths() -> None:
    made = column("d3*sin(3*q_2) + v_2**2 - abs(a_1)/2 + sign(v_2)", ["1", "2"], LENGTHS, HERE)
    rng = np.random.default_rng(0)
    motion = {f"{x}_{j}": rng.normal(size=5) for x in "qva" for j in "12"}
    want = 0.45 * np.sin(3 * motion["q_2"]) + motion["v_2"] ** 2 - np.abs(motion["a_1"]) / 2 + np.sign(motion["v_2"])
    np.testing.assert_allclose(made.values(motion, 5), want, rtol=1e-14)
    np.testing.assert_array_equal(column("2", ["1"], {}, HERE).values(motion, 5), np.full(5, 2.0))


def test_names_that_are_not_there_get_a_suggestion() -> None:
    with pytest.raises(DeviceFileError, match='Did you mean "d3"'):
        number("d33 + 1", LENGTHS, HERE)
    with pytest.raises(DeviceFileError, match='Did you mean "q_2"'):
        column("cos(q2)", ["1", "2"], {}, HERE)
    with pytest.raises(DeviceFileError, match='Did you mean "sqrt"'):
        column("sqr(q_2)", ["1", "2"], {}, HERE)


@pytest.mark.parametrize("text", ["1/0", "1e30*1e300*d3", "1e31", 1e300, float("nan"), float("inf")])
def test_values_without_a_number_are_rejected(text: str) -> None:
    with pytest.raises(DeviceFileError):
        number(text, LENGTHS, HERE)


def test_nothing_is_kept_of_expressions_that_are_gone() -> None:
    """A process that reads devices for ever takes no more memory."""
    made = column("d3 * tanh(v_arm)", ["arm"], LENGTHS, HERE)
    np.testing.assert_allclose(made.values({"v_arm": np.ones(3)}, 3), 0.45 * math.tanh(1.0))
    assert made.tree in expressions._FUNCTIONS
    ours = weakref.ref(made.tree)
    del made
    gc.collect()
    assert ours() is None
