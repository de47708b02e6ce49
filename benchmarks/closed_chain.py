"""A closed chain to compare regressors on: nine links, three motors. Peers have its tree; ours is already projected."""

from __future__ import annotations

import numpy as np

import haptid
from haptid import _core
from haptid.dynamics.model import mechanism_arguments

NAME, CENTRE = "cea_medical_branch", (0.1, -1.0, 3.8)
# As many as peers store; see `peers/common.py`.
SAMPLES = 2048


class Closed:
    """Bodies only: the terms' columns are left out."""

    def __init__(self) -> None:
        self.model = haptid.DynamicModel(haptid.read_device(NAME))
        self.n, self.links = len(self.model.device.active), len(self.model.device.joints)
        rng = np.random.default_rng(0)
        self.qa = np.array(CENTRE)[:, None] + rng.uniform(-0.4, 0.4, (self.n, SAMPLES))
        self.c = np.ascontiguousarray(self.model.device.row_map @ self.qa)
        self.cd, self.cdd = rng.normal(size=(2, self.n, SAMPLES))
        self.core = _core.Mechanism(*mechanism_arguments(self.model))
        S = self.model.device.parameters.S[:, list(self.model.base.independent_columns)]
        self.columns = [int(k) for k in np.flatnonzero(S.any(axis=1)) if k < 10 * self.links]
        self.reached = np.array(self.core.reach(self.columns))

    def case(self) -> dict[str, object]:
        """The tree and its motion, the rates of its joints by the coordinates, and the wanted entries."""
        followed = self.model.device.closure.follow(self.qa).by(self.model.device.row_map)
        joints, G = self.model.device.joints, followed.G
        assert G.ndim == 2, "rates that do not vary"
        rows, chosen = np.nonzero(self.reached)
        none = np.zeros(self.links)
        return {
            "parent": np.array([joint.parent for joint in joints], dtype=np.int32),
            "rotation": np.round([joint.rotation for joint in joints], 15),
            "translation": np.array([joint.translation for joint in joints]),
            "gravity": np.array(self.model.device.gravity),
            "wanted": np.column_stack([rows, np.array(self.columns)[chosen]]),
            "rates": G,
            "q": followed.q,
            "qd": G @ self.cd,
            "qdd": G @ self.cdd,
            "tau": np.zeros((self.links, SAMPLES)),
            "mass": none,
            "com": np.zeros((self.links, 3)),
            "inertia": np.zeros((self.links, 3, 3)),
            "link": 0,
            "point": np.zeros(3),
        }

    def motion(self, samples: int) -> list[np.ndarray]:
        """The first samples, and the columns of the device that Python computes: none count."""
        some = [np.ascontiguousarray(x[:, :samples]) for x in (self.c, self.cd, self.cdd)]
        return [*some, np.zeros((len(self.model.externals), samples))]

    def wanted(self, Y: np.ndarray) -> np.ndarray:
        """Entries that are not always zero, (samples, entries), of a regressor (n, columns, samples)."""
        return np.asarray(Y[self.reached].T)
