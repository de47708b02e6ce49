"""Targets: the combinations of standard parameters that a device file names, estimated with confidence intervals."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property

import numpy as np

from haptid._internal.arrays import Array, freeze, freeze_fields
from haptid._internal.display import Overview, displayed
from haptid._internal.late import dataclass
from haptid.device.priors import combined_prior
from haptid.dynamics.base_parameters import base_combinations
from haptid.dynamics.model import DynamicModel
from haptid.errors import IncompleteDeviceError, index_of
from haptid.estimation import BetweenLogs, Estimate, Parameter
from haptid.estimation.least_squares import untold
from haptid.estimation.parameter import not_told_from_zero
from haptid.observation.plan import Block
from haptid.uncertainty.quantities import LEVEL, Quantities, aligned, half_width

# A drive rate, or a factor of a target, below this share of the largest is rounding error.
_ROUNDING = 1e-7


@displayed
@dataclass(frozen=True, eq=False)
class Targets:
    """The targets of a device: linear combinations C beta of the base parameters, with covariance C V C'.

    Of a constrained estimate, covariance and intervals are those of the unconstrained fit, and the intervals are
    widened to include the value.

    Attributes:
        estimate: of the base parameters.
        names, units: (k,).
        expressions: as the device file has them, (k,).
        C: factors of the base parameters, (k, p).
        value: (k,), SI, or per unit of command (see `in_command`).
        free: value of the unconstrained fit, (k,).
        covariance: cluster-robust, of the unconstrained fit, (k, k).
        classical_covariance: classical, if the residuals were white, (k, k).
        dof: degrees of freedom of each interval, Satterthwaite's for that combination, (k,).
        single_block: targets whose standard error cannot be estimated: a single time block has information on them.
        prior: prior value and standard deviation of each, or None, (k,).
        notes: sentences for the user.
    """

    estimate: Estimate
    names: tuple[str, ...]
    units: tuple[str, ...]
    expressions: tuple[str, ...]
    C: Array
    value: Array
    free: Array
    covariance: Array
    classical_covariance: Array
    dof: Array
    single_block: tuple[int, ...]
    prior: tuple[tuple[float, float | None] | None, ...]
    notes: tuple[str, ...]

    def __post_init__(self) -> None:
        k = len(self.names)
        freeze_fields(self, "value", "free", "dof", C=(k, None), covariance=(k, k), classical_covariance=(k, k))

    def __len__(self) -> int:
        return len(self.names)

    def __getitem__(self, name: str) -> Parameter:
        return self.parameters[index_of(name, self.names, "target")]

    @property
    def unconstrained(self) -> Quantities:
        """The targets of the unconstrained fit, with covariance and degrees of freedom."""
        return Quantities(self.names, self.units, self.free, self.covariance, self.dof, self.single_block)

    @property
    def base(self) -> None:
        """None: targets are compared by name and unit."""
        return

    @property
    def blocks(self) -> tuple[Block, ...]:
        """Time blocks of the logs that they were made from."""
        return self.estimate.blocks

    @property
    def constrained(self) -> bool:
        """Whether a constraint is active in the estimate."""
        return self.estimate.constrained

    @cached_property
    def se(self) -> Array:
        """Cluster-robust standard errors, (k,); infinite where they cannot be estimated."""
        return self.unconstrained.se

    def conf_int(self, level: float = LEVEL) -> Array:
        """Confidence intervals, (k, 2)."""
        half = half_width(self.se, self.dof, level)
        low, high = np.minimum(self.free - half, self.value), np.maximum(self.free + half, self.value)
        return freeze(np.column_stack([low, high]))

    @cached_property
    def unexcited(self) -> tuple[int, ...]:
        """Indices of targets not told from zero that are combined of base parameters which are not excited."""
        share = np.abs(self.C) / np.abs(self.C).max(axis=1, keepdims=True, initial=np.finfo(float).tiny)
        on_open = (share[:, list(self.estimate.unexcited)] > _ROUNDING).any(axis=1)
        unsure = not_told_from_zero(self.value, self.se, self.conf_int())
        return tuple(int(k) for k in np.flatnonzero(on_open & unsure))

    @cached_property
    def between_logs(self) -> BetweenLogs | None:
        """Scatter between logs, and intervals of a repeat; None with fewer than three logs."""
        return self.estimate.between_logs_of(self.unconstrained, self.value, self.C)

    @cached_property
    def correlation(self) -> Array:
        """Correlations of the errors, (k, k)."""
        return self.unconstrained.correlation

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """The targets one by one, as an estimate has its base parameters."""
        classical = np.sqrt(np.diag(self.classical_covariance))
        constrained_outside_ci = np.abs(self.value - self.free) > half_width(self.se, self.dof)
        return tuple(
            Parameter(
                name=name,
                unit=self.units[k],
                grouping=self.expressions[k],
                value=float(self.value[k]),
                se=float(self.se[k]),
                classical_se=float(classical[k]),
                prior=self.prior[k],
                free=float(self.free[k]),
                constrained_outside_ci=bool(constrained_outside_ci[k]),
                owner=self,
                index=k,
            )
            for k, name in enumerate(self.names)
        )

    def in_command(self) -> Targets:
        """The same per unit of the motors' command instead of their torque, as published tables have them.

        A target that acts on one motor, or on several of one gain, is divided by torque per command. The others have no
        such value: they are left out, and a note names them.
        """
        commands = [_command(self.estimate, row) for row in self.C]
        in_commands = [k for k, command in enumerate(commands) if command]
        factors = np.array([command[0] for command in commands if command])
        units = tuple(_command_unit(self.units[k], *command[1:]) for k, command in enumerate(commands) if command)
        lost = ", ".join(self.names[k] for k in range(len(self)) if k not in in_commands)
        sentence = f"Not in units of command, since they act on motors of different gains or on coupled motors: {lost}."
        return _picked(self, in_commands, factors, units, (sentence,) if lost else ())

    def summary(self) -> str:
        """A text table: prior, value, standard error, confidence interval, unit; then the notes."""
        head = ("", "prior", "value", "std err", "95 % interval", "unit")
        rows = [
            (
                p.name,
                "" if p.prior is None else f"{p.prior[0]:.4g}",
                f"{p.value:.4g}",
                f"{p.se:.2g}",
                f"{p.conf_int()[0]:.4g} .. {p.conf_int()[1]:.4g}",
                p.unit,
            )
            for p in self.parameters
        ]
        return "\n".join([*aligned([head, *rows]), *self.notes])

    def _shown(self) -> Overview:
        return self.unconstrained._shown()


def targets(estimate: Estimate) -> Targets:
    """Estimates of the targets in the device file, with cluster-robust confidence intervals.

    Args:
        estimate: of a device whose file has a table [targets].

    Raises:
        IncompleteDeviceError: there is none.
        IdentifiabilityError: a target is not a linear combination of base parameters.
    """
    model = estimate.model
    C = target_map(model)
    spread = estimate.spread(C)
    wanted = model.device.targets
    alone = tuple(int(k) for k in spread.alone)
    names = ", ".join(wanted[k].name for k in alone)
    sentence = f"{names} excited in a single time block: the standard error cannot be estimated (interval: unbounded)."
    if set(estimate.zero) & set(estimate.single_block):  # left out because the rows do not tell them
        alone = tuple(sorted({*alone, *untold(estimate.observation.stack()[:-1, :-1], C).tolist()}))
    return Targets(
        estimate=estimate,
        names=tuple(target.name for target in wanted),
        units=tuple(target.unit for target in wanted),
        expressions=tuple(target.text for target in wanted),
        C=C,
        value=C @ estimate.beta,
        free=C @ estimate.free,
        covariance=C @ estimate.covariance @ C.T,
        classical_covariance=C @ estimate.classical_covariance @ C.T,
        dof=spread.dof,
        single_block=alone,
        prior=combined_prior(model.device, np.array([target.row for target in wanted])),
        notes=(sentence,) if names else (),
    )


def target_map(model: DynamicModel) -> Array:
    """Matrix C of targets = C beta, (targets, base parameters).

    Raises:
        IncompleteDeviceError: the device has no targets.
        IdentifiabilityError: a target is not a linear combination of base parameters.
    """
    if not model.device.targets:
        raise IncompleteDeviceError(
            f"device {model.device.name!r} has no targets.",
            where=model.device.name,
            advice='Write a table [targets] in its file, such as pi_4 = "2*(L1*MX2 + L3*MX3)", and read it again.',
        )
    rows = np.array([target.row for target in model.device.targets])
    return base_combinations(model, [target.name for target in model.device.targets], rows)


def _command(estimate: Estimate, row: Array) -> tuple[float, str, str] | None:
    """Command per torque, and the units of both, for a combination (p,); None where motors differ."""
    model, commands = estimate.model, set()
    for motor in estimate.observation.motors:
        if not row[motor.columns].any():
            continue
        k = model.device.row_names.index(motor.name)
        rates = model.device.drive_rates[:, k]
        loads = np.flatnonzero(np.abs(rates) > _ROUNDING * np.abs(rates).max())
        if len(loads) != 1 or model.device.drive_varies[:, k].any():
            return None
        drive = model.device.drives[loads[0]]
        torque = float(rates[loads[0]]) * drive.gear_ratio * drive.torque_constant
        commands.add((1.0 / torque, drive.command_unit, motor.unit))
    return commands.pop() if len(commands) == 1 else None


def _command_unit(unit: str, command: str, torque: str) -> str:
    """Unit of a parameter per unit of command instead of torque: V, or `kg m^2 V/(N m)`."""
    if command == torque:
        return f"{unit} of command"
    return command if unit == torque else f"{unit} {command}/({torque})"


def _picked(
    all_targets: Targets, indices: list[int], factors: Array, units: tuple[str, ...], notes: tuple[str, ...]
) -> Targets:
    """Some of the targets, each times its factor."""
    square = np.ix_(indices, indices)
    outer = np.outer(factors, factors)
    known = [all_targets.prior[k] for k in indices]
    return replace(
        all_targets,
        names=tuple(all_targets.names[k] for k in indices),
        units=units,
        expressions=tuple(all_targets.expressions[k] for k in indices),
        C=all_targets.C[indices] * factors[:, None],
        value=all_targets.value[indices] * factors,
        free=all_targets.free[indices] * factors,
        covariance=all_targets.covariance[square] * outer,
        classical_covariance=all_targets.classical_covariance[square] * outer,
        dof=all_targets.dof[indices],
        single_block=tuple(indices.index(k) for k in all_targets.single_block if k in indices),
        prior=tuple(_times(prior, factor) for prior, factor in zip(known, factors, strict=True)),
        notes=(*all_targets.notes, *notes),
    )


def _times(prior: tuple[float, float | None] | None, factor: float) -> tuple[float, float | None] | None:
    if prior is None:
        return None
    value, se = prior
    return float(value * factor), None if se is None else float(se * abs(factor))
