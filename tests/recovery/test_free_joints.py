"""Joints that nothing drives: rows of zero torque, in random mechanisms and for a simulated cart and pole."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest
from scipy import integrate, stats

import haptid
from haptid.advice import advise
from haptid.errors import DeviceFileError, SettingError
from haptid.estimation.least_squares import solve
from haptid.estimation.method import FREE_SHARE
from haptid.inference.diagnosis import diagnose
from haptid.observation.observation import MotorRows
from haptid.results import Result
from motions import multisine

CART = """
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
kind = "viscous"
joints = "all"
[[terms]]
kind = "coulomb"
joints = "all"
[[symmetry]]
reason = "the pole hangs along y"
zero = ["MXpole", "MZpole"]
"""
STUDY = """
schema = 1
device = "device.toml"
[channels]
time = "t"
position = { channels = ["x", "angle"], unit = ["m", "rad"] }
torque = { channels = ["force"], unit = "N", side = "motor" }
[[logs]]
path = "log.csv"
"""
# Mass of both, moment of inertia and first moment of the pole, which hangs; friction.
TRUE = {
    "McartR": 1.3,
    "ZZpole": 0.009,
    "MYpole": -0.045,
    "FVcart": 2.0,
    "FVpole": 0.002,
    "FCcart": 1.0,
    "FCpole": 0.003,
}
SEEDS, DT, SECONDS, STEPS = 5, 4e-3, 20.0, 10


def moved(held: float = 0.0, driven: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Cart and pole under a controller of one of them: times, positions (n, 2, seeds), force or torque (n, seeds).

    Lagrange's equations of the two, written out; no program that haptid has a part in. A spring of stiffness `held`
    stands for a hand on the pole; `driven` is 1 where the pole has the motor, and the cart none.
    """
    M, J, S, fv1, fv2, fc1, fc2 = TRUE.values()
    draws = [np.random.default_rng(seed) for seed in range(SEEDS)]
    omega = 2 * np.pi * np.array([rng.uniform(0.2, 1.6, 5) for rng in draws])
    phase = np.array([rng.uniform(0, 2 * np.pi, 5) for rng in draws])
    size = (0.4 if driven else 0.03) / (omega / 4) ** 0.7
    stiff, damping, acts = (4.0, 0.4, np.array([0, 1])) if driven else (400.0, 40.0, np.array([1, 0]))

    def accelerations(q: np.ndarray, v: np.ndarray, force: np.ndarray) -> np.ndarray:
        sine, cosine = np.sin(q[1]), np.cos(q[1])
        on_cart = acts[0] * force - fv1 * v[0] - fc1 * np.tanh(v[0] / 5e-4) - S * sine * v[1] ** 2
        on_pole = acts[1] * force - fv2 * v[1] - fc2 * np.tanh(v[1] / 2e-3) + 9.81 * S * sine - held * (q[1] - 0.4)
        coupling = -S * cosine
        return np.array([J * on_cart - coupling * on_pole, M * on_pole - coupling * on_cart]) / (M * J - coupling**2)

    t, h = DT * np.arange(round(SECONDS / DT)), DT / STEPS
    q, v = np.array([(1 - driven) * (size * np.sin(phase)).sum(1), np.full(SEEDS, 0.3)]), np.zeros((2, SEEDS))
    position, force = np.empty((len(t), 2, SEEDS)), np.empty((len(t), SEEDS))
    for k, now in enumerate(t):
        wanted, speed = size * np.sin(omega * now + phase), size * omega * np.cos(omega * now + phase)
        f = stiff * (wanted.sum(1) - q[driven]) + damping * (speed.sum(1) - v[driven])
        position[k], force[k] = q, f
        for _ in range(STEPS):
            a = accelerations(q, v, f)
            b = accelerations(q + h / 2 * v, v + h / 2 * a, f)
            c = accelerations(q + h / 2 * v + h**2 / 4 * a, v + h / 2 * b, f)
            d = accelerations(q + h * v + h**2 / 2 * b, v + h * c, f)
            q, v = q + h * v + h**2 / 6 * (a + b + c), v + h / 6 * (a + 2 * b + 2 * c + d)
    return t, position, force


