"""What can be wrong with a log file or its samples."""

from __future__ import annotations

import difflib
from collections.abc import Sequence

from haptid.errors._both import LogChannelError, LogDataError, LogFileError, LogMismatchError, LogTimeError


def _some(names: Sequence[str], limit: int = 24) -> str:
    """The first names of a list, columns of one matrix as `name[1..n]`, and how many more there are."""
    counts: dict[str, int] = {}
    for name in names:
        array, bracket, _ = name.rpartition("[")
        counts[array if bracket else name] = counts.get(array, 0) + 1 if bracket else 0
    groups = [f"{name}[1..{n}]" if n else name for name, n in counts.items()]
    shown = ", ".join(groups[:limit])
    return f"{shown} and {len(groups) - limit} more" if len(groups) > limit else shown or "none"


class LogNotFoundError(LogFileError):
    """No file at the path."""

    def __init__(self, path: object) -> None:
        super().__init__(
            f"{path}: no such file. Check the path; a study takes it from the folder of --data, or from its own."
        )


class LogFolderError(LogFileError):
    """A folder where a file was wanted."""

    def __init__(self, path: object) -> None:
        super().__init__(f"{path} is a folder, not a log file. Name one file in it.")


class LogAccessError(LogFileError):
    """A file that the system does not let haptid read."""

    def __init__(self, path: object, why: str) -> None:
        super().__init__(f"{path} cannot be read: {why}. Check its permissions, or copy the file.")


class EmptyLogError(LogFileError):
    """A file without a byte, or without a row."""

    def __init__(self, path: object, what: str) -> None:
        super().__init__(f"{path} has {what}, so there is no motion in it. Record or export the log again.")


class NotByRowsError(LogFileError):
    """A log that can only be read as a whole was to stay on disk."""

    def __init__(self, path: object, kind: str, known: Sequence[str]) -> None:
        super().__init__(
            f"{path} is {kind}, of which some rows cannot be read without the others. Read it with read_log, or write "
            f"it as {' or '.join(known)}."
        )


class ChangedLogError(LogFileError):
    """A log file that is not the size that it had when it was checked."""

    def __init__(self, path: object, size: int, checked: int) -> None:
        super().__init__(
            f"{path} has {size} bytes, and had {checked} when it was checked. Wait until nothing writes to it, and "
            f"start anew; on another machine, put the same file there."
        )


class LogFormatError(LogFileError):
    """A suffix that belongs to no format that haptid reads."""

    def __init__(self, path: object, suffix: str, known: Sequence[str]) -> None:
        found = f"its suffix {suffix!r} is none that haptid reads" if suffix else "it has no suffix"
        super().__init__(f"{path}: {found}. Formats: {'; '.join(known)}. Convert the log, or rename it.")


class WrongContentError(LogFileError):
    """A file whose content is not what its suffix says."""

    def __init__(self, path: object, wanted: str, found: str) -> None:
        super().__init__(f"{path} is named as {wanted}, but it holds {found}. Rename it, or export it again.")


class CorruptLogError(LogFileError):
    """A file that begins as it should and cannot be read to its end."""

    def __init__(self, path: object, wanted: str, why: str) -> None:
        super().__init__(
            f"{path} is damaged or cut short: its {wanted} content cannot be read "
            f"({why.strip().rstrip('.')}). Copy or export it again."
        )


class OversizedLogError(LogFileError):
    """A member that declares far more than is stored of it: a decompression bomb, or a damaged header."""

    def __init__(self, path: object, name: str, declared: int, stored: int, limit: int, ratio: float) -> None:
        super().__init__(
            f"{path}: {name} declares {declared / 2**20:.0f} MiB from {stored} stored bytes; above "
            f"{limit / 2**20:.0f} MiB at most {ratio:.0f} times the stored size is accepted. If the file "
            "is yours, save it without compression."
        )


class PickledLogError(LogFileError):
    """An array of Python objects, which cannot be read without running what the file says."""

    def __init__(self, path: object, name: str) -> None:
        super().__init__(
            f"{path}: {name} is an array of Python objects, and reading one runs code from the file: "
            f"refused. Save plain numbers, numpy.savez(path, {name}=numpy.asarray(..., dtype=float))."
        )


