"""Unknowns of payload identification: the model with payloads, and where each unknown is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.device import INERTIAL
from haptid.device.parameters import standard_parameters
from haptid.dynamics.model import DynamicModel
from haptid.errors import listed
from haptid.inference.payloads.body import AttachedBody

# Terms that a payload changes or wear moves: their parameters are estimated once for each load.
VARYING = ("viscous", "coulomb", "coulomb+", "coulomb-", "stribeck", "offset", "external")


def payload_model(model: DynamicModel, links: Sequence[str]) -> DynamicModel:
    """The model in which some links have all ten inertial parameters, whatever symmetries their bare bodies have."""
    device, parameters = model.device, model.device.parameters
    wanted = {kind + link for link in links for kind in INERTIAL}
    if all(name in parameters.index and parameters.members[parameters.index[name]] == (name,) for name in wanted):
        return model
    symmetries = [rule.among(set(parameters.raw) - wanted) for rule in device.symmetry]
    massive = [joint.body or joint.name in links for joint in device.joints]
    free = standard_parameters(device.joint_names, massive, device.terms, symmetries)
    joints = tuple(replace(joint, body=body) for joint, body in zip(device.joints, massive, strict=True))
    wider = replace(device, joints=joints, parameters=free, targets=())
    return DynamicModel(wider, model.terms)


def removed(model: DynamicModel, bodies: Sequence[AttachedBody]) -> str:
    """A note on the parameters that the device file removes from a link, and a payload has all the same."""
    index = model.device.parameters.index
    lost = [
        kind + link for link in dict.fromkeys(b.link for b in bodies) for kind in INERTIAL if kind + link not in index
    ]
    return (
        f"The device file has {listed(lost)} zero for the bare link; for the payload they were estimated."
        if lost
        else ""
    )


def embedding(own: DynamicModel, wide: DynamicModel) -> Array:
    """Base parameters of the wider model from those of the device's own, (wide p, p)."""
    if wide is own:
        return np.eye(len(own.base))
    narrow, free = own.device.parameters, wide.device.parameters
    E = np.zeros((len(free), len(narrow)))
    for k, members in enumerate(narrow.members):
        for name in members:
            E[free.index[name], k] = free.sign[name] * narrow.sign[name]
    return np.asarray(wide.base.regrouping @ E[:, list(own.base.independent_columns)])


@dataclass(frozen=True, eq=False)
class Layout:
    """Where the unknowns are: parameters of the bodies; of friction, once or for each load; of each payload.

    Attributes:
        embedding: base parameters of the payload model from those of the device, (wide p, p).
        varying: which of these vary with the load, (p,), bool.
        loads: number of loads, the bare device counted.
        shared: whether friction is the same for all.
        offsets, bases: of each payload, its effect on the base parameters as offset + basis u.
        maps: the ten parameters of each as offset + basis u.
    """

    embedding: Array
    varying: np.ndarray
    shared: bool
    offsets: tuple[Array, ...]
    bases: tuple[Array, ...]
    maps: tuple[tuple[Array, Array], ...]

    @staticmethod
    def of(
        own: DynamicModel, wide: DynamicModel, embedding: Array, bodies: Sequence[AttachedBody], shared: bool
    ) -> Layout:
        varying = np.array([_varies(own, k) for k in own.base.independent_columns])
        offsets, bases, maps = [], [], []
        for body in bodies:
            joint = wide.device.joints[wide.device.joint_names.index(body.link)]
            index = [wide.device.parameters.index[kind + body.link] for kind in INERTIAL]
            effect = wide.base.regrouping[:, index]
            offset, basis = body.unknowns(joint)
            offsets.append(effect @ offset)
            bases.append(effect @ basis)
            maps.append((offset, basis))
        return Layout(embedding, varying, shared, tuple(offsets), tuple(bases), tuple(maps))

    @property
    def _friction(self) -> int:
        return int(self.varying.sum())

    @property
    def _start(self) -> int:
        """Index of the first payload's first unknown."""
        copies = 0 if self.shared else len(self.bases)
        return len(self.varying) + copies * self._friction

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return self._start + sum(int(basis.shape[1]) for basis in self.bases)

    def columns(self, payload: int) -> tuple[np.ndarray, Array, Array]:
        """Indices of a payload's unknowns, and offset and basis of its ten parameters."""
        before = self._start + sum(basis.shape[1] for basis in self.bases[:payload])
        return np.arange(before, before + self.bases[payload].shape[1]), *self.maps[payload]

    def affine(self, load: int) -> tuple[Array, Array]:
        """M and m of a load; 0 is the bare device."""
        M, m = np.zeros((len(self.embedding), self.size)), np.zeros(len(self.embedding))
        p = len(self.varying)
        M[:, :p] = self.embedding
        if load and not self.shared and self._friction:
            begin = p + (load - 1) * self._friction
            M[:, begin : begin + self._friction] = M[:, :p][:, self.varying]
            M[:, :p][:, self.varying] = 0.0
        if load:
            M[:, self.columns(load - 1)[0]] += self.bases[load - 1]
            m = self.offsets[load - 1]
        return M, m


def _varies(model: DynamicModel, column: int) -> bool:
    """Whether a standard parameter is one of friction or offset."""
    raw = int(np.argmax(model.device.parameters.S[:, column])) - 10 * len(model.device.joints)
    return raw >= 0 and model.terms[raw].kind in VARYING
