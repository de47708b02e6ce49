"""A cart behind a spring with a pole that nothing drives: rows of torsion, of the cart and of zero torque."""

from __future__ import annotations

import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

import haptid
from haptid.device.toml.reader import checked_tables, device_of
from haptid.errors import LogMismatchError
from haptid.estimation.method import FREE_SHARE
from haptid.treatment_choice.hidden_joints import complete_logs

DEVICE = """
schema = 1
name = "cart and pole"
gravity = [0.0, -9.81, 0.0]
convention = "placement"
[[joints]]
name = "cart"
type = "prismatic"
axis = [1, 0, 0]
[[joints]]
name = "pole"
axis = [0, 0, 1]
torque = "zero"
[[motors]]
name = "cart"
command_unit = "N"
[[terms]]
kind = "elastic"
motors = "all"
[[terms]]
kind = "rotor-inertia"
motors = "all"
[[terms]]
kind = "viscous"
joints = "all"
[[terms]]
kind = "viscous"
motors = "all"
prefix = "FVM"
[[symmetry]]
reason = "the pole hangs along y"
zero = ["MXpole", "MZpole"]
"""
# Mass of both, moment of inertia and first moment of the pole, which hangs; spring, rotor, friction.
TRUE = {
    "McartR": 1.3,
    "ZZpole": 0.009,
    "MYpole": -0.045,
    "KEcart": 900.0,
    "DEcart": 2.0,
    "IAMcart": 0.4,
    "FVMcart": 3.0,
    "FVcart": 2.0,
    "FVpole": 0.002,
}
SEEDS, DT, SECONDS, STEPS = 5, 2e-3, 20.0, 4


def cart(device: str = DEVICE) -> haptid.DynamicModel:
    return haptid.DynamicModel(device_of(*checked_tables(tomllib.loads(device), "cart.toml")))


