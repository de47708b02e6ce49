"""Held poses: found in a continuous log from the stillness of its encoders, or read from a table with one row a pose.

At rest the torque of a joint is gravity, springs and friction. Friction opposes the motion by which the pose was
reached: poses that are reached from both sides separate it from gravity. A joint that has not moved since the pose
before keeps the torque of that pose, as far as its friction carries the difference, so its row is not used.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from haptid._internal.arrays import Array, freeze_fields, positive
from haptid._internal.late import dataclass
from haptid._internal.signals import running_maximum
from haptid.device import Device
from haptid.errors import LogChannelError, LogDataError, LogMismatchError, NoRowsError
from haptid.log import Channels, Log, Signal
from haptid.log.checks import all_usable
from haptid.log.file_format import format_of, sha256_of
from haptid.log.formats.sniff import RawChannel
from haptid.log.inspection import ChannelKind
from haptid.motion.channels import coordinate_torque, position_map
from haptid.motion.filters import bad_setting
from haptid.motion.motion import Motion
from haptid.motion.treatment import Treatment

# A channel is still where it stays within so many of its smallest steps, and within this share of its whole span.
STEPS_HELD, SPAN_HELD = 3, 1e-3
# Rounding of a position, relative to the largest.
ROUNDING_HELD = 1e-12
# Poses that agree within this share of every coordinate's span are one configuration.
_SAME_POSE = 0.02
# Batches by whose means the standard error of a hold's torque is estimated; fewer samples have no batches.
NOISE_BATCHES = 8
# Minimum number of poses.
LEAST_POSES = 3


@dataclass(frozen=True)
class HoldDetection:
    """Criteria by which a range of samples is a held pose.

    Attributes:
        hold_s: least duration of a hold, s.
        settle_s: left out at both ends of a hold, where the torque settles, or rises before the joint moves, s.
        still: largest range of every position channel in a hold, rad or m, one for all or one for each; None is three
            of its smallest steps or a thousandth of its span, whichever is larger.
    """

    hold_s: float = 0.5
    settle_s: float = 0.1
    still: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        if not positive(self.hold_s):
            raise bad_setting("hold_s", self.hold_s, "a time above zero, s")
        if not (self.settle_s == 0 or positive(self.settle_s)) or 2 * self.settle_s >= self.hold_s:
            raise bad_setting("settle_s", self.settle_s, f"a time below half of hold_s = {self.hold_s:g} s")
        if self.still is not None and not all(positive(x) for x in self.still):
            raise bad_setting("still", self.still, "ranges above zero, rad or m")

    def bands(self, log: Log) -> Array:
        """Largest range of each position channel in a hold, (channels,), rad or m."""
        channels = log.position.shape[1]
        if self.still is not None:
            if len(self.still) not in (1, channels):
                raise bad_setting("still", self.still, f"one range, or one for each of {channels} channels")
            return np.array(np.broadcast_to(self.still, (channels,)), dtype=float)
        bands = []
        for (low, high), column in zip(log.spans, np.asarray(log.position[:]).T, strict=True):
            steps = np.abs(np.diff(column))
            smallest = float(steps[steps > 0].min(initial=np.inf)) if steps.any() else 0.0
            # A channel that is constant differs from its own mean by rounding.
            bands.append(max(STEPS_HELD * smallest, SPAN_HELD * (high - low), ROUNDING_HELD * max(abs(low), abs(high))))
        return np.array(bands)


@dataclass(frozen=True, eq=False)
class Poses:
    """Held poses, averaged: one row each.

    Attributes:
        log: of the means, one sample a pose; its times count the poses.
        c: positions of the torque rows' coordinates, (n, coordinates), rad or m.
        tau: their torques, (n, coordinates), N m or N; zero where not measured.
        se: standard error of these means from the scatter within each hold, (n, coordinates); NaN where unknown.
        approach: direction in which each coordinate moved last: 1, -1; 0 where not known; NaN where it has not moved
            since the pose before, (n, coordinates).
        start, stop: of each hold, s; the number of the row in a table, (n,).
        samples: averaged in each, (n,).
        configuration: index of each pose's configuration: poses reached from several sides share one, (n,).
        notes: for the user.
    """

    log: Log
    c: Array
    tau: Array
    se: Array
    approach: Array
    start: Array
    stop: Array
    samples: np.ndarray
    configuration: np.ndarray
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        shape = np.shape(self.c)
        freeze_fields(self, c=shape, tau=shape, se=shape, approach=shape)

    def __len__(self) -> int:
        return len(self.c)

    @property
    def configurations(self) -> int:
        """Number of configurations."""
        return int(self.configuration.max(initial=-1)) + 1

    def pick(self, rows: np.ndarray) -> Poses:
        """Some poses, by index; configurations keep their index."""
        arrays = {
            name: getattr(self, name)[rows]
            for name in ("c", "tau", "se", "approach", "start", "stop", "samples", "configuration")
        }
        return replace(self, **arrays)

    def table(self) -> tuple[list[str], list[list[float]]]:
        """Header and rows of a table with one row a pose, in SI, at the side of the log's channels."""
        position, torque = self.log.channels.position, self.log.channels.torque
        axes = [str(k + 1) for k in range(self.c.shape[1])]
        head = ["start", "stop", "samples", "configuration", *position.channels, *torque.channels]
        head += [f"approach{k}" for k in axes]
        rows = np.column_stack(
            [
                *(self.start, self.stop, self.samples, self.configuration),
                *(np.asarray(self.log.position), np.asarray(self.log.torque), self.approach),
            ]
        )
        return head, rows.tolist()


