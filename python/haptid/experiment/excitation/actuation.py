"""Limits of the motors along a motion: torque with the uncertainty of parameters, rms torque, power, handle force."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property

import numpy as np
from scipy import special

from haptid._internal.arrays import Array, freeze_fields
from haptid._internal.late import dataclass
from haptid.dynamics.inverse import inverse_dynamics, raw_parameters
from haptid.dynamics.kinematics import handle_motion, handle_of
from haptid.dynamics.model import DynamicModel
from haptid.dynamics.regressor import DIFFERENCE_STEPS, CoreChannels, moved, regressor_columns
from haptid.errors import SettingError
from haptid.experiment.bench.trajectories import Figures, per_coordinate
from haptid.uncertainty.distributions import normal_quantile

# Relative singular values of the handle's Jacobian below this exert no force.
_SINGULAR = 1e-6


@dataclass(frozen=True, eq=False)
class Actuation:
    """Limits of torques and what follows from them.

    Attributes:
        beta: base parameters, (p,), SI.
        torque: maximum of each torque row, (rows,), N m or N; infinite where there is no limit.
        rms_torque: maximum root mean square of each, (rows,), N m or N.
        power: maximum of |torque times velocity| of each, (rows,), W.
        handle_force: maximum force at the handle, N; infinite without a limit.
        quantile: of the normal distribution, for the torques' confidence; 0 without.
        root: root of the covariance of the base parameters, (p, k), root root' the covariance.
    """

    model: DynamicModel
    beta: Array
    torque: Array
    rms_torque: Array
    power: Array
    handle_force: float
    quantile: float
    root: Array

    def __post_init__(self) -> None:
        rows = (len(self.model.device.row_names),)
        freeze_fields(self, "root", torque=rows, rms_torque=rows, power=rows)

    @staticmethod
    def of(
        model: DynamicModel,
        beta: Array,
        *,
        torque: Figures | None,
        rms_torque: Figures | None,
        power: Figures | None,
        handle_force: float | None,
        confidence: float | None,
        covariance: Array | None,
    ) -> Actuation:
        """From limits of all rows or of each.

        Raises:
            SettingError: a confidence without a maximum torque, or without a covariance; a limit that is not positive.
            IncompleteDeviceError: a maximum force, and the device has no handle.
        """
        rows = list(model.device.row_names)
        limits = {
            what: per_coordinate(what, given or (np.inf,), rows)
            for what, given in (("torque", torque), ("rms_torque", rms_torque), ("power", power))
        }
        for what, values in (
            *limits.items(),
            ("handle_force", np.array([np.inf if handle_force is None else handle_force])),
        ):
            if not (values > 0).all():
                raise SettingError(f"{what} has to be above 0; found {values.min():g}.", where=what, found=values.min())
        if handle_force is not None:
            handle_of(model)
        root, quantile = np.zeros((len(beta), 0)), 0.0
        if confidence is not None:
            if torque is None:
                raise SettingError(
                    "torque_confidence needs a maximum torque.",
                    where="torque_confidence",
                    advice="Give the maximum torques too.",
                )
            quantile, root = float(normal_quantile(confidence)), _root(model, covariance)
        return Actuation(model, beta, handle_force=handle_force or np.inf, quantile=quantile, root=root, **limits)

    @cached_property
    def _any(self) -> bool:
        return bool(np.isfinite(self.torque).any() or np.isfinite(self.power).any() or np.isfinite(self.handle_force))

    @cached_property
    def _rms(self) -> bool:
        return bool(np.isfinite(self.rms_torque).any())

    def by_sample(self, states: Array) -> Iterator[tuple[Array, str]]:
        """Relative violations at every sample, (n,) each; states of the active joints, (3, active, n)."""
        if not self._any:
            return
        tau, labels = self._torques(states), self.model.device.row_labels
        if np.isfinite(self.torque).any():
            margin = self._margin(states)
            sure = f" with {100 * special.ndtr(self.quantile):.4g} % confidence" if self.quantile else ""
            for label, most, x, more in zip(labels, self.torque, tau, margin, strict=True):
                yield (np.abs(x) + more) / most - 1, f"the torque of {label}{sure}"
        if np.isfinite(self.power).any():
            for label, most, x in zip(labels, self.power, tau * self._velocities(states), strict=True):
                yield np.abs(x) / most - 1, f"the power of {label}"
        if np.isfinite(self.handle_force):
            force = np.einsum("nkr,rn->kn", self._lever(states[0]), tau)
            yield np.linalg.norm(force, axis=0) / self.handle_force - 1, "the force at the handle"

    def gradients(self, states: Array, weights: Iterator[Array]) -> Array:
        """Gradient by states, (3, active, n), of the weighted sum of these violations."""
        made = np.zeros_like(states)
        if not self._any:
            return made
        tau, row_map = self._torques(states), self.model.device.row_map
        by_torque = np.zeros_like(tau)
        if np.isfinite(self.torque).any():
            own = np.array([next(weights) for _ in tau]) / self.torque[:, None]
            by_torque += own * np.sign(tau)
            made += self._margin_slopes(states, own)
        if np.isfinite(self.power).any():
            velocity = self._velocities(states)
            own = np.array([next(weights) for _ in tau]) * np.sign(tau * velocity) / self.power[:, None]
            by_torque += own * velocity
            made[1] += row_map.T @ (own * tau)
        if np.isfinite(self.handle_force):
            own = next(weights) / self.handle_force
            lever = self._lever(states[0])
            force = np.einsum("nkr,rn->kn", lever, tau)
            along = force / np.maximum(np.linalg.norm(force, axis=0), np.finfo(float).tiny)
            by_torque += own * np.einsum("kn,nkr->rn", along, lever)
            step = DIFFERENCE_STEPS[0]
            for j in range(states.shape[1]):
                after, before = (self._lever(moved(states, 0, j, by)[0]) for by in (step, -step))
                made[0, j] += own * np.einsum("kn,nkr,rn->n", along, after - before, tau) / (2 * step)
        return made + self._by_motion(states, by_torque)

    def over_time(self, states: Array) -> list[tuple[Array, str]]:
        """Relative violations of the rms torques, (1,) each."""
        if not self._rms:
            return []
        rms = np.sqrt((self._torques(states) ** 2).mean(axis=1))
        return [
            (np.array([x / most - 1]), f"the rms torque of {label}")
            for label, x, most in zip(self.model.device.row_labels, rms, self.rms_torque, strict=True)
        ]

    def over_time_gradients(self, states: Array, weights: Iterator[Array]) -> Array:
        """Gradient by states, (3, active, n), of the weighted sum of these violations."""
        if not self._rms:
            return np.zeros_like(states)
        tau = self._torques(states)
        rms = np.maximum(np.sqrt((tau**2).mean(axis=1)), np.finfo(float).tiny)
        own = np.array([float(next(weights)[0]) for _ in tau]) / (self.rms_torque * rms * tau.shape[1])
        return self._by_motion(states, own[:, None] * tau)

    def _torques(self, states: Array) -> Array:
        return inverse_dynamics(self.model, self.beta, *(np.ascontiguousarray(x) for x in states))

    def _velocities(self, states: Array) -> Array:
        return np.asarray(self.model.device.row_map @ states[1])

    def _by_motion(self, states: Array, by_torque: Array) -> Array:
        """Gradient by states from that by the torque of each row, (rows, n)."""
        if not by_torque.any():
            return np.zeros_like(states)
        channels = CoreChannels.of(self.model, self.model.device.row_map @ states)
        by = channels.torque_slopes(raw_parameters(self.model, self.beta))
        return np.asarray(self.model.device.row_map.T @ np.einsum("rn,rscn->scn", by_torque, by))

    def _margin(self, states: Array) -> Array:
        """What the uncertainty of the parameters adds to each torque, (rows, n), N m or N."""
        if not self.quantile:
            return np.zeros((len(self.torque), states.shape[2]))
        base = self.model.device.parameters.S[:, list(self.model.base.independent_columns)]
        c, cd, cdd = self.model.device.row_map @ states
        W = regressor_columns(self.model, c, cd, cdd, base)
        return np.asarray(self.quantile * np.linalg.norm(np.einsum("rpn,pk->rnk", W, self.root), axis=2))

    def _margin_slopes(self, states: Array, weights: Array) -> Array:
        """Gradient of the weighted margins by central differences: they change slowly, few samples exceed."""
        made = np.zeros_like(states)
        if self.quantile and weights.any():
            for s, step in enumerate(DIFFERENCE_STEPS):
                for j in range(states.shape[1]):
                    after, before = (self._margin(moved(states, s, j, by)) for by in (step, -step))
                    made[s, j] = (weights * (after - before)).sum(axis=0) / (2 * step)
        return made

    def _lever(self, q: Array) -> Array:
        """Force at the handle by torques of the rows, (n, 3, rows), 1/m or 1: of a wrench with the least norm.

        Up to three rows exert a force alone, more of them a force and a moment.
        """
        J = handle_motion(self.model, q).row_jacobian
        J = J[:, :3] if J.shape[2] <= 3 else J
        return np.asarray(np.linalg.pinv(J.transpose(0, 2, 1), rcond=_SINGULAR)[:, :3])


def _root(model: DynamicModel, covariance: Array | None) -> Array:
    """Root of a covariance, (p, k); of the prior's where None.

    Raises:
        SettingError: the prior has no standard deviations.
    """
    if covariance is None:
        std = np.array([prior[1] or 0.0 if prior else 0.0 for prior in model.base_prior])
        if not std.any():
            raise SettingError(
                "torque_confidence needs the uncertainty of the parameters, and no prior has a standard deviation.",
                where="torque_confidence",
                advice="Give `std` with the priors of the device file, or continue from a result.",
            )
        return np.diag(std)
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))
