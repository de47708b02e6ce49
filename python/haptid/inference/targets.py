"""A user's own parameters: what an estimate says of the targets in the device file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import stats

from haptid._internal.arrays import Array, expect, freeze, read_only
from haptid.device.priors import combined_prior
from haptid.dynamics.base_parameters import base_combinations
from haptid.dynamics.model import DynamicModel
from haptid.errors import NoTargetsError
from haptid.estimation import Estimate, Parameter
from haptid.estimation.intervals.spread import correlations

# Relative size below which a rate counts as rounding.
ROUNDING = 1e-7


@dataclass(frozen=True, eq=False)
class Targets:
    """The targets of a device: value = C beta, with the covariance C V C'.

    Where the estimate is held to what bodies can have, covariance and intervals are those of its free fit, as its own
    are, and the intervals are widened to take in the value.

    Attributes:
        estimate: what they were made from.
        names, units: (k,).
        expressions: as the device file has them, (k,).
        C: factors of the base parameters, (k, p).
        value: (k,), SI, or per unit of command in the view that `in_command` gives.
        free: value of the free fit; `value` itself where nothing holds the estimate, (k,).
        covariance: honest, of the free fit, (k, k).
        classical_covariance: if the residual were white, (k, k).
        dof: degrees of freedom of each interval, (k,), Satterthwaite's for that combination.
        single_block: targets that one stretch of the log alone tells: their intervals are infinite.
        prior: value and deviation of each known beforehand, or None, (k,).
        notes: sentences a user should read.
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
        expect("C", self.C.shape, (k, None))
        for name in ("covariance", "classical_covariance"):
            expect(name, getattr(self, name).shape, (k, k))
        for name in ("C", "value", "free", "covariance", "classical_covariance", "freedom"):
            object.__setattr__(self, name, read_only(getattr(self, name)))

    def __len__(self) -> int:
        return len(self.names)

    def __getitem__(self, name: str) -> Parameter:
        return self.parameters[self.names.index(name)]

    @cached_property
    def se(self) -> Array:
        """Honest deviations, (k,); infinite for the lonely ones."""
        se = np.sqrt(np.diag(self.covariance))
        se[list(self.single_block)] = np.inf
        return freeze(se)

    @cached_property
    def interval95(self) -> Array:
        """Honest 95 % intervals, (k, 2)."""
        low, high = np.minimum(self.free - self._half, self.value), np.maximum(self.free + self._half, self.value)
        return freeze(np.column_stack([low, high]))

    @property
    def _half(self) -> Array:
        """Half-widths of the 95 % intervals of the free fit, (k,)."""
        return np.asarray(stats.t.ppf(0.975, self.dof) * self.se)

    @cached_property
    def correlation(self) -> Array:
        """Of the errors of the targets, (k, k)."""
        return correlations(self.covariance)

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """The targets one by one, as an estimate gives its base parameters."""
        classical = np.sqrt(np.diag(self.classical_covariance))
        constrained_outside_ci = np.abs(self.value - self.free) > self._half
        return tuple(
            Parameter(
                name=name,
                unit=self.units[k],
                grouping=self.expressions[k],
                value=float(self.value[k]),
                se=float(self.se[k]),
                classical_se=float(classical[k]),
                interval=(float(self.interval95[k, 0]), float(self.interval95[k, 1])),
                prior=self.prior[k],
                free=float(self.free[k]),
                constrained_outside_ci=bool(constrained_outside_ci[k]),
            )
            for k, name in enumerate(self.names)
        )

    def in_command(self) -> Targets:
        """The same per unit of the motors' command in place of their torque, as papers print them.

        A target that only one motor shows, or several of one gain, is divided by torque per command. The others have
        no such value: they are left out, and a note names them.
        """
        commands = [_command(self.estimate, row) for row in self.C]
        kept = [k for k, command in enumerate(commands) if command]
        factors = np.array([command[0] for command in commands if command])
        units = tuple(_command_unit(self.units[k], *command[1:]) for k, command in enumerate(commands) if command)
        lost = ", ".join(self.names[k] for k in range(len(self)) if k not in kept)
        sentence = f"Not in units of command, since motors of different gains, or coupled ones, show them: {lost}."
        return _picked(self, kept, factors, units, (sentence,) if lost else ())

    def summary(self) -> str:
        """A table as text: value, deviation, honest interval, prior, unit; then the notes."""
        head = ("", "prior", "value", "sd", "95 % interval", "unit")
        rows = [
            (
                p.name,
                "" if p.prior is None else f"{p.prior[0]:.4g}",
                f"{p.value:.4g}",
                f"{p.se:.2g}",
                f"{p.interval[0]:.4g} .. {p.interval[1]:.4g}",
                p.unit,
            )
            for p in self.parameters
        ]
        return "\n".join([*aligned([head, *rows]), *self.notes])