def find_poses(device: Device, log: Log, detection: HoldDetection | None = None) -> Poses:
    """The poses that a continuous log holds.

    Args:
        device: whose log it is.
        log: with rests at the poses and moves between them.
        detection: what counts as a hold; the default where None.

    Raises:
        NoRowsError: fewer than three holds.
        LogMismatchError: the channels do not fit the device.
    """
    detection = detection or HoldDetection()
    bands = detection.bands(log)
    q = np.asarray(log.position[:])
    holds = _holds(q, bands, max(2, round(detection.hold_s / log.dt)))
    if len(holds) < LEAST_POSES:
        shown = ", ".join(f"{band:.2g}" for band in bands)
        raise NoRowsError(
            f"{log.path.name}: {len(holds)} rests of {detection.hold_s:g} s or longer with positions within {shown} "
            f"were found; at least {LEAST_POSES} are required.",
            where=log.path,
            found=len(holds),
            limit=LEAST_POSES,
            advice="Hold each pose longer, lower `hold_s`, or raise `still`.",
        )
    motion = Motion(log.dt, q, log.torque, Treatment(cutoff_hz=None), log, float(log.t[0]))
    c = np.asarray(position_map(device, motion)(np.ascontiguousarray(q.T))).T
    tau = np.asarray(coordinate_torque(device, motion, 0, len(q))).T
    edge = round(detection.settle_s / log.dt)
    interiors = [(low + edge, high - edge) for low, high in holds]
    mean = [[x[low:high].mean(axis=0) for low, high in interiors] for x in (c, tau, q, np.asarray(log.torque[:]))]
    edges = [(float(log.t[low]), float(log.t[high - 1])) for low, high in holds]
    averaged = replace(
        log, t=np.arange(float(len(holds))), position=np.array(mean[2]), torque=np.array(mean[3]), notes=log.notes
    )
    width = _coordinate_bands(device, motion, bands)
    return Poses(
        log=averaged,
        c=np.array(mean[0]),
        tau=np.array(mean[1]),
        se=np.array([_standard_error(tau[low:high]) for low, high in interiors]),
        approach=_approach(c, holds, width),
        start=np.array([low for low, _ in edges]),
        stop=np.array([high for _, high in edges]),
        samples=np.array([high - low for low, high in interiors]),
        configuration=_configurations(np.array(mean[0]), width),
        notes=(f"{len(holds)} held poses were found in {log.path.name}.",),
    )