def identified(folder: Path, t: np.ndarray, q: np.ndarray, force: np.ndarray, seed: int) -> haptid.Identification:
    """From encoders of 20 um and 12 bits, and a force with noise of a hundredth of its size."""
    steps = np.array([2e-5, 2 * np.pi / 4096])
    force = force + 0.01 * force.std() * np.random.default_rng(100 + seed).standard_normal(len(t))
    table = np.column_stack([t, steps * np.rint(q / steps), force])
    np.savetxt(folder / "log.csv", table, delimiter=",", header="t,x,angle,force", comments="", fmt="%.9g")
    (folder / "device.toml").write_text(CART)
    (folder / "study.toml").write_text(STUDY)
    return haptid.identify(haptid.read_study(folder / "study.toml"))


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> list[haptid.Identification]:
    t, q, force = moved()
    folders = [tmp_path_factory.mktemp("cart") for _ in range(SEEDS)]
    return [identified(folder, t, q[:, :, k], force[:, k], k) for k, folder in enumerate(folders)]


def test_the_channel_of_a_motor_behind_a_joint_that_nothing_drives_is_shifted_in_time(tmp_path: Path) -> None:
    """Its channel is the first and its row the second: nothing of its channel was tried."""
    t, q, torque = moved(driven=1)
    late = np.concatenate([np.full(15, torque[0, 0]), torque[:-15, 0]])
    np.savetxt(tmp_path / "log.csv", np.column_stack([t, q[:, :, 0], late]), delimiter=",", header="t,x,angle,force")
    device = CART.replace('torque = "zero"\n', "").replace('"prismatic"\n', '"prismatic"\ntorque = "zero"\n')
    device = device.replace('name = "cart"\ncommand_unit = "N"', 'name = "pole"')
    (tmp_path / "device.toml").write_text(device + '[transmission]\ntorque_rows = "joint"\n')
    study = STUDY.replace('unit = "N", side', 'unit = "N m", side') + "[treatment]\ntorque_delay_s = 0\n"
    (tmp_path / "study.toml").write_text(study)
    made = haptid.identify(haptid.read_study(tmp_path / "study.toml"))
    assert made.model.measured_rows == (1,)
    said = advise(made, diagnose(made.estimate))
    first = said.actions[0]
    assert (first.kind, first.places) == ("time shift", ("joint pole",))
    (edit,) = first.edits
    assert edit.path == ("treatment", "torque_delay_s")
    np.testing.assert_allclose(edit.value, [-15 * DT], atol=DT)
    assert first.after < 0.5 * first.before


def test_a_drift_of_the_force_beside_a_pole_that_nothing_drives(tmp_path: Path) -> None:
    """Rows whitened in time were those of measured torques alone, and identification ended in a traceback."""
    t, q, force = moved()
    drift = 0.02 * np.cumsum(np.random.default_rng(7).standard_normal(len(t)))
    made = identified(tmp_path, t, q[:, :, 0], force[:, 0] + drift, 0)
    value = np.array([TRUE[name] for name in made.estimate.names])
    assert (np.abs(made.estimate.beta - value) < 4 * made.estimate.se).all()
    delay = next(one for one in diagnose(made.estimate).findings if one.name == "time delay")
    assert "pole" not in delay.sentence


def test_a_pole_that_nothing_drives_is_identified_by_its_row_of_zero_torque(found) -> None:
    covered, errors = [], []
    for one in found:
        assert set(one.estimate.names) == set(TRUE)
        value = np.array([TRUE[name] for name in one.estimate.names])
        low, high = one.estimate.quantities.conf_int().T
        covered.append((low <= value) & (value <= high))
        errors.append(np.abs(one.estimate.beta / value - 1))
    misses = int(np.sum(~np.array(covered)))
    assert misses <= stats.binom.ppf(1 - 1 / 16000, np.size(covered), 0.05)
    worst = dict(zip(found[0].estimate.names, np.max(errors, axis=0), strict=True))
    assert max(worst[name] for name in ("McartR", "ZZpole", "MYpole")) < 0.005  # an encoder step in the swing is 0.1 %
    assert max(worst[name] for name in ("FVpole", "FCpole")) < 0.1