class ForeignDataError(LogFileError):
    """A dataset whose samples are in another file."""

    def __init__(self, path: object, name: str) -> None:
        super().__init__(
            f"{path}: {name} takes its samples from another file, which the SHA-256 of this one would not "
            "cover. Store the samples in the file itself."
        )


class NoHeaderError(LogFileError):
    """A text log whose first line does not name its columns."""

    def __init__(self, path: object, line: str) -> None:
        super().__init__(
            f"{path} has no header: its first line is `{line[:60]}`. Put the names of the columns in the "
            "first line, separated by commas, semicolons or tabs."
        )


class RaggedRowError(LogFileError):
    """A line with more or fewer cells than the header."""

    def __init__(self, path: object, line: int, got: int, wanted: int, last: bool) -> None:
        advice = (
            "It is the last line, so the recording was cut short: delete this line"
            if last
            else "Correct this line; the separator was taken from the header"
        )
        super().__init__(f"{path}, line {line}: {got} cells where the header has {wanted}. {advice}.")


class TextCellError(LogFileError):
    """A cell that is not a number."""

    def __init__(self, path: object, line: int, channel: str, text: str) -> None:
        super().__init__(
            f"{path}, line {line}: {channel} is `{text[:40]}`, not a number. Correct the cell, or cut the "
            "log before it; a decimal comma is understood where the separator is a semicolon or a tab."
        )


class RepeatedNameError(LogFileError):
    """Two columns of one name."""

    def __init__(self, path: object, name: str) -> None:
        super().__init__(f"{path}: two columns are named {name!r}; rename one of them.")


class MissingChannelError(LogChannelError):
    """A channel that the file does not have."""

    def __init__(self, path: object, name: str, names: Sequence[str]) -> None:
        parts = [n for n in names if name in (n.rpartition("[")[0], n.split("[")[0].rpartition(".")[2])]
        near = difflib.get_close_matches(name, names, n=3, cutoff=0.6)
        close = _some(parts, 3) if parts else ", ".join(near)
        meant = f"Closest: {close}. " if close else ""
        super().__init__(f"{path} has no channel {name!r}. {meant}Channels of this file: {_some(names)}.")


class NotNumericError(LogFileError):
    """A channel that holds something else than real numbers."""

    def __init__(self, path: object, name: str, kind: str) -> None:
        super().__init__(
            f"{path}: channel {name!r} holds {kind}, not real numbers. Save it as floats or integers "
            "(stamps of a calendar as integers, with time_unit)."
        )


class ChannelGuessError(LogChannelError):
    """A log read without channels, whose names do not say what they are."""

    def __init__(self, path: object, what: str, names: Sequence[str]) -> None:
        super().__init__(
            f"{path}: {what}. Without `channels`, haptid takes t or time, q1..qn (or pos1, position1) and "
            "tau1..taun (or torque1, u1). Say which they are with haptid.Channels. Channels of this file: "
            f"{_some(names)}."
        )


class UnequalChannelsError(LogDataError):
    """Channels of different lengths."""

    def __init__(self, path: object, first: str, n: int, other: str, m: int) -> None:
        super().__init__(
            f"{path}: {first} has {n} samples and {other} has {m}. All mapped channels must be sampled "
            "together: bring them to one time base first."
        )


class UnknownUnitError(LogChannelError):
    """A unit that is in no table."""

    def __init__(self, unit: str, quantity: str, known: Sequence[str], meant: str | None) -> None:
        hint = f"Write {meant!r}. " if meant else ""
        super().__init__(f"unit {unit!r} of the {quantity} is not known. {hint}Known: {', '.join(known)}.")


class WrongKindOfUnitError(LogChannelError):
    """A unit of something else."""

    def __init__(self, unit: str, quantity: str, kind: str, known: Sequence[str]) -> None:
        super().__init__(
            f"unit {unit!r} of the {quantity} is a unit of {kind}. Units of {quantity}: "
            f"{', '.join(known)}. Check that the two signals are not exchanged."
        )


class CountsGainError(LogChannelError):
    """Positions in counts whose size is not given."""

    def __init__(self) -> None:
        super().__init__(
            "positions in counts need `gain`, the rad or m of one count, for example 2*pi/(4*lines) for "
            "an encoder read on both edges of both tracks."
        )