def read_poses(path: str | os.PathLike[str], device: Device, channels: Channels, approach: Sequence[str] = ()) -> Poses:
    """Read a table with one row a pose.

    Args:
        path: CSV, Parquet, MAT, NPZ or HDF5.
        device: whose poses.
        channels: of positions and torques; time is not read.
        approach: channels with the direction in which each coordinate moved last, 1, -1, 0 (not known), or empty (it
            has not moved); none where all are unknown.

    Raises:
        LogError: the file cannot be read, a channel is missing, or a value is not finite.
        NoRowsError: fewer than three rows.
    """
    path, names = Path(path), [*channels.position.channels, *channels.torque.channels]
    kind = format_of(path)
    columns = kind.columns(path, [*names, *approach])
    for name in (*names, *approach):
        if name not in columns:
            raise LogChannelError(
                f"{path}: there is no channel {name!r}.",
                where=name,
                found=name,
                limit=tuple(kind.names(path)),
                advice=f"It has {', '.join(kind.names(path)[:12])}.",
            )
        if name in names and not all_usable(columns[name]):
            raise LogDataError(
                f"{path}: channel {name!r} has a value that is not a finite number.",
                where=name,
                advice="Leave out the poses that were not recorded.",
            )
    count = len(columns[names[0]])
    if count < LEAST_POSES:
        raise NoRowsError(
            f"{path}: {count} poses; at least {LEAST_POSES} are required.", where=path, found=count, limit=LEAST_POSES
        )
    position = _signal_columns(channels.position, "position", columns)
    torque = _signal_columns(channels.torque, "torque", columns)
    log = Log(path, sha256_of(path), np.arange(float(count)), position, torque, channels)
    motion = Motion(1.0, log.position, log.torque, Treatment(cutoff_hz=None), log)
    c = np.asarray(position_map(device, motion)(np.ascontiguousarray(position.T))).T
    tau = np.asarray(coordinate_torque(device, motion, 0, count)).T
    known = np.zeros(c.shape)
    if approach:
        known = np.sign(np.column_stack([np.asarray(columns[name], dtype=float) for name in approach]))
        if known.shape != c.shape:
            raise bad_setting("approach", tuple(approach), f"{c.shape[1]} channels, one for each coordinate")
    index = np.arange(float(count))
    return Poses(
        log=log,
        c=c,
        tau=tau,
        se=np.full(c.shape, np.nan),
        approach=known,
        start=index,
        stop=index,
        samples=np.ones(count, dtype=int),
        configuration=_configurations(c, np.zeros(c.shape[1])),
    )


def _signal_columns(signal: Signal, kind: ChannelKind, columns: Mapping[str, RawChannel]) -> Array:
    """The channels of a signal in SI, (n, channels)."""
    named = zip(signal.channels, signal.scales(kind), signal.gain, signal.offset, strict=True)
    return np.column_stack([np.asarray(columns[n], dtype=float) * si * gain + offset for n, si, gain, offset in named])


