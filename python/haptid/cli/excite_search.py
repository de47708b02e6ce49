"""Searches of `haptid excite`: exciting motions and those of other families, and what they are predicted to bring."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from haptid._internal.late import dataclass
from haptid.cli.options import numbers

if TYPE_CHECKING:
    from haptid._internal.arrays import Array
    from haptid.device.priors import PriorBody
    from haptid.dynamics.model import DynamicModel
    from haptid.experiment.bench import Setup
    from haptid.experiment.excitation import (
        Criterion,
        Excitation,
        FourierSeries,
        FurtherMotions,
        Limits,
        LogInformation,
        PlannedMotion,
        Search,
        TrianglesWithSines,
    )
    from haptid.experiment.excitation.treated import TreatedNoise

# Divisor of the number of evaluations for the motion along which noise is expected.
_QUICKLY = 4


@dataclass(frozen=True, eq=False)
class Request:
    """What is searched: motions of a family within limits, by a criterion.

    Attributes:
        columns: names of the base parameters that count; None for all.
        beta: values of the base parameters, (p,), SI; None for the prior's.
    """

    model: DynamicModel
    family: FourierSeries | TrianglesWithSines
    within: Limits
    criterion: Criterion
    columns: tuple[str, ...] | None
    beta: Array | None
    search: Search

    def design(self, beta: Array | None, progress: Callable[[float, float], None]) -> Excitation:
        """The best motion for values of the base parameters."""
        from haptid.experiment.excitation import design_excitation

        return design_excitation(
            self.model,
            self.family,
            self.within,
            criterion=self.criterion,
            columns=self.columns,
            beta=beta,
            search=self.search,
            progress=progress,
        )


@dataclass(frozen=True, eq=False)
class Expected:
    """What is known of a log before it is recorded: the set-up of an experiment, and a given treatment."""

    setup: Setup
    given: Mapping[str, Any]

    def noise(self, motion: Excitation) -> TreatedNoise | None:
        """Noise and treatment of the motion's log; None where they cannot be told."""
        from haptid.experiment.excitation.expected import expected_noise

        return expected_noise(self.setup, motion, self.given)


def searched(
    request: Request,
    count: int,
    after: Path | None,
    accuracy: float | None,
    expected: Expected | None,
    progress: Callable[[float, float], None],
) -> tuple[tuple[Excitation, ...], FurtherMotions | None]:
    """Exciting motions, each given those before it and the logs of a result, and what they are predicted to bring."""
    from haptid.experiment.excitation import next_motions

    if count == 0:
        return (), None
    if after is None and count == 1:
        motion = request.design(request.beta, progress)
        return (motion,), _predicted(request, motion, accuracy, expected)
    known, basis = _known(request, after, expected)
    further = next_motions(
        known,
        request.family,
        request.within,
        parameters=request.columns if after is not None or request.columns else known.valued,
        accuracy=accuracy,
        count=count,
        search=request.search,
        progress=progress,
    )
    return further.motions, replace(further, basis=basis)


def _predicted(
    request: Request, motion: Excitation, accuracy: float | None, expected: Expected | None
) -> FurtherMotions | None:
    """What a motion is predicted to bring before there is a log; None where its noise is not known."""
    from haptid.experiment.excitation.expected import expected_motions

    if expected is None or (noise := expected.noise(motion)) is None:
        return None
    return expected_motions(expected.setup, noise, (motion,), request.columns, accuracy)


def _known(request: Request, after: Path | None, expected: Expected | None) -> tuple[LogInformation, str | None]:
    """What the logs of a result say; without one, values, and the noise that is expected of a motion found quickly."""
    from haptid.experiment.excitation import LogInformation
    from haptid.experiment.excitation.expected import basis, expected_information
    from haptid.results.information import log_information
    from haptid.results.result import Result

    if after is not None:
        return log_information(Result.load(after), request.model), None
    if expected is not None:
        search = replace(request.search, tries=max(1, request.search.tries // _QUICKLY))
        noise = expected.noise(replace(request, search=search).design(request.beta, lambda *_: None))
        if noise is not None:
            return expected_information(expected.setup, noise), basis(noise)
    return LogInformation.none(request.model, request.beta), None


def others(
    wanted: dict[str, int | bool], request: Request, motions: Sequence[Excitation], start: str | None
) -> dict[str, PlannedMotion]:
    """Motions of the other families, about the pose in which the first motion rests."""
    from haptid.experiment.excitation import CAMPAIGN_FAMILIES, resting_pose

    rest = resting_pose(motions[0]) if motions else None
    if start is not None:
        rest = numbers("--start", start, "positions of the active joints", len(request.model.device.active))
    return {
        name: CAMPAIGN_FAMILIES[name].make(
            request.model,
            request.within,
            rest=rest,
            beta=request.beta,
            **({"count": count} if name == "poses" else {}),
        )
        for name, count in wanted.items()
    }


def loaded(
    request: Request,
    load: tuple[str, PriorBody],
    motions: Sequence[Excitation],
    progress: Callable[[float, float], None],
) -> Excitation:
    """The motion with a body on a link: searched again where its torque counts in the limits, else the first one."""

    from haptid.observation import payload_torque

    model, within = request.model, request.within
    load_torque = payload_torque(model, *load)
    if all(x is None for x in (within.torque, within.rms_torque, within.power, within.handle_force)):
        return motions[0]
    prior = model.prior_beta
    return request.design(load_torque + (prior if request.beta is None else request.beta), progress)