class SignalError(LogChannelError):
    """A signal or a mapping that contradicts itself."""

    def __init__(self, name: str, found: str, wanted: str) -> None:
        super().__init__(f"{name} is {found}; wanted {wanted}.")


class SlowClockError(LogTimeError):
    """Samples so far apart that their times must be in another unit."""

    def __init__(self, path: object, name: str, step: float, limit: float) -> None:
        super().__init__(
            f"{path}: by its times in {name!r} there is a sample every {step:.3g} s, and no motion is told by samples "
            f"further apart than {limit:g} s. Give the `time_unit` that the channel has: 'ms', 'us' or 'ns'."
        )


class TimeBaseError(LogChannelError):
    """No time, or two of them."""

    def __init__(self, time: str | None, rate_hz: float | None) -> None:
        found = "neither `time` nor `rate_hz`" if time is None else f"time={time!r} and rate_hz={rate_hz:g}"
        super().__init__(
            f"the channels have {found}. Give one: the channel with the sample times, or the rate where "
            "there is none or where it is better than the stamps."
        )


class MappedTwiceError(LogChannelError):
    """One channel in two places of the mapping."""

    def __init__(self, name: str, first: str, second: str) -> None:
        super().__init__(f"channel {name!r} is mapped twice, as {first} and as {second}. Give each its own channel.")


class StretchError(LogTimeError):
    """A stretch that is not in the log."""

    def __init__(self, path: object, stretch: tuple[float, float], end: float) -> None:
        super().__init__(
            f"{path}: no samples in the stretch ({stretch[0]:g}, {stretch[1]:g}) s. The log runs from 0 to "
            f"{end:g} s, counted from its first sample; give (from, to) inside it."
        )


class NonFiniteError(LogDataError):
    """NaN, infinities or missing cells."""

    def __init__(self, path: object, name: str, count: int, index: int, time: float | None) -> None:
        self.channel, self.count, self.index = name, count, index
        when = "" if time is None else f" (t = {time:.6g} s)"
        samples = "1 sample" if count == 1 else f"{count} samples"
        super().__init__(
            f"{path}: channel {name!r} is missing, infinite or beyond 1e30 at {samples}, first at sample "
            f"{index}{when}. Use `stretch` to keep a part without them, or repair the log."
        )


class TimeBackwardsError(LogTimeError):
    """Stamps that decrease."""

    def __init__(self, path: object, index: int, before: float, after: float, count: int) -> None:
        self.index = index
        more = f", and at {count - 1} more places" if count > 1 else ""
        super().__init__(
            f"{path}: time runs backwards at sample {index}, from {before:.9g} to {after:.9g} s{more}. "
            "Either two recordings are in one file (split them, or keep one with `stretch`), or a counter "
            "of the clock overflowed, or rows are out of order."
        )


class RepeatedStampError(LogTimeError):
    """The same stamp on samples that are not the same, or too often."""

    def __init__(self, path: object, count: int, samples: int, index: int, time: float, differing: str | None) -> None:
        why = (
            f"channel {differing!r} has different values at one of them"
            if differing
            else f"that is {100 * count / samples:.2g} % of the samples, above the limit of 1 %"
        )
        super().__init__(
            f"{path}: {count} stamps equal the one before, first at sample {index} (t = {time:.9g} s), and "
            f"{why}. If the stamps are coarser than the sampling, leave `time` out and give `rate_hz`."
        )


class GapError(LogTimeError):
    """A hole in the log that is too long to be filled."""

    def __init__(self, path: object, time: float, length: float, step: float, count: int, longest: float) -> None:
        self.time, self.length = time, length
        more = f" It is the first of {count}." if count > 1 else ""
        super().__init__(
            f"{path}: no samples for {length:.4g} s from t = {time:.6g} s, {length / step:.0f} steps of "
            f"{step:.4g} s; at most {longest:.0f} steps are filled.{more} Keep a part without it with "
            "`stretch`, or split the log there."
        )


class MissingSamplesError(LogTimeError):
    """Short holes, each of which could be filled, but too many of them."""

    def __init__(self, path: object, missing: int, samples: int, gaps: int, limit: float) -> None:
        super().__init__(
            f"{path}: {missing} samples are missing in {gaps} short gaps, {100 * missing / samples:.2g} % "
            f"of the log; at most {100 * limit:g} % are filled. Keep a part without them with `stretch`, "
            "or leave `time` out and give `rate_hz` if the samples are regular and only their stamps are "
            "not."
        )


