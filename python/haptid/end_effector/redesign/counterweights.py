"""Counterweights that null gravity torques over a workspace, and what they cost in effective mass at the handle.

A point mass m at p changes the mass by m, first moments by m p and inertia by m p p'. Static torques are linear in the
first two, so for given places they are balanced by linear least squares; inertia grows with the lever, so of weights
with the same moment the one with the most mass at the least distance costs least. The search minimises

    |static torque|^2 / |that without weights|^2 + price * (mean of largest effective mass / that without weights - 1)

over masses and places within their limits: a price of 0 balances best, and greater ones give the front.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from haptid._internal.arrays import Array, expect, freeze
from haptid._internal.late import dataclass
from haptid._internal.pareto import pareto_front
from haptid.device.parameters import INERTIAL
from haptid.device.priors import PriorBody, inertial_parameters
from haptid.dynamics.inverse import inverse_dynamics, mass_matrix
from haptid.dynamics.model import DynamicModel
from haptid.end_effector.characterisation.jacobian import LINEAR, handle_jacobian
from haptid.end_effector.characterisation.model import GivenParameters, IdentifiedModel
from haptid.end_effector.force import WORST_CONDITION
from haptid.errors import IncompleteDeviceError, setting_error, unknown_name

# Starts of the search, and prices of the front.
_STARTS = 3
PRICES = (0.0, 0.03, 0.3, 1.0, 3.0, 10.0)
# Price that decides between weights that balance alike.
_LEAST_PRICE = 1e-6


@dataclass(frozen=True)
class WeightPlace:
    """Where a counterweight may be put.

    Attributes:
        link: name of the link's joint.
        most: mass, kg.
        low, high: corners of a box in the link frame of the device file, (3,), m.
    """

    link: str
    most: float
    low: tuple[float, float, float]
    high: tuple[float, float, float]

    def __post_init__(self) -> None:
        if not 0 < self.most < float("inf"):
            raise setting_error(f"most of {self.link}", self.most, "a mass above 0 kg")
        if not (np.isfinite([self.low, self.high]).all() and (np.array(self.low) <= self.high).all()):
            raise setting_error(f"place of {self.link}", (self.low, self.high), "two corners, the lower one first")


@dataclass(frozen=True)
class Counterweight:
    """A point mass on a link.

    Attributes:
        link: name of the link's joint.
        mass: kg.
        com: in the link frame of the device file, (3,), m.
    """

    link: str
    mass: float
    com: tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class Balance:
    """Counterweights and what they do, over the poses.

    Attributes:
        weights: the counterweights; those below a thousandth of their limit are left out.
        price: of the search; NaN of weights that were given.
        static_before, static_after: root mean square of static torques, N m or N.
        mass_before, mass_after: largest effective mass, mean over the poses, kg.
        identified: the parameters with the weights, with the covariance of those without.
    """

    weights: tuple[Counterweight, ...]
    price: float
    static_before: float
    static_after: float
    mass_before: float
    mass_after: float
    identified: GivenParameters


def places(model: DynamicModel) -> tuple[WeightPlace, ...]:
    """Places for counterweights in the device file.

    Raises:
        IncompleteDeviceError: the file has none.
    """
    tables = model.device.tables.counterweights
    if not tables:
        raise IncompleteDeviceError(
            f"{model.device.name} has no places for counterweights.",
            where="counterweights",
            advice="Add [[counterweights]] with link, most, low and high to the device file, or give places.",
        )
    corners = [[(x, y, z) for x, y, z in (table.low, table.high)] for table in tables]
    return tuple(
        WeightPlace(table.link, table.most, low, high) for table, (low, high) in zip(tables, corners, strict=True)
    )


def with_counterweights(
    identified: IdentifiedModel, weights: Sequence[Counterweight], limits: Sequence[WeightPlace] | None = None
) -> GivenParameters:
    """The parameters with counterweights.

    Args:
        identified: the parameters without.
        weights: to add.
        limits: within which each must be; None for no check.

    Raises:
        UnknownNameError: a link that the device does not have.
        SettingError: a counterweight outside its limits, or with a moment that the device's symmetries exclude.
    """
    model = identified.model
    for weight in weights if limits is not None else ():
        _inside(weight, limits or ())
    chi = sum((_added(model, w.link, w.mass, np.array(w.com)) for w in weights), np.zeros(len(model.device.parameters)))
    dof = identified.dof if isinstance(identified, GivenParameters) else float(identified.unconstrained.dof.min())
    return GivenParameters(model, identified.beta + model.base.of(chi), identified.covariance, dof)


def balance(
    identified: IdentifiedModel, poses: ArrayLike, limits: Sequence[WeightPlace] | None = None, price: float = 0.0
) -> Balance:
    """Counterweights that balance the device over poses.

    Args:
        identified: the parameters.
        poses: positions of the active joints, (active, poses), rad or m.
        limits: places and masses; those of the device file where None.
        price: of effective mass; see the module.

    Raises:
        IncompleteDeviceError: no place for a counterweight, or no handle.
        UnknownNameError, SettingError: a place on an unknown link, or at which no mass can be added.
    """
    return _Search(identified, poses, limits).best(price)


def balance_front(
    identified: IdentifiedModel,
    poses: ArrayLike,
    limits: Sequence[WeightPlace] | None = None,
    prices: Sequence[float] = PRICES,
) -> tuple[Balance, ...]:
    """Balances at several prices, none of which is beaten in both figures; arguments and errors as for `balance`."""
    search = _Search(identified, poses, limits)
    found = [search.best(price) for price in prices]
    return pareto_front(found, lambda one: (one.static_after, one.mass_after), margin=1e-9)


def weighed(
    identified: IdentifiedModel,
    poses: ArrayLike,
    weights: Sequence[Counterweight],
    limits: Sequence[WeightPlace] | None = None,
) -> Balance:
    """What given counterweights do; arguments and errors as for `balance`, and weights outside their limits."""
    search = _Search(identified, poses, limits)
    return search.balance(tuple(weights), float("nan"), with_counterweights(identified, weights, search.places))


def _inside(weight: Counterweight, limits: Sequence[WeightPlace]) -> None:
    here = [place for place in limits if place.link == weight.link]
    for place in here:
        if weight.mass <= place.most and all(
            low - 1e-12 <= x <= high + 1e-12 for low, x, high in zip(place.low, weight.com, place.high, strict=True)
        ):
            return
    links = ", ".join(dict.fromkeys(place.link for place in limits)) or "none"
    within = " or ".join(f"at most {p.most:g} kg from {p.low} to {p.high}" for p in here)
    wanted = within or f"it on a link that has a place: {links}"
    raise setting_error(f"counterweight on {weight.link}", (weight.mass, weight.com), wanted)


def _added(model: DynamicModel, link: str, mass: float, com: Array) -> Array:
    """Change of the free standard parameters, (p,), by a point mass."""
    names = model.device.joint_names
    if link not in names:
        raise unknown_name(f"a counterweight is on {link!r}, which is no link.", link, names)
    joint = model.device.joints[names.index(link)]
    values = inertial_parameters(PriorBody(mass, com, np.zeros((3, 3))), joint)
    made, index = np.zeros(len(model.device.parameters)), model.device.parameters.index
    for kind, value in zip(INERTIAL, values, strict=True):
        name = kind + joint.name
        if name in index:
            made[index[name]] += model.device.parameters.sign[name] * value
        elif abs(value) > 1e-12 * max(mass, 1e-12):
            wanted = f"places at which {name} stays zero, as the symmetries of the device file say, or no such symmetry"
            raise setting_error(f"place of {link}", tuple(com.tolist()), wanted)
    return freeze(made)


class _Search:
    """Static torques and mass matrices at the poses, as linear functions of base parameters."""

    def __init__(self, identified: IdentifiedModel, poses: ArrayLike, limits: Sequence[WeightPlace] | None) -> None:
        self.identified, self.model = identified, identified.model
        self.places = tuple(places(self.model) if limits is None else limits)
        qa = np.asarray(poses, dtype=float)
        expect("poses", qa.shape, (len(self.model.device.active), None))
        self.handle = handle_jacobian(self.model, qa, LINEAR, WORST_CONDITION)
        self.usable = self.handle.usable
        if not self.usable.any():
            raise setting_error("poses", qa.shape[1], "poses at which the handle is not singular")
        units, still, inner = np.eye(len(self.model.base)), np.zeros_like(qa), list(self.handle.moving)
        self.static = np.array([inverse_dynamics(self.model, u, qa, still, still) for u in units])
        self.masses = np.array([mass_matrix(self.model, u, qa)[self.usable][:, inner][:, :, inner] for u in units])
        self.jacobian = self.handle.jacobian[self.usable]
        self.before = self.figures(identified.beta)
        wide = [[True, *(np.array(place.high) > place.low)] for place in self.places]
        self.free = np.flatnonzero(np.array(wide).ravel())
        # Every place admits its corners and its middle.
        for place in self.places:
            for com in (place.low, place.high):
                _added(self.model, place.link, place.most, np.array(com))

    def figures(self, beta: Array) -> tuple[float, float]:
        """Root mean square of static torques, and mean of the largest effective mass."""
        static = np.tensordot(beta, self.static, 1)
        A = np.tensordot(beta, self.masses, 1)
        mobility = self.jacobian @ np.linalg.solve(A, self.jacobian.mT)
        least = np.linalg.eigvalsh(mobility)[:, -min(self.jacobian.shape[1:])]
        return float(np.sqrt(np.mean(static**2))), float((1 / least).mean())

    def weights(self, x: Array) -> tuple[Counterweight, ...]:
        """The counterweights of a point of the search, (free,): shares of the most mass and of the box."""
        made, full = [], np.zeros(4 * len(self.places))
        full[self.free] = x
        for place, (share, *at) in zip(self.places, full.reshape(-1, 4), strict=True):
            a, b, c = (np.array(place.low) + np.array(at) * (np.array(place.high) - place.low)).tolist()
            made.append(Counterweight(place.link, float(share) * place.most, (a, b, c)))
        return tuple(made)

    def beta(self, weights: Sequence[Counterweight]) -> Array:
        """Base parameters with these weights."""
        return with_counterweights(self.identified, weights).beta

    def best(self, price: float) -> Balance:
        """The best of several starts."""
        if not 0 <= price < float("inf"):
            raise setting_error("price", price, "a finite number from 0")
        cost_of_mass = max(price, _LEAST_PRICE)

        def cost(x: Array) -> float:
            static, mass = self.figures(self.beta(self.weights(x)))
            return (static / self.before[0]) ** 2 + cost_of_mass * (mass / self.before[1] - 1)

        rng, size = np.random.default_rng(0), len(self.free)
        starts = [np.full(size, 0.5), *rng.random((_STARTS - 1, size))]
        options = {"maxiter": 150, "ftol": 1e-12}
        from scipy import optimize  # slow to import, and few commands look for counterweights

        found = [optimize.minimize(cost, x, bounds=[(0, 1)] * size, method="SLSQP", options=options) for x in starts]
        made = self.weights(min(found, key=lambda one: float(one.fun)).x)
        kept = tuple(w for w, place in zip(made, self.places, strict=True) if w.mass > 1e-3 * place.most)
        return self.balance(kept, price, with_counterweights(self.identified, kept))

    def balance(self, weights: tuple[Counterweight, ...], price: float, with_them: GivenParameters) -> Balance:
        """What the weights do."""
        static, mass = self.figures(with_them.beta)
        return Balance(weights, price, self.before[0], static, self.before[1], mass, with_them)