def join_poses(first: Poses, *others: Poses) -> Poses:
    """The poses of several logs of one device as those of one; a configuration is of one log.

    Raises:
        LogMismatchError: the logs differ in unit or side of their channels.
    """
    if not others:
        return first
    all_of = (first, *others)
    kinds = {(p.log.channels.position.side, p.log.channels.torque.side, p.log.channels.torque_unit) for p in all_of}
    if len(kinds) > 1:
        raise LogMismatchError(
            "the logs of poses differ in side or unit of their channels.",
            found=tuple(sorted(kinds)),
            advice="Map the channels of all at one side, in one unit.",
        )
    before = np.cumsum([0, *(p.configurations for p in all_of[:-1])])
    joined = {
        name: np.concatenate([getattr(p, name) for p in all_of])
        for name in ("c", "tau", "se", "approach", "start", "stop", "samples")
    }
    log = replace(
        first.log,
        sha256=hashlib.sha256("".join(p.log.sha256 for p in all_of).encode()).hexdigest(),
        t=np.arange(float(len(joined["c"]))),
        position=np.concatenate([p.log.position for p in all_of]),
        torque=np.concatenate([p.log.torque for p in all_of]),
        notes=tuple(note for p in all_of for note in p.log.notes),
    )
    index = np.concatenate([p.configuration + shift for p, shift in zip(all_of, before, strict=True)])
    return Poses(log=log, configuration=index, notes=tuple(n for p in all_of for n in p.notes), **joined)


def _holds(q: Array, bands: Array, least: int) -> list[tuple[int, int]]:
    """Sample ranges of at least `least` samples in which every channel stays within its band."""
    n = len(q)
    if n < least:
        return []
    ranges = np.array([running_maximum(x, least) + running_maximum(-x, least) for x in q.T])  # of samples around each
    still = np.all(ranges <= bands[:, None], axis=0)[least // 2 : least // 2 + n - least + 1]
    holds, begin = [], 0
    while begin < len(still):
        if not still[begin]:
            moving = np.flatnonzero(still[begin:])
            if not moving.size:
                break
            begin += int(moving[0])
        moving = np.flatnonzero(~still[begin:])
        stop = begin + (int(moving[0]) if moving.size else len(still) - begin) + least - 1
        part = q[begin:stop]
        spread = np.maximum.accumulate(part) - np.minimum.accumulate(part)
        creeps = np.flatnonzero((spread > bands).any(axis=1))
        stop = begin + int(creeps[0]) if creeps.size else stop
        holds.append((begin, stop))
        begin = stop
    return holds


def _standard_error(tau: Array) -> Array:
    """Standard error of the mean of a hold's torque by batch means, robust to serial correlation, (coordinates,)."""
    if len(tau) < 2 * NOISE_BATCHES:
        return np.full(tau.shape[1], np.nan)
    means = np.array([part.mean(axis=0) for part in np.array_split(tau, NOISE_BATCHES)])
    return np.asarray(means.std(axis=0, ddof=1) / np.sqrt(NOISE_BATCHES))


def _coordinate_bands(device: Device, motion: Motion, bands: Array) -> Array:
    """Largest range of each coordinate in a hold, (coordinates,)."""
    change = position_map(device, motion)
    return np.asarray(np.abs(change(np.eye(len(bands)))) @ bands)


def _approach(c: Array, holds: Sequence[tuple[int, int]], bands: Array) -> Array:
    """Direction in which each coordinate came to each hold; NaN where it has not moved since the one before."""
    directions = np.full((len(holds), c.shape[1]), np.nan)
    before = [(0, 0), *holds]
    for k, ((_, leaves), (low, high)) in enumerate(pairwise(before)):
        pose = c[low:high].mean(axis=0)
        for j in range(c.shape[1]):
            departed = np.flatnonzero(np.abs(c[leaves:low, j] - pose[j]) > bands[j])
            if departed.size:
                directions[k, j] = np.sign(pose[j] - c[leaves + departed[-1], j])
    return directions


def _configurations(c: Array, bands: Array) -> np.ndarray:
    """Index of each pose's configuration, in order of appearance."""
    near = np.maximum(_SAME_POSE * np.ptp(c, axis=0), STEPS_HELD * bands)
    distinct: list[Array] = []
    index = np.empty(len(c), dtype=int)
    for k, pose in enumerate(c):
        matches = [i for i, other in enumerate(distinct) if (np.abs(pose - other) <= near).all()]
        index[k] = matches[0] if matches else len(distinct)
        if not matches:
            distinct.append(pose)
    return index