class LogTooShortError(LogTimeError):
    """Too few samples for anything."""

    def __init__(self, path: object, samples: int, limit: int) -> None:
        super().__init__(f"{path}: {samples} samples, below the limit of {limit}. Record longer, or widen `stretch`.")


class DeadChannelError(LogDataError):
    """A channel that never changes."""

    def __init__(self, path: object, name: str, value: float, quantity: str) -> None:
        super().__init__(
            f"{path}: {quantity} channel {name!r} is {value:.6g} in every sample, so it is not connected "
            "or nothing moved. Map the channel that is alive, or give its signal constant_ok=True if it "
            "is meant to be constant."
        )


class SaturatedTorqueError(LogDataError):
    """A torque that was cut off at its limit."""

    def __init__(self, path: object, name: str, value: float, unit: str, share: float, limit: float) -> None:
        super().__init__(
            f"{path}: torque channel {name!r} stays exactly at its extreme {value:.6g} {unit} for "
            f"{100 * share:.2g} % of the samples, above the limit of {100 * limit:g} %: it is saturated "
            "there, and the real torque is unknown. Record a slower motion, cut the part away with "
            "`stretch`, or give allow_saturation=True if the command is what really acted."
        )


class PositionJumpError(LogDataError):
    """A position that leaps."""

    def __init__(self, path: object, name: str, time: float, jump: float, unit: str, ordinary: float) -> None:
        super().__init__(
            f"{path}: position channel {name!r} jumps by {jump:.6g} {unit} in one sample at t = {time:.6g} "
            f"s, where 99.9 % of its steps are below {ordinary:.3g} {unit}: lost counts, or two recordings "
            "in one. Keep a part without it with `stretch`."
        )


class WrappedPositionError(LogDataError):
    """An angle or a counter that jumps by its period."""

    def __init__(self, path: object, name: str, time: float, period: float, unit: str, count: int) -> None:
        super().__init__(
            f"{path}: position channel {name!r} jumps by its whole period of {period:.6g} {unit} at t = "
            f"{time:.6g} s ({count} times in the log): it is wrapped. Unwrap it before saving, or give its "
            "signal unwrap=True."
        )


class IdenticalChannelsError(LogDataError):
    """Two channels that are one."""

    def __init__(self, path: object, first: str, second: str) -> None:
        super().__init__(
            f"{path}: channels {first!r} and {second!r} are equal in every sample, so one was recorded in "
            "place of the other. Map two different channels."
        )


class LooksLikeDegreesError(LogMismatchError):
    """Positions read as radians that make sense as degrees."""

    def __init__(self, name: str, channel: str, low: float, high: float, limits: tuple[float, float] | None) -> None:
        why = (
            f"far beyond its limits {limits[0]:.4g} .. {limits[1]:.4g} rad"
            if limits
            else f"{(high - low) / 6.283185307179586:.1f} turns"
        )
        super().__init__(
            f"joint {name} (channel {channel!r}) runs from {low:.4g} to {high:.4g} rad, {why}; divided by "
            "57.3 it would be plausible. Give the position signal unit='deg', or correct the joint's "
            "limits."
        )


class LooksLikeRadiansError(LogMismatchError):
    """Positions read as degrees that make sense as radians."""

    def __init__(self, name: str, span: float, limit: float) -> None:
        super().__init__(
            f"with unit 'deg' no joint moves more than {span:.3g} deg (joint {name}), below {limit:g} deg; "
            "as radians the motion would be ordinary. Give the position signal unit='rad'; if the motion "
            "really is this small, keep unit='rad' with gain=pi/180."
        )


class SwappedChannelsError(LogMismatchError):
    """Two position channels, each of which fits the other's joint."""

    def __init__(self, first: str, second: str, a: str, b: str, value: float, limits: tuple[float, float]) -> None:
        super().__init__(
            f"joint {first} (channel {a!r}) reaches {value:.4g}, outside its limits {limits[0]:.4g} .. "
            f"{limits[1]:.4g}, while channel {b!r} of joint {second} fits them and the other way round. "
            "Exchange the two channels, or correct the limits."
        )