def test_the_errors_of_a_free_joint_are_its_own(found) -> None:
    """Relative to its terms, in no error of all motors, and without a candidate of a channel."""
    one = found[0]
    driven, free = one.unseen[0].motors
    assert (driven.label, free.label) == ("motor cart", "joint pole")
    assert (driven.free, free.free) == (False, True)
    assert 0 < free.relative < 5
    assert one.unseen[0].relative == pytest.approx(driven.relative)
    rows = one.estimate.observation.motors[1]
    assert rows.norm == 0
    assert one.estimate.weights[1] == pytest.approx(
        FREE_SHARE / (rows.residual(one.estimate.beta) / np.sqrt(rows.rows.sum() - len(rows.columns))), rel=0.05
    )
    advice = advise(one, diagnose(one.estimate))
    assert not any("joint pole" in place for action in advice.actions for place in action.places)


def test_methods_that_take_every_torque_as_measured_refuse(found) -> None:
    observation = found[0].estimate.observation
    for method in (haptid.estimation.TorqueNoise(), haptid.OutputErrorMethod(), haptid.EKF()):
        with pytest.raises(SettingError, match="nothing drives joint pole"):
            haptid.estimate(observation, method)
    value = np.array([TRUE[name] for name in found[0].estimate.names])
    for method in (haptid.OLS(), haptid.GLS(), haptid.IRLS(), haptid.SUR(), haptid.TLS(), haptid.ErrorsInVariables()):
        made = haptid.estimate(observation, method)
        assert np.abs((made.beta - value) / made.se).max() < 4.5  # as far as one of 7 of 6 is in 3500 tries


def test_noise_of_the_force_does_not_shrink_what_the_pole_is(tmp_path: Path) -> None:
    """Rows of full weight pull all of the pole's parameters towards zero, far outside their intervals."""
    (tmp_path / "device.toml").write_text(CART)
    model = haptid.DynamicModel(haptid.read_device(tmp_path / "device.toml"))
    t, position, force = moved()
    steps = np.array([2e-5, 2 * np.pi / 2048])
    signals = haptid.Signal(("x", "angle"), "m", units=("m", "rad")), haptid.Signal(("f",), "N", side="motor")
    treatment = haptid.Treatment(
        cutoff_hz=15.0, parallel_cutoff_hz=5.0, decimation=6, torque_delay_s=DT / 2, reversal_speed=(0.006, 0.05)
    )
    ratios = {FREE_SHARE: [], 1.0: []}
    for k in range(SEEDS):
        q, noise = steps * np.rint(position[:, :, k] / steps), np.random.default_rng(k).standard_normal(len(t))
        f = force[:, k] + force[:, k].std() * noise
        log = haptid.Log(Path(f"made {k}"), "", t, q, f[:, None], haptid.Channels(*signals, "t"))
        rows = haptid.observe(model, haptid.treat(log, treatment))
        weights = haptid.WLS().weights(rows)
        own = model.base.names.index("ZZpole")
        made = haptid.estimate(rows, haptid.WLS())
        ratios[FREE_SHARE].append((made.beta[own] - TRUE["ZZpole"]) / made.se[own])
        whole = solve(rows, weights * [1.0, 1 / FREE_SHARE]).beta
        ratios[1.0].append((whole[own] - TRUE["ZZpole"]) / made.se[own])
    assert abs(np.mean(ratios[FREE_SHARE])) < 4 / np.sqrt(SEEDS)
    assert np.mean(ratios[1.0]) < -4 / np.sqrt(SEEDS)


def test_a_result_keeps_which_joint_is_free(found, tmp_path: Path) -> None:
    Result.of(found[0]).save(tmp_path)
    read = Result.load(tmp_path)
    for validation in (*read.fit_errors, *read.unseen):
        assert [m.free for m in validation.motors] == [False, True]
        assert [m.label for m in validation.motors] == ["motor cart", "joint pole"]
    assert read.unseen[0].relative == pytest.approx(found[0].unseen[0].relative)


def test_a_hand_on_the_joint_is_told(tmp_path: Path) -> None:
    t, q, force = moved(held=2.0)
    one = identified(tmp_path, t, q[:, :, 0], force[:, 0], 0)
    verdict = str(diagnose(one.estimate, one.unseen[0]).verdict)
    assert "the torque of joint pole is not zero" in verdict


