"""Open-loop output error by multiple shooting: simulation under the measured torque, over short segments."""

from __future__ import annotations

from dataclasses import field, replace

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.dynamics.forward import ForwardDynamics, sets_of
from haptid.dynamics.model import DynamicModel
from haptid.estimation.methods.simulation_based import SimulationBased, base_columns, by_block
from haptid.motion.channels import coordinate_torque, position_map
from haptid.motion.motion import Motion
from haptid.observation.observation import Observation
from haptid.observation.r_factor import r_factor
from haptid.simulation import Segments, measured_state, open_loop, sensitivity

# Least standard deviation of position noise, relative to that of the positions.
_LEAST_NOISE = 1e-7


@dataclass(frozen=True)
class OutputErrorMethod(SimulationBased):
    """Open-loop output error by multiple shooting: no controller is needed.

    The initial state of every segment is near the treated one, estimated with the parameters and eliminated segment by
    segment. Positions as recorded are compared, in units of what the treatment removed from them. Torque noise
    integrates over a segment to errors that are not white, which costs precision: more in longer segments, while
    shorter ones contain less information on the parameters.

    Sources: Bock (1983), multiple shooting; Jategaonkar (2015), Flight Vehicle System Identification, section 4.5.

    Attributes:
        segment: length of each, s.
        most: largest number of passes; reversals of motion make the passes oscillate.
    """

    segment: float = 0.1
    most: int = field(default=20, kw_only=True)

    def linearised_rows(self, observation: Observation, smoothed: DynamicModel, beta: Array) -> Observation:
        """Rows of position, each coordinate's in units of its noise."""
        p, size = len(observation.base), len(observation.blocks)
        r_factors, counts = np.zeros((size, p + 1, p + 1)), np.zeros(size, dtype=int)
        for motion in observation.motions:
            segments = Segments.of(
                len(motion.unbroken("a method that simulates")), max(2, round(self.segment / motion.dt)), 0
            )
            J, error = multiple_shooting(observation.model, smoothed, motion, beta, segments)
            for k, block in enumerate(segment_blocks(observation, motion, segments)):
                if block is not None:
                    rows = np.column_stack([J[..., k].reshape(-1, J.shape[2]), error[..., k].ravel()])
                    first = J.shape[2] - p  # initial states, eliminated
                    left = r_factor(np.column_stack([rows[:, p:-1], rows[:, :p], rows[:, -1] + rows[:, :p] @ beta]))
                    r_factors[block] = r_factor(np.concatenate([r_factors[block], left[first:, first:]]))
                    counts[block] += len(rows) - first
        return by_block(observation, self.name, r_factors, counts)


def multiple_shooting(
    model: DynamicModel, smoothed: DynamicModel, motion: Motion, beta: Array, segments: Segments
) -> tuple[Array, Array]:
    """Of every segment, derivatives of positions (steps, n, p + 2n, segments), and errors (steps, n, segments).

    In units of each coordinate's noise; zero where a step is past the end.
    """
    forward = ForwardDynamics(smoothed, sets_of(model, beta))
    treated, cd = measured_state(model, motion)
    start = (treated[:, segments.sample[0]], cd[:, segments.sample[0]])
    steps = open_loop(forward, motion, sampled_torque(model, motion), start, segments)
    course = sensitivity(forward, None, motion, steps, base_columns(model))
    raw = recorded_positions(model, motion)
    scale = 1.0 / position_noise(raw, treated, motion)
    own = segments.own & (segments.sample >= motion.usable[0]) & (segments.sample < motion.usable[1])
    error = (np.moveaxis(raw[:, segments.sample], 0, 1) - steps.c) * scale[None, :, None] * own[:, None]
    return course.c * scale[None, :, None, None] * own[:, None, None], error


def sampled_torque(model: DynamicModel, motion: Motion) -> Array:
    """Torque of the rows, constant from each sample to the next, (n, samples), N m or N."""
    if motion.log is not None:  # a command is held from sample to sample
        return coordinate_torque(model.device, replace(motion, tau=motion.log.torque), 0, len(motion))
    tau = coordinate_torque(model.device, motion, 0, len(motion))
    return 0.5 * (tau + np.column_stack([tau[:, 1:], tau[:, -1]]))


def recorded_positions(model: DynamicModel, motion: Motion) -> Array:
    """Positions of the coordinates before treatment, (n, samples), rad or m."""
    q = motion.q if motion.log is None else motion.log.position
    return position_map(model.device, motion)(np.ascontiguousarray(q.T))


def position_noise(raw: Array, treated: Array, motion: Motion) -> Array:
    """Standard deviation of what the treatment removed from the positions, (n,), rad or m."""
    low, high = motion.usable
    noise = (raw - treated)[:, low:high].std(axis=1)
    return np.asarray(np.maximum(noise, _LEAST_NOISE * np.maximum(raw.std(axis=1), 1e-3)))


def segment_blocks(observation: Observation, motion: Motion, segments: Segments) -> list[int | None]:
    """Index of the block that each segment lies in, None where there is none."""
    own = [(k, block) for k, block in enumerate(observation.blocks) if block.log == motion.name]
    middle = motion.t0 + motion.dt * segments.sample[len(segments.sample) // 2]
    return [next((k for k, block in own if block.start <= t < block.stop), None) for t in middle]
