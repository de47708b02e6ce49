"""An unmeasured passive gimbal: its simulated torque is within the bound, and so is what it does to the parameters."""

import tomllib

import numpy as np
import pytest

import haptid
from haptid.device.toml.reader import checked_tables, device_of
from haptid.errors import DeviceFileError
from haptid.inference.gimbal import gimbal_effect, torque_bound
from haptid.results import Result
from haptid.study.identify import identify
from haptid.study.read import read_study
from motions import multisine
from small_study import HEAD

# One link that turns in a vertical plane; the gimbal at its end is a second one without a motor.
DEVICE = """
schema = 1
name = "a link"
gravity = [0.0, -9.81, 0.0]
convention = "modified-dh"
[[joints]]
name = "1"
[[terms]]
kind = "viscous"
joints = "all"
[handle]
link = "1"
xyz = [0.3, 0, 0]
"""
SECOND = """
[[joints]]
name = "2"
d = 0.3
"""
MASS, RADIUS, INERTIA, DT = 0.1, 0.03, 2e-4, 1e-3
OWN = {"ZZ1": 0.02, "MX1": 0.05, "MY1": 0.01, "FV1": 0.02}


def model_of(text):
    return haptid.DynamicModel(device_of(*checked_tables(tomllib.loads(text), "here")))


def gimbal(state, **more):
    given = {"state": f'"{state}"', "mass": MASS, "com_radius": RADIUS, "inertia": INERTIA, **more}
    return DEVICE + "[gimbal]\n" + "\n".join(f"{key} = {value}" for key, value in given.items())


def base_of(model, **values):
    """Base parameters from some standard ones."""
    chi = np.zeros(len(model.device.parameters.names))
    for name, value in values.items():
        if name in model.device.parameters.index:
            chi[model.device.parameters.index[name]] = value
    return model.base.of(chi)


def swinging(kind, seconds=6.0, speed=4.0):
    """Motion of the link, the torque that it takes with the gimbal swinging, and with a point mass in its place.

    The second joint's torque is zero: its acceleration is integrated by semi-implicit Euler steps at 1 ms.
    """
    both = model_of(DEVICE.replace("[[terms]]", f"{SECOND}[[terms]]", 1).replace('joints = "all"', 'joints = ["1"]'))
    beta = base_of(both, **OWN, ZZ2=INERTIA, MX2=MASS * RADIUS, M2=MASS)
    (q, qd, qdd) = (x[0] for x in multisine(1, seconds, DT, 1, size=0.1))
    at = -np.pi / 2 - q[0] if kind == "hanging" else 0.3
    rate = 0.0 if kind == "hanging" else speed
    angle = np.zeros((3, len(q)))
    for k in range(len(q)):
        torque = haptid.inverse_dynamics(
            both,
            beta,
            np.array([[q[k]] * 2, [at] * 2]),
            np.array([[qd[k]] * 2, [rate] * 2]),
            np.array([[qdd[k]] * 2, [0.0, 1.0]]),
        )[1]
        acceleration = -torque[0] / (torque[1] - torque[0])
        angle[:, k] = at, rate, acceleration
        rate += DT * acceleration
        at += DT * rate
    tau = haptid.inverse_dynamics(
        both, beta, np.stack([q, angle[0]]), np.stack([qd, angle[1]]), np.stack([qdd, angle[2]])
    )
    assert np.abs(tau[1]).max() < 1e-9
    one = model_of(DEVICE)
    # A point mass at the handle is part of the link.
    own = dict(OWN, ZZ1=OWN["ZZ1"] + MASS * 0.3**2, MX1=OWN["MX1"] + MASS * 0.3)
    plain = haptid.inverse_dynamics(one, base_of(one, **own), q[None], qd[None], qdd[None])
    away = np.abs(q + angle[0] + np.pi / 2).max()
    return (q, qd, qdd), tau[0], plain[0], away, np.abs(qd + angle[1]).max(), base_of(one, **own)