PENDUBOT = """
schema = 1
name = "pendubot"
gravity = [0.0, -9.81, 0.0]
convention = "placement"
[[joints]]
name = "shoulder"
[[joints]]
name = "elbow"
xyz = [0.25, 0.0, 0.0]
torque = "zero"
[[motors]]
name = "shoulder"
[[terms]]
kind = "viscous"
joints = "all"
[[symmetry]]
reason = "slender links along x"
zero = ["MYshoulder", "MYelbow"]
"""


@dataclass(frozen=True)
class ByTheShoulder:
    """A method that hardly counts the rows of the elbow."""

    name: ClassVar[str] = "by the shoulder"
    unit_residual: ClassVar[bool] = False

    def weights(self, observation: haptid.Observation) -> np.ndarray:
        return np.array([1e-3 if motor.free else 1.0 for motor in observation.motors])


def test_a_motor_with_a_wrong_model_does_not_outvote_a_joint_that_nothing_drives(tmp_path: Path) -> None:
    """The shoulder's torque has a part in proportion to the elbow's acceleration, as of a sensor in a bent mounting."""
    J1, J2, S1, S2, length, damping, g = 0.05, 0.004, 0.2, 0.02, 0.25, 0.001, 9.81
    t = np.arange(0.0, 16.0, 4e-3)

    def torque(s: float, q: np.ndarray, v: np.ndarray) -> float:
        wanted = -np.pi / 2 + 0.5 * np.sin(3.1 * s) + 0.3 * np.sin(7.3 * s + 1.0)
        return 30.0 * (wanted - q[0]) - 1.5 * v[0]

    def rates(s: float, x: np.ndarray) -> np.ndarray:
        q, v = x[:2], x[2:]
        c, k = length * S2 * np.cos(q[1]), length * S2 * np.sin(q[1])
        M = np.array([[J1 + J2 + 2 * c, J2 + c], [J2 + c, J2]])
        weight = np.array([S1 * np.cos(q[0]), 0.0]) * g + S2 * g * np.cos(q[0] + q[1])
        rest = np.array([-k * v[1] * (2 * v[0] + v[1]), k * v[0] ** 2]) + weight
        return np.append(v, np.linalg.solve(M, [torque(s, q, v), -damping * v[1]] - rest))

    x = integrate.solve_ivp(rates, (0.0, t[-1]), [-np.pi / 2, 0.0, 0.0, 0.0], t_eval=t, rtol=1e-9, atol=1e-10).y
    tau = np.array([torque(s, y[:2], y[2:]) for s, y in zip(t, x.T, strict=True)])
    tau += 0.006 * np.array([rates(s, y)[3] for s, y in zip(t, x.T, strict=True)])  # 1.5 times the elbow's own inertia
    tau += 0.02 * np.std(tau) * np.random.default_rng(1).standard_normal(t.size)
    table = np.column_stack([t, np.rint(x[:2].T * 4096 / (2 * np.pi)) * (2 * np.pi) / 4096, tau])
    np.savetxt(tmp_path / "log.csv", table, delimiter=",", header="t,x,angle,force", comments="", fmt="%.9g")
    (tmp_path / "device.toml").write_text(PENDUBOT)
    study = STUDY.replace('unit = ["m", "rad"]', 'unit = "rad"').replace('unit = "N", side', 'unit = "N m", side')
    (tmp_path / "study.toml").write_text(study)
    fitted = haptid.identify(haptid.read_study(tmp_path / "study.toml")).estimate
    ratio = fitted["ZZelbow"].value / fitted["MXelbow"].value
    assert ratio == pytest.approx(J2 / S2, rel=0.01)
    outvoted = haptid.estimate(fitted.observation, ByTheShoulder())
    said = str(diagnose(outvoted, haptid.fit_errors(outvoted)).verdict)
    assert "the rows of joint elbow contradict those of the motors" in said


