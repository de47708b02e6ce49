"""Joints that stand still, or nearly, in every log of a study, and what to do about them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import numpy as np

from haptid.dynamics.model import DynamicModel
from haptid.errors import IdentifiabilityError
from haptid.log import Log
from haptid.log.held_joints import held_joints
from haptid.study.study import Study

# Travel of a joint, rad or m, up to which it stands still: that of a constant which was resampled.
_STILL = 1e-9


def refuse_held_joints(model: DynamicModel, logs: Sequence[Log], study: Study) -> None:
    """Refuse logs of the fit in which a joint with dry friction is held while others move.

    Its friction takes whatever torque comes, and what its encoder shows is trembling, which is faster than the motion:
    filters would follow it. A study that gives `reversal_speed` says itself which rows are at rest.

    Raises:
        IdentifiabilityError: naming the joints and how to hold them in the device file.
    """
    dry = any(model.coulomb_terms(row) for row in range(len(model.device.row_names)))
    travels = _travels(model, study.of_fit(logs))
    if not travels or not dry or "reversal_speed" in study.treatment:
        return
    held = held_joints(travels, [model.device.joints[k].prismatic for k in model.device.active])
    if held:
        most = max(travels[k] for k in held)
        why = (
            f" by more than {most:.2g}, others by {max(travels):.2g} (rad or m): dry friction may take any torque there"
        )
        units = " If their channels are in another unit than the others', give `unit` as a list."
        raise _refused(model, study, logs, held, why, units)


@contextmanager
def naming_still_joints(model: DynamicModel, logs: Sequence[Log], study: Study) -> Iterator[None]:
    """Where parameters are not identifiable, name the joints that stand still in every log, and what to do."""
    try:
        yield
    except IdentifiabilityError as error:
        if not (still := still_joints(model, logs, study)):
            raise
        raise _refused(model, study, logs, still, ", so their parameters are not identifiable") from error


def still_joints(model: DynamicModel, logs: Sequence[Log], study: Study) -> list[int]:
    """Joints, by number among the active ones, that stand still in every log of the fit while another moves."""
    travels = _travels(model, study.of_fit(logs))
    still = [k for k, travel in enumerate(travels) if travel < _STILL]
    return still if len(still) < len(travels) else []


def _travels(model: DynamicModel, logs: Sequence[Log]) -> list[float]:
    """Largest travel of each joint in any log, rad or m; none where the positions are not those of the joints."""
    count = len(model.device.active)
    if any(not isinstance(log.position, np.ndarray) or log.position.shape[1] != count for log in logs):
        return []
    return [max(float(np.ptp(log.position[:, k])) for log in logs) for k in range(count)]


def _refused(
    model: DynamicModel, study: Study, logs: Sequence[Log], still: Sequence[int], why: str, further: str = ""
) -> IdentifiabilityError:
    names = [model.device.joints[k].name for k in model.device.active]
    start = study.of_fit(logs)[0].position[0]
    options = " ".join(f"--hold {names[k]}={float(start[k]):.6g}" for k in still)
    moving = ", ".join(name for k, name in enumerate(names) if k not in still)
    return IdentifiabilityError(
        f"{study.path}: no log moves {', '.join(names[k] for k in still)}{why}.",
        where=tuple(names[k] for k in still),
        limit="motion of every joint in some log",
        advice=f"For a model of {moving} alone, import the robot with `{options}` and map the channels of "
        f"{moving}; for one of the whole robot, add logs that move the others.{further}",
    )