def moved() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times, positions of cart, pole and rotor (n, 3, seeds), and the motor's force (n, seeds).

    Lagrange's equations of the three, written out; no program that haptid has a part in.
    """
    M, J, S, K, D, IA, FVM, FV, FVP = TRUE.values()
    draws = [np.random.default_rng(seed) for seed in range(SEEDS)]
    omega = 2 * np.pi * np.array([rng.uniform(0.2, 4.0, 8) for rng in draws])
    phase = np.array([rng.uniform(0, 2 * np.pi, 8) for rng in draws])
    size = 0.03 / (omega / 4) ** 0.7

    def accelerations(q: np.ndarray, v: np.ndarray, force: np.ndarray) -> np.ndarray:
        sine, cosine = np.sin(q[1]), np.cos(q[1])
        spring = K * (q[2] - q[0]) + D * (v[2] - v[0])
        on_cart = spring - FV * v[0] - S * sine * v[1] ** 2
        on_pole = 9.81 * S * sine - FVP * v[1]
        b = -S * cosine
        links = np.array([J * on_cart - b * on_pole, M * on_pole - b * on_cart]) / (M * J - b**2)
        return np.concatenate([links, [(force - spring - FVM * v[2]) / IA]])

    t, h = DT * np.arange(round(SECONDS / DT)), DT / STEPS
    q, v = np.zeros((3, SEEDS)), np.zeros((3, SEEDS))
    q[1] = 0.3
    position, force = np.empty((len(t), 3, SEEDS)), np.empty((len(t), SEEDS))
    for k, now in enumerate(t):
        wanted, speed = size * np.sin(omega * now + phase), size * omega * np.cos(omega * now + phase)
        f = 600.0 * (wanted.sum(1) - q[2]) + 30.0 * (speed.sum(1) - v[2])
        position[k], force[k] = q, f
        for _ in range(STEPS):
            a = accelerations(q, v, f)
            b = accelerations(q + h / 2 * v, v + h / 2 * a, f)
            c = accelerations(q + h / 2 * v + h**2 / 4 * a, v + h / 2 * b, f)
            d = accelerations(q + h * v + h**2 / 2 * b, v + h * c, f)
            q, v = q + h * v + h**2 / 6 * (a + b + c), v + h / 6 * (a + 2 * b + 2 * c + d)
    return t, position, force


@pytest.fixture(scope="module")
def logs() -> list[haptid.Log]:
    """With encoders of 2 um and 14 bits, and a force with noise of a hundredth of its size."""
    t, position, force = moved()
    steps, made = np.array([2e-6, 2 * np.pi / 2**14, 2e-6]), []
    channels = haptid.Channels(
        haptid.Signal(("x", "angle", "motor"), "m", units=("m", "rad", "m")),
        haptid.Signal(("force",), "N", side="motor"),
        "t",
    )
    for k in range(SEEDS):
        noise = 0.01 * force[:, k].std() * np.random.default_rng(100 + k).standard_normal(len(t))
        seen = np.ascontiguousarray(steps * np.rint(position[:, :, k] / steps))
        made.append(haptid.Log(Path("made"), str(k), t, seen, (force[:, k] + noise)[:, None], channels))
    return made


def test_the_row_of_zero_torque_is_lagranges_equation():
    model, rng = cart(), np.random.default_rng(0)
    beta = np.array([TRUE[name] for name in model.base.names])
    (x, p, r), (xd, pd, rd), (xdd, pdd, rdd) = motion = rng.standard_normal((3, 3, 20))
    M, J, S, K, D, IA, FVM, FV, FVP = TRUE.values()
    motor = IA * rdd + FVM * rd + K * (r - x) + D * (rd - xd)
    whole = IA * rdd + FVM * rd + M * xdd - S * np.cos(p) * pdd + S * np.sin(p) * pd**2 + FV * xd
    pole = J * pdd - S * np.cos(p) * xdd - 9.81 * S * np.sin(p) + FVP * pd
    rows = dict(zip(model.device.row_names, haptid.inverse_dynamics(model, beta, *motion), strict=True))
    assert model.device.free_rows == tuple(name == "pole" for name in rows)
    for name, wanted in (("cart", motor), ("pole", pole), ("link_cart", whole)):
        np.testing.assert_allclose(rows[name], wanted, atol=1e-11 * K)


STUDY = """
schema = 1
device = "device.toml"
[channels]
time = "t"
position = { channels = ["x", "angle", "motor"], unit = ["m", "rad", "m"] }
torque = { channels = ["force"], unit = "N", side = "motor" }
[[logs]]
path = "log.csv"
"""


def identified(folder: Path, log: haptid.Log) -> haptid.Identification:
    table = np.column_stack([log.t, log.position[:], log.torque[:]])
    np.savetxt(folder / "log.csv", table, delimiter=",", header="t,x,angle,motor,force", comments="", fmt="%.9g")
    (folder / "device.toml").write_text(DEVICE)
    (folder / "study.toml").write_text(STUDY)
    return haptid.identify(haptid.read_study(folder / "study.toml"))


def test_spring_and_pole_are_within_their_intervals(logs, tmp_path):
    inside, draws = 0, 0
    for k, log in enumerate(logs):
        (folder := tmp_path / str(k)).mkdir()
        made = identified(folder, log)
        found = made.estimate
        assert [motor.free for motor in found.observation.motors] == [False, True, False]
        verdict = str(haptid.diagnose(found).verdict)
        assert "not zero" not in verdict
        assert "is good for predicting torque" in verdict
        for name, value, (low, high) in zip(found.names, found.beta, found.conf_int(), strict=True):
            inside, draws = inside + (low < TRUE[name] < high), draws + 1
            wanted = 0.02 if name == "KEcart" else 0.1
            assert value == pytest.approx(TRUE[name], rel=wanted), name
    # Of intervals of 95 %: fewer would be inside by chance in one of a thousand runs.
    assert inside >= stats.binom.ppf(1e-3, draws, 0.95)


def test_the_row_of_the_pole_tells_what_the_motor_does_not(logs):
    """Without it the pole's moment of inertia is no base parameter, and a tenth of the weight is its own."""
    with_row, without = cart(), cart(DEVICE.replace('torque = "zero"\n', ""))
    assert {"ZZpole", "FVpole"} <= set(with_row.base.names)
    assert not {"ZZpole", "FVpole"} & set(without.base.names)
    treatment = haptid.propose(with_row, logs[0]).treatment
    rows = haptid.observe(with_row, haptid.treat(logs[0], treatment))
    weights = haptid.WLS().weights(rows)
    found = haptid.estimate(rows, haptid.WLS())
    noise = [motor.own_residual(found.beta) if motor.free else motor.residual(found.beta) for motor in rows.motors]
    shares = weights * noise / np.sqrt([motor.rows.sum() for motor in rows.motors])
    np.testing.assert_allclose(shares / shares[0], [1.0, FREE_SHARE, 1.0], rtol=0.02)


def test_links_that_are_not_measured_are_not_simulated_beside_a_joint_that_nothing_drives(logs):
    """Whatever method would take its row as measured; without the row, the motor and the pole tell the spring."""
    log = logs[0]
    position = haptid.Signal(("angle", "motor"), "m", units=("rad", "m"))
    seen = np.ascontiguousarray(log.position[:, 1:])
    alone = replace(log, position=seen, channels=replace(log.channels, position=position))
    with pytest.raises(LogMismatchError, match=r"joint pole.*zero torque") as caught:
        complete_logs(cart(), [alone], [True])
    assert "cart, pole, rotor_cart" in caught.value.advice
    _, found = complete_logs(cart(DEVICE.replace('torque = "zero"\n', "")), [alone], [True])
    assert found["KEcart"].value == pytest.approx(TRUE["KEcart"], rel=0.02)