def tree(seed: int, free: frozenset[int], joints: int = 5) -> str:
    """A random tree with two branches, of revolute and prismatic joints with friction; nothing drives some of them."""
    rng, made = np.random.default_rng(seed), ["schema = 1", 'name = "tree"', "gravity = [0.1, -0.3, -9.8]"]
    made.append('convention = "placement"')
    for k in range(joints):
        parent = "base" if k == 0 else f"{rng.integers(max(0, k - 2), k)}"
        kind = "prismatic" if rng.random() < 0.3 else "revolute"
        xyz, rpy, axis = (np.round(rng.uniform(-0.5, 0.5, 3), 3).tolist() for _ in range(3))
        made += ["[[joints]]", f'name = "{k}"', f'parent = "{parent}"', f'type = "{kind}"', f"xyz = {xyz}"]
        made += [f"rpy = {rpy}", f"axis = {axis}", *(['torque = "zero"'] if k in free else [])]
    return "\n".join(
        [*made, '[[terms]]\nkind = "viscous"\njoints = "all"\n[[terms]]\nkind = "coulomb"\njoints = "all"']
    )


@pytest.mark.parametrize("seed", range(8))
def test_rows_are_those_of_the_inverse_dynamics_of_all_joints(tmp_path: Path, seed: int) -> None:
    rng = np.random.default_rng(100 + seed)
    free = frozenset(rng.choice(5, size=rng.integers(1, 5), replace=False).tolist())
    models = []
    for name, own in (("driven", frozenset()), ("free", free)):
        (tmp_path / f"{name}.toml").write_text(tree(seed, own))
        models.append(haptid.DynamicModel(haptid.read_device(tmp_path / f"{name}.toml")))
    every, some = models
    assert every.base.names == some.base.names
    np.testing.assert_allclose(every.base.regrouping, some.base.regrouping, atol=1e-9)
    q, qd, qdd = multisine(5, 4.0, 4e-3, seed)
    beta = rng.uniform(0.5, 1.5, len(every.base))
    tau = haptid.inverse_dynamics(every, beta, q, qd, qdd)
    kept = [k for k in range(5) if k not in free]
    treatment = haptid.Treatment(cutoff_hz=None)
    whole = haptid.observe(every, haptid.Motion(4e-3, q.T, tau.T, treatment, rates=(qd.T, qdd.T)))
    part = haptid.observe(some, haptid.Motion(4e-3, q.T, tau[kept].T, treatment, rates=(qd.T, qdd.T)))
    rows: dict[str, MotorRows] = {motor.name: motor for motor in whole.motors}
    assert {motor.name for motor in part.motors} == set(rows)
    for motor in part.motors:
        full = rows[motor.name]
        assert motor.free == (int(motor.name) in free)
        assert motor.label == (f"joint {motor.name}" if motor.free else f"motor {motor.name}")
        np.testing.assert_array_equal(motor.columns, full.columns)
        wanted = full.whole.T @ full.whole
        if motor.free:
            wanted[-1], wanted[:, -1] = 0.0, 0.0
        np.testing.assert_allclose(motor.whole.T @ motor.whole, wanted, atol=1e-9 * wanted.max())


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (('torque = "zero"', 'torque = "zero"\n[[motors]]\nname = "pole"'), '"pole" has torque = "zero", and a motor'),
        (('name = "cart"\ntype', 'name = "cart"\ntorque = "zero"\ntype'), "only up to a common factor"),
        (('torque = "zero"', 'torque = "zero"\n[[loops]]\nrelations = ["qpole = 2*qcart"]'), "a loop moves it"),
    ],
    ids=["a motor drives it", "no motor at all", "a loop moves it"],
)
def test_a_word_that_cannot_be_is_one_error(tmp_path: Path, change: tuple[str, str], words: str) -> None:
    (tmp_path / "device.toml").write_text(CART.replace(*change, 1))
    with pytest.raises(DeviceFileError, match=words):
        haptid.read_device(tmp_path / "device.toml")


def test_a_joint_without_the_key_has_no_row_and_a_note_says_so(tmp_path: Path) -> None:
    (tmp_path / "device.toml").write_text(CART.replace('torque = "zero"\n', ""))
    model = haptid.DynamicModel(haptid.read_device(tmp_path / "device.toml"))
    assert set(model.base.names) == set(TRUE) - {"ZZpole", "FVpole", "FCpole"}
    assert any('torque = "zero" in the table of the joint' in note for note in model.device.notes)
    assert not replace(model.device.drives[1], free=False).motorised
