"""Signs in words of drives: read back, recognised by the steps, drafted."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest

from haptid.log import Channels, Signal, read_log
from haptid.log.registers import Register, register_of
from haptid.log.survey import survey

T = np.arange(0.0, 20, 0.02)
LOAD = np.round(400 * np.sin(3 * T) + 30 * np.sin(11 * T))


def word(values: np.ndarray, register: Register) -> np.ndarray:
    """The values as the drive writes them, by integer arithmetic and not as haptid reads them."""
    whole = values.astype(int)
    if register.sign_bit is not None:
        return np.array([abs(v) | ((v < 0) << register.sign_bit) for v in whole])
    return np.array([v & ((1 << (register.word_bits or 0)) - 1) for v in whole])


REGISTERS = [
    Register(sign_bit=10),
    Register(sign_bit=11),
    Register(sign_bit=15),
    *(Register(word_bits=b) for b in (16, 32)),
]


@pytest.mark.parametrize("register", REGISTERS, ids=str)
def test_signs_come_back_and_are_recognised(tmp_path: Path, register: Register) -> None:
    column = word(LOAD, register)
    np.testing.assert_array_equal(register.signed(column.astype(float)), LOAD)
    assert register_of(column) == register
    path = tmp_path / "servo.csv"
    position = np.round(2048 + 600 * np.sin(1.3 * T)).astype(int)
    table = np.column_stack([T, position, column])
    np.savetxt(path, table, ["%.3f", "%d", "%d"], ",", header="t,pos (1),load (1)", comments="")
    drafted = tomllib.loads(survey(path).table)["channels"]
    key, value = str(register).split(" = ")
    assert drafted["torque"][key] == int(value)
    assert drafted["position"]["gain"] == pytest.approx(2 * np.pi / 4096, rel=1e-6)
    assert drafted["position"]["offset"] == pytest.approx(-np.pi, rel=1e-5)
    torque = Signal(("load (1)",), "counts", "motor", register=register)
    log = read_log(path, Channels(Signal(("pos (1)",), "counts", gain=(2 * np.pi / 4096,)), torque, "t"))
    np.testing.assert_allclose(log.torque[:, 0], LOAD, atol=1e-9)


def test_values_without_a_register_stay_as_they_are() -> None:
    """Loads that cross 1024, unsigned ones, and a counter that wraps once."""
    for column in (
        np.round(1000 + 300 * np.sin(T)),
        np.abs(LOAD) + 900,
        (np.arange(1000) * 70) % 65536,
        2 * LOAD,
        LOAD + 0.5,
    ):
        assert not register_of(column)