def targets(estimate: Estimate) -> Targets:
    """The targets in the device's file, with honest intervals.

    Args:
        estimate: of the base parameters of a device whose file has a table [targets].

    Raises:
        NoTargetsError: it has none.
        UnidentifiableTargetError: a target is not a combination of base parameters.
    """
    model = estimate.model
    C = target_map(model)
    spread = estimate.spread(C)
    wanted = model.device.targets
    alone = tuple(int(k) for k in spread.alone)
    names = ", ".join(wanted[k].name for k in alone)
    sentence = f"One stretch of the log alone tells {names}: the interval is infinite."
    return Targets(
        estimate=estimate,
        names=tuple(target.name for target in wanted),
        units=tuple(target.unit for target in wanted),
        expressions=tuple(target.text for target in wanted),
        C=C,
        value=C @ estimate.beta,
        free=C @ free_fit(estimate),
        covariance=C @ estimate.covariance @ C.T,
        classical_covariance=C @ estimate.classical_covariance @ C.T,
        dof=spread.dof,
        single_block=alone,
        prior=combined_prior(model.device, np.array([target.row for target in wanted])),
        notes=(sentence,) if alone else (),
    )


def free_fit(estimate: Estimate) -> Array:
    """Base parameters that its covariance and intervals belong to: those before they were held, (p,)."""
    return estimate.held.free if estimate.held else estimate.beta


def target_map(model: DynamicModel) -> Array:
    """C in target = C beta, (targets, base parameters).

    Raises:
        NoTargetsError: the device has no targets.
        UnidentifiableTargetError: a target is not such a combination.
    """
    if not model.device.targets:
        raise NoTargetsError(model.device.name)
    rows = np.array([target.row for target in model.device.targets])
    return base_combinations(model, [target.name for target in model.device.targets], rows)


def side_by_side(columns: Mapping[str, Targets], decimals: int = 4) -> str:
    """Targets of several estimates as one text table, with what was known beforehand first.

    Source: Tahmasebi et al. (2005), Table I, whose layout this is.

    Args:
        columns: heading and targets of each estimate, all in SI or all in units of command; a target that an
            estimate does not have is left blank.
        decimals: shown of every value.
    """
    names = list(dict.fromkeys(name for made in columns.values() for name in made.names))
    known = {p.name: p.prior[0] for made in columns.values() for p in made.parameters if p.prior is not None}
    rows = [["", "prior", *columns]]
    for name in names:
        values = [made[name].value if name in made.names else None for made in columns.values()]
        rows.append([name, *("" if v is None else f"{v:.{decimals}f}" for v in (known.get(name), *values))])
    return "\n".join(aligned(rows))


def aligned(rows: Sequence[Sequence[str]]) -> list[str]:
    """Rows of cells as lines, the first column to the left and the others to the right."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = []
    for first, *others in rows:
        cells = [first.ljust(widths[0]), *map(str.rjust, others, widths[1:])]
        lines.append("  ".join(cells).rstrip())
    return lines


def _command(estimate: Estimate, row: Array) -> tuple[float, str, str] | None:
    """Command per torque, the command's unit and the torque's, of a combination (p,); None where motors differ."""
    model, found = estimate.model, set()
    for motor in estimate.observation.motors:
        if not row[motor.columns].any():
            continue
        k = model.device.row_names.index(motor.name)
        rates = model.device.drive_rates[:, k]
        loads = np.flatnonzero(np.abs(rates) > ROUNDING * np.abs(rates).max())
        if len(loads) != 1:
            return None
        drive = model.device.drives[loads[0]]
        torque = float(rates[loads[0]]) * drive.gear * drive.gain
        found.add((1.0 / torque, drive.unit, motor.unit))
    return found.pop() if len(found) == 1 else None


def _command_unit(unit: str, command: str, torque: str) -> str:
    """Unit of a parameter per unit of command in place of torque: V, or `kg m^2 V/(N m)`."""
    if command == torque:
        return f"{unit} of command"
    return command if unit == torque else f"{unit} {command}/({torque})"


def _picked(made: Targets, kept: list[int], factors: Array, units: tuple[str, ...], notes: tuple[str, ...]) -> Targets:
    """Some of the targets, each times its factor."""
    square = np.ix_(kept, kept)
    outer = np.outer(factors, factors)
    known = [made.prior[k] for k in kept]
    return replace(
        made,
        names=tuple(made.names[k] for k in kept),
        units=units,
        expressions=tuple(made.expressions[k] for k in kept),
        C=made.C[kept] * factors[:, None],
        value=made.value[kept] * factors,
        free=made.free[kept] * factors,
        covariance=made.covariance[square] * outer,
        classical_covariance=made.classical_covariance[square] * outer,
        dof=made.dof[kept],
        single_block=tuple(kept.index(k) for k in made.single_block if k in kept),
        prior=tuple(_times(prior, factor) for prior, factor in zip(known, factors, strict=True)),
        notes=(*made.notes, *notes),
    )


def _times(prior: tuple[float, float | None] | None, factor: float) -> tuple[float, float | None] | None:
    if prior is None:
        return None
    value, se = prior
    return float(value * factor), None if se is None else float(se * abs(factor))
