"""Random mechanisms as devices: a handle on the last link, rotors, friction, springs and offsets."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

import haptid
from haptid.device import Handle
from haptid.device.loops.linear import Closure
from haptid.device.parameters import standard_parameters
from haptid.device.parts import Joint, Motor
from haptid.device.terms.term import UNITS, TermColumn
from mechanisms import Random

KINDS = ("rotor", "viscous", "coulomb", "offset", "spring")


def as_device(mechanism: Random, kinds: tuple[str, ...] = KINDS) -> haptid.DynamicModel:
    """The model of the mechanism as a device; its torque rows are those of its coordinates."""
    rng = np.random.default_rng(5)
    n, names = mechanism.coordinates, [str(j + 1) for j in range(len(mechanism.parent))]
    placements = zip(mechanism.parent, mechanism.prismatic, mechanism.rotation, mechanism.translation, strict=True)
    joints = tuple(
        Joint(name, parent, slides, R, p, True, (-1.0, 1.0), None, None, np.eye(3), np.zeros(3))
        for name, (parent, slides, R, p) in zip(names, placements, strict=True)
    )
    terms = tuple(
        TermColumn(f"{kind}{k}", UNITS[kind][0], kind, f"joint {names[k]}", np.eye(n)[k])
        for kind in kinds
        for k in range(n)
    )
    device = haptid.Device(
        name="random",
        description="",
        source="",
        convention="placement",
        gravity=mechanism.gravity,
        joints=joints,
        active=tuple(range(n)),
        closure=Closure(mechanism.rates, mechanism.offset, 0.0, (), ()),
        drives=tuple(
            Motor(name, 1.0, 1.0, "N m", row) for name, row in zip(names, np.eye(len(names))[:n], strict=False)
        ),
        torque_rows="joint",
        terms=terms,
        parameters=standard_parameters(names, [True] * len(names), terms),
        symmetry=(),
        lengths={},
        handle=Handle(len(names) - 1, Rotation.random(random_state=rng).as_matrix(), rng.normal(size=3) * 0.2),
        prior={},
        keep=(),
        base_tolerance=1e-9,
        notes=(),
        tables=None,  # read from no file
    )
    return haptid.DynamicModel(device)


def parameters(mechanism: Random, model: haptid.DynamicModel) -> np.ndarray:
    """Its free standard parameters, (p,): the bodies drawn with it, and terms between 0.01 and 0.2."""
    return np.concatenate([mechanism.chi, np.random.default_rng(6).uniform(0.01, 0.2, len(model.terms))])