@pytest.mark.parametrize("state", ["hanging", "free"])
def test_what_a_simulated_gimbal_does_is_within_the_bound(state):
    (q, qd, qdd), tau, plain, swing, rate, beta = swinging(state)
    model = model_of(gimbal(state, **({"swing": swing} if state == "hanging" else {"rate": rate})))
    treatment = haptid.Treatment(cutoff_hz=None)
    motion = haptid.Motion(DT, q[:, None], tau[:, None], treatment, rates=(qd[:, None], qdd[:, None]))
    bound = torque_bound(model, motion)[0]
    start, stop = motion.usable
    reaction = np.abs(tau - plain)[start:stop]
    assert (reaction <= bound * (1 + 1e-3)).all()
    assert bound.max() < 30 * reaction.max()
    found = haptid.estimate(haptid.observe(model, motion), haptid.OLS())
    effect = gimbal_effect(found)
    assert (np.abs(found.beta - beta) <= effect.parameters).all()
    assert effect.share[0] >= 100 * np.linalg.norm(reaction) / np.linalg.norm(tau[start:stop])
    (sentence,) = effect.sentences
    assert f"{state}, not measured" in sentence


def test_a_locked_one_is_part_of_its_link():
    model = model_of(gimbal("locked"))
    q, qd, qdd = multisine(1, 4.0, 1e-2, 2)
    tau = haptid.inverse_dynamics(model, base_of(model, **OWN), q, qd, qdd)
    motion = haptid.Motion(1e-2, q.T, tau.T, haptid.Treatment(cutoff_hz=None), rates=(qd.T, qdd.T))
    effect = gimbal_effect(haptid.estimate(haptid.observe(model, motion), haptid.OLS()))
    assert not effect.parameters.any()
    assert "up to 0.003 kg m" in effect.sentences[0]


def test_without_a_gimbal_there_is_none():
    model = model_of(DEVICE)
    q, qd, qdd = multisine(1, 4.0, 1e-2, 2)
    tau = haptid.inverse_dynamics(model, base_of(model, **OWN), q, qd, qdd)
    motion = haptid.Motion(1e-2, q.T, tau.T, haptid.Treatment(cutoff_hz=None), rates=(qd.T, qdd.T))
    assert gimbal_effect(haptid.estimate(haptid.observe(model, motion), haptid.OLS())) is None


@pytest.mark.parametrize(
    ("text", "what"),
    [
        (gimbal("free"), "no rate"),
        (gimbal("hanging", rate=3.0), "has a rate"),
        (gimbal("hanging", inertia=1e-6), "below 9e-05"),
        (gimbal("locked", mass=-1.0), "below 0"),
        (
            gimbal("locked").replace("[handle]", "[prior]").replace('link = "1"\nxyz = [0.3, 0, 0]', ""),
            "no handle|is none",
        ),
    ],
)
def test_numbers_that_no_gimbal_has_are_refused(text, what):
    with pytest.raises(DeviceFileError, match=what):
        model_of(text)


def test_a_study_states_it(tmp_path):
    """In the notes and in the result file."""
    (tmp_path / "device.toml").write_text(gimbal("hanging"))
    model = model_of(gimbal("hanging"))
    q, qd, qdd = multisine(1, 6.0, 2e-3, 3)
    tau = haptid.inverse_dynamics(model, base_of(model, **OWN), q, qd, qdd)
    tau += 0.01 * np.random.default_rng(0).standard_normal(tau.shape)
    table = np.column_stack([2e-3 * np.arange(q.shape[1]), q.T, tau.T])
    np.savetxt(tmp_path / "log.csv", table, delimiter=",", header="t,q1,tau1", comments="")
    head = HEAD.replace(', "q2"', "").replace(', "tau2"', "")
    settings = "[treatment]\ncutoff_hz = 30\ndecimation = 5\n"
    (tmp_path / "study.toml").write_text(f'{head}[[logs]]\npath = "log.csv"\n{settings}')
    made = Result.of(identify(read_study(tmp_path / "study.toml")))
    assert made.estimate.gimbal.state == "hanging"
    assert all(value > 0 for value in made.estimate.gimbal.torque_percent.values())
    assert any("acts as a point mass at the handle" in note for note in made.notes)
    made.save(tmp_path / "out")
    assert Result.load(tmp_path / "out").to_dict() == made.to_dict()
