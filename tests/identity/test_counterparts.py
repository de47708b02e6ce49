"""Devices without torque sensors and with stiff springs: the same torque as the elastic device, in the same motion."""

from __future__ import annotations

import numpy as np
import pytest

import haptid
from haptid.device.elastic import without_torsion
from haptid.device.toml.reader import checked_tables, device_of
from haptid.dynamics.counterparts import parameters_on, with_stiff_springs, without_sensors

PLAIN = [
    {"kind": "rotor-inertia", "motors": "all"},
    {"kind": "viscous", "motors": "all"},
    {"kind": "viscous", "joints": "all"},
    {"kind": "coulomb", "joints": "all", "width": {"start": 0.2}},
]


def device(rng: np.random.Generator, sensors: tuple[bool, bool]) -> haptid.DynamicModel:
    """An arm of three joints and coupled motors, of which two are elastic."""
    joints = [{"name": "1"}, {"name": "2", "alpha": "pi/2", "d": 0.1}, {"name": "3", "d": float(rng.uniform(0.1, 0.4))}]
    motors = [
        {"name": "a", "drives": {"1": 1.0}},
        {"name": "b", "drives": {"2": 1.0, "1": float(rng.uniform(-1, 1))}, "gear_ratio": 20.0},
        {"name": "c", "drives": {"3": 1.0, "2": float(rng.uniform(-1, 1))}},
    ]
    terms = [{"kind": "elastic", "motors": [m], "sensor": s} for m, s in zip("bc", sensors, strict=True)]
    data = {
        "schema": 1,
        "name": "arm",
        "gravity": [0.0, 0.0, -9.81],
        "joints": joints,
        "motors": motors,
        "terms": [*terms, *PLAIN],
        "prior": {"KEb": 300.0, "ZZ3": 0.1},
        "targets": {"stiffness": "KEb"},
        "base_parameters": {"keep": ["KEb", "ZZ3"]},
        "symmetry": [{"reason": "a test", "zero": ["DEb", "XY2"]}],
    }
    return haptid.DynamicModel(device_of(*checked_tables(data, "arm.toml")))


@pytest.mark.parametrize("sensors", [(True, True), (False, True)])
def test_torque_sensors_measure_springs_and_leave_the_model_as_it_is(sensors):
    """Rows of rotors, loads and torsions with sensors add up to those of torsions and load sides without."""
    rng = np.random.default_rng(3)
    model = device(rng, sensors).at_constants([0.3, 0.3, 0.3])
    plain = without_sensors(model)
    beta = rng.uniform(-1, 1, len(model.base))
    beta[[k for k, name in enumerate(model.base.names) if name.startswith("OS")]] = 0.0
    states = rng.uniform(-1, 1, (3, len(plain.device.active), 30))
    behind = [d.torsion @ plain.device.closure.constant for d in plain.device.elastic]
    sensed = [row for row, own in zip(behind, sensors, strict=True) if own]
    whole = [np.concatenate([x, np.array(sensed) @ x]) for x in states]
    rows = haptid.inverse_dynamics(model, beta, *whole)
    theirs = haptid.inverse_dynamics(plain, parameters_on(model, plain) @ beta, *states)
    joints = model.device.row_map.T @ rows  # of all active joints
    carried = joints[: len(states[0])] + np.array(sensed).T @ joints[len(states[0]) :]
    np.testing.assert_allclose(plain.device.row_map.T @ theirs, carried, atol=1e-9 * np.abs(rows).max())


def test_stiff_springs_give_the_torque_of_a_motion_without_torsion():
    rng = np.random.default_rng(4)
    model = device(rng, (True, False)).at_constants([0.3, 0.3, 0.3])
    elastic, rigid = without_sensors(model), with_stiff_springs(model)
    assert not rigid.device.elastic
    assert rigid.terms[-1].constant("width") == 0.3
    beta = rng.uniform(-1, 1, len(elastic.base))
    states = rng.uniform(-1, 1, (3, 3, 30))
    moved = [without_torsion(elastic.device, x.T, position=x is states[0]).T for x in states]
    rows = haptid.inverse_dynamics(elastic, beta, *moved)
    ours = parameters_on(elastic, rigid) @ beta
    theirs = haptid.inverse_dynamics(rigid, ours, *states)
    # By virtual work over motions without torsion.
    follow = without_torsion(elastic.device, np.eye(3), position=False).T
    joints = follow.T @ elastic.device.row_map.T @ rows
    np.testing.assert_allclose(rigid.device.row_map.T @ theirs, joints, atol=1e-9 * np.abs(joints).max())


def test_devices_without_springs_are_their_own_counterparts():
    model = haptid.DynamicModel(haptid.read_device("arm3"))
    assert without_sensors(model) is model
    assert with_stiff_springs(model) is model
