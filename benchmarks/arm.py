"""The robot that is compared on: a 7-joint arm with 43 base columns, physical links, and its samples."""

from __future__ import annotations

import re
import tempfile
from functools import cached_property
from importlib import resources
from pathlib import Path

import numpy as np

import haptid
from haptid import _core
from haptid.dynamics.model import mechanism_arguments

# A regressor of so many samples stays in the second cache; so many are reduced on one thread; and many are shared out.
IN_CACHE, ALONE, SAMPLES = 128, 1984, 8192
UPPER = np.triu_indices(3)


class Arm:
    """The arm without rotors, so that every peer can have it."""

    def __init__(self) -> None:
        self.model = without_rotors("arm7")
        self.n = n = len(self.model.device.joints)
        rng = np.random.default_rng(0)
        self.q, (self.qd, self.qdd) = rng.uniform(-2, 2, (n, SAMPLES)), rng.normal(size=(2, n, SAMPLES))
        self.tau = rng.normal(size=(n, SAMPLES))
        self.mass, self.com = rng.uniform(1.0, 4.0, n), rng.uniform(-0.1, 0.1, (n, 3))
        shape = rng.normal(size=(n, 3, 3))
        second = 0.01 * np.eye(3) + 0.005 * shape @ shape.transpose(0, 2, 1)
        self.inertia = np.trace(second, axis1=1, axis2=2)[:, None, None] * np.eye(3) - second
        self.core = _core.Mechanism(*mechanism_arguments(self.model))
        S = self.model.device.parameters.S[:, list(self.model.base.independent_columns)]
        self.columns = [int(c) for c in np.flatnonzero(S.any(axis=1))]
        self.reached = np.array(self.core.reach(self.columns))

    @cached_property
    def beta(self) -> np.ndarray:
        """Its base parameters, (p,)."""
        moved = self.inertia + np.array(
            [m * (c @ c * np.eye(3) - np.outer(c, c)) for m, c in zip(self.mass, self.com, strict=True)]
        )
        links = np.column_stack([moved[:, *UPPER], self.mass[:, None] * self.com, self.mass])
        chi = self.model.device.parameters.S.T @ links.ravel()
        return np.asarray(self.model.base.of(chi))

    def case(self) -> dict[str, object]:
        """What peers need: the tree, its links, the samples, and the entries of the regressor that are wanted."""
        joints, handle = self.model.device.joints, self.model.device.handle
        assert handle is not None
        rows, chosen = np.nonzero(self.reached)
        names = ("q", "qd", "qdd", "tau", "mass", "com", "inertia")
        return {
            "parent": np.array([joint.parent for joint in joints], dtype=np.int32),
            "rotation": np.round([joint.rotation for joint in joints], 15),
            "translation": np.array([joint.translation for joint in joints]),
            "gravity": np.array(self.model.device.gravity),
            "link": handle.link,
            "point": handle.translation,
            "wanted": np.column_stack([rows, np.array(self.columns)[chosen]]),
            **{name: getattr(self, name) for name in names},
        }

    def motion(self, samples: int) -> list[np.ndarray]:
        """The first samples, and no external columns."""
        some = [np.ascontiguousarray(x[:, :samples]) for x in (self.q, self.qd, self.qdd)]
        return [*some, np.zeros((0, samples))]

    def wanted(self, Y: np.ndarray) -> np.ndarray:
        """Entries that are not always zero, (samples, entries), of a regressor (n, columns, samples)."""
        return np.asarray(Y[self.reached].T)


def without_rotors(name: str) -> haptid.Device:
    """A device of the package without its terms: peers have none."""
    text = resources.files("haptid.device.library").joinpath(f"{name}.toml").read_text(encoding="utf-8")
    kept = re.sub(r"\[\[terms\]\]\n(.+\n)+", "", text)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"{name}.toml"
        path.write_text(kept, encoding="utf-8")
        return haptid.DynamicModel(haptid.read_device(path))
