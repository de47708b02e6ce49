"""Every error haptid raises: one class per cause, each saying what, how much, the limit, and what to do."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable, Sequence


class HaptidError(Exception):
    """Root of haptid's errors."""


class DeviceError(HaptidError):
    """Something about a device file or a mechanism."""


class LogError(HaptidError):
    """Something about a log file or its samples."""


class StudyError(HaptidError):
    """Something about a study file or the corridor it asks for."""


class TreatmentError(HaptidError):
    """Something about filtering, differentiation or decimation."""


class EstimationError(HaptidError):
    """Something about observation, estimation or validation."""


# --- device -----------------------------------------------------------------------------------------------------


def suggestion(name: str, known: Iterable[str]) -> str:
    """What was probably meant, and what is known: the tail of an error about a name."""
    names = list(dict.fromkeys(known))
    close = difflib.get_close_matches(name, names, n=1, cutoff=0.6)
    meant = f'Did you mean "{close[0]}"? ' if close else ""
    shown = ", ".join(names[:24]) + (f" and {len(names) - 24} more" if len(names) > 24 else "")
    return f"{meant}Known: {shown or 'none'}."


class DeviceFileError(DeviceError):
    """A device file that cannot be taken in at all: absent, too large, not text."""

    def __init__(self, path: str, found: str, instead: str) -> None:
        super().__init__(f"{path}: {found}. {instead}")


class DeviceSyntaxError(DeviceError):
    """A device file that is not TOML."""

    def __init__(self, path: str, line: int, column: int, found: str, text: str) -> None:
        self.line, self.column = line, column
        super().__init__(
            f"{path}, line {line}, column {column}: not TOML: {found}, in `{text}`. "
            f"Correct this line; texts and expressions need double quotes."
        )


class DeviceKeyError(DeviceError):
    """A key that does not belong where it stands, or one that is missing."""

    def __init__(self, where: str, found: str, instead: str) -> None:
        super().__init__(f"{where}: {found}. {instead}")


class DeviceValueError(DeviceError):
    """A value that cannot be what its key says."""

    def __init__(self, where: str, found: str, instead: str) -> None:
        super().__init__(f"{where}: {found}. {instead}")


class UnknownNameError(DeviceError):
    """A name that nothing in the device carries."""

    def __init__(self, where: str, what: str, name: str, known: Iterable[str]) -> None:
        self.name = name
        super().__init__(f'{where}: no {what} is named "{name}". {suggestion(name, known)}')


class DuplicateNameError(DeviceError):
    """The same name twice."""

    def __init__(self, where: str, what: str, name: str, first: str) -> None:
        super().__init__(
            f'{where}: the {what} "{name}" is already taken by {first}. Give one of them another name.'
        )


class MissingParentError(DeviceError):
    """A joint whose parent is not there, or only further down the file."""

    def __init__(self, where: str, joint: str, parent: str, known: Iterable[str], later: bool) -> None:
        if later:
            reason = f'its parent "{parent}" is declared further down; move it above joint "{joint}".'
        else:
            reason = f'no joint declared above it is named "{parent}". {suggestion(parent, known)}'
        super().__init__(f'{where}: joint "{joint}" has no parent yet: {reason}')


class CycleError(DeviceError):
    """Joints that are each other's ancestors."""

    def __init__(self, where: str, names: Iterable[str]) -> None:
        ring = " -> ".join(names)
        super().__init__(
            f"{where}: these joints hang on one another: {ring}. Hang one of them on the base or on a joint "
            f"outside the ring, and close the ring with [[loops]] and a cut joint."
        )


class ExpressionError(DeviceError):
    """A text that is not the arithmetic it should be."""

    def __init__(self, where: str, text: str, found: str, instead: str) -> None:
        super().__init__(f'{where}: cannot read "{text}": {found}. {instead}')


class DegreesError(DeviceError):
    """An angle that can only have been meant in degrees."""

    def __init__(self, where: str, value: float) -> None:
        super().__init__(
            f"{where}: the angle {value:g} is more than a turn (limit 2 pi rad), so it looks like degrees. "
            f'Write it in radians: {math.radians(value):.6g}, or as "{value:g}*pi/180".'
        )


class RelationError(DeviceError):
    """A relation between joint positions that is not linear, or does not settle its joints."""

    def __init__(self, where: str, found: str, instead: str) -> None:
        super().__init__(f"{where}: {found}. {instead}")


class ActiveJointError(DeviceError):
    """A joint that is declared active but moved by a loop, or declared passive but moved by nothing."""

    def __init__(self, where: str, joint: str, found: str, instead: str) -> None:
        super().__init__(f'{where}: joint "{joint}" {found}. {instead}')


class LoopOpenError(DeviceError):
    """Loops whose cut frames do not meet."""

    def __init__(self, where: str, gap: float, limit: float, how: str) -> None:
        self.gap = gap
        super().__init__(
            f"{where}: the loop does not close: {how} its cut frames still miss each other by {gap:.3g} m "
            f"(limit {limit:.1e} m). Check the lengths and frames of the cut, and that the active joints can "
            f"move independently of each other."
        )


class NonlinearLoopError(DeviceError):
    """Loops that close, but not by a linear relation."""

    def __init__(self, where: str, variation: float, limit: float) -> None:
        self.variation = variation
        super().__init__(
            f"{where}: the loop closes, but the passive joints do not follow the active ones linearly: "
            f"G = dq/dqa varies by {variation:.3g} over the motion (limit {limit:.1e}). Only linear loops "
            f"(parallelograms, mimic joints, couplings) are handled in this version; if this one is meant "
            f"to be a parallelogram, make its opposite sides equal."
        )


class UndeterminedLoopError(DeviceError):
    """Loops that leave a passive joint free."""

    def __init__(self, where: str, free: int, passive: int) -> None:
        super().__init__(
            f"{where}: the cuts settle only {passive - free} of {passive} passive joints; {free} can still "
            f"move while the active ones stand still. Make {free} more of them active, or add a cut."
        )


class IdleMotorError(DeviceError):
    """A motor that drives no active joint."""

    def __init__(self, where: str, motor: str, found: str, active: Iterable[str]) -> None:
        super().__init__(
            f'{where}: motor "{motor}" {found}. Name active joints with non-zero factors; '
            f"the active joints are {', '.join(active)}."
        )


class TransmissionError(DeviceError):
    """Motors whose coordinates do not determine the active joints."""

    def __init__(self, where: str, motors: int, active: int, rank: int) -> None:
        super().__init__(
            f"{where}: {motors} motor coordinates cannot be turned into the {active} active joint positions: "
            f"the transmission matrix has rank {rank}, wanted {active} rows of rank {active}. "
            f"Give each motor its own combination of active joints."
        )


class ColumnValueError(DeviceError):
    """A column that is not a number somewhere in the motion."""

    def __init__(self, name: str, sample: int, value: float, cause: str) -> None:
        super().__init__(
            f"column {name} is {value} at sample {sample}: {cause}. Correct the expression, or keep the "
            f"motion where it is defined."
        )


# --- log --------------------------------------------------------------------------------------------------------


def _some(names: Sequence[str], limit: int = 24) -> str:
    """The first names of a list, columns of one matrix as `name[1..n]`, and how many more there are."""
    counts: dict[str, int] = {}
    for name in names:
        array, bracket, _ = name.rpartition("[")
        counts[array if bracket else name] = counts.get(array, 0) + 1 if bracket else 0
    groups = [f"{name}[1..{n}]" if n else name for name, n in counts.items()]
    shown = ", ".join(groups[:limit])
    return f"{shown} and {len(groups) - limit} more" if len(groups) > limit else shown or "none"


class LogNotFoundError(LogError):
    """No file at the path."""

    def __init__(self, path: object) -> None:
        super().__init__(f"{path}: no such file. Check the path; it is taken relative to the current folder.")


class LogFolderError(LogError):
    """A folder where a file was wanted."""

    def __init__(self, path: object) -> None:
        super().__init__(f"{path} is a folder, not a log file. Name one file in it.")


class LogAccessError(LogError):
    """A file that the system does not let haptid read."""

    def __init__(self, path: object, why: str) -> None:
        super().__init__(f"{path} cannot be read: {why}. Check its permissions, or copy the file.")


class EmptyLogError(LogError):
    """A file without a byte, or without a row."""

    def __init__(self, path: object, what: str) -> None:
        super().__init__(f"{path} has {what}, so there is no motion in it. Record or export the log again.")


class LogFormatError(LogError):
    """A suffix that belongs to no format that haptid reads."""

    def __init__(self, path: object, suffix: str, known: Sequence[str]) -> None:
        found = f"its suffix {suffix!r} is none that haptid reads" if suffix else "it has no suffix"
        super().__init__(f"{path}: {found}. Formats: {'; '.join(known)}. Convert the log, or rename it.")


class WrongContentError(LogError):
    """A file whose content is not what its suffix says."""

    def __init__(self, path: object, wanted: str, found: str) -> None:
        super().__init__(f"{path} is named as {wanted}, but it holds {found}. Rename it, or export it again.")


class CorruptLogError(LogError):
    """A file that begins as it should and cannot be read to its end."""

    def __init__(self, path: object, wanted: str, why: str) -> None:
        super().__init__(
            f"{path} is damaged or cut short: its {wanted} content cannot be read "
            f"({why.strip().rstrip('.')}). Copy or export it again."
        )


class OversizedLogError(LogError):
    """A member that declares far more than is stored of it: a decompression bomb, or a damaged header."""

    def __init__(self, path: object, name: str, declared: int, stored: int, limit: int, ratio: float) -> None:
        super().__init__(
            f"{path}: {name} declares {declared / 2**20:.0f} MiB from {stored} stored bytes; above "
            f"{limit / 2**20:.0f} MiB at most {ratio:.0f} times the stored size is accepted. If the file "
            "is yours, save it without compression."
        )


class PickledLogError(LogError):
    """An array of Python objects, which cannot be read without running what the file says."""

    def __init__(self, path: object, name: str) -> None:
        super().__init__(
            f"{path}: {name} is an array of Python objects, and reading one runs code from the file: "
            f"refused. Save plain numbers, numpy.savez(path, {name}=numpy.asarray(..., dtype=float))."
        )


class ForeignDataError(LogError):
    """A dataset whose samples are in another file."""

    def __init__(self, path: object, name: str) -> None:
        super().__init__(
            f"{path}: {name} takes its samples from another file, which the SHA-256 of this one would not "
            "cover. Store the samples in the file itself."
        )


class NoHeaderError(LogError):
    """A text log whose first line does not name its columns."""

    def __init__(self, path: object, line: str) -> None:
        super().__init__(
            f"{path} has no header: its first line is `{line[:60]}`. Put the names of the columns in the "
            "first line, separated by commas, semicolons or tabs."
        )


class RaggedRowError(LogError):
    """A line with more or fewer cells than the header."""

    def __init__(self, path: object, line: int, got: int, wanted: int, last: bool) -> None:
        advice = (
            "It is the last line, so the recording was cut short: delete this line"
            if last
            else "Correct this line; the separator was taken from the header"
        )
        super().__init__(f"{path}, line {line}: {got} cells where the header has {wanted}. {advice}.")


class TextCellError(LogError):
    """A cell that is not a number."""

    def __init__(self, path: object, line: int, channel: str, text: str) -> None:
        super().__init__(
            f"{path}, line {line}: {channel} is `{text[:40]}`, not a number. Correct the cell, or cut the "
            "log before it; a decimal comma is understood where the separator is a semicolon or a tab."
        )


class RepeatedNameError(LogError):
    """Two columns of one name."""

    def __init__(self, path: object, name: str) -> None:
        super().__init__(f"{path}: two columns are named {name!r}; rename one of them.")


class MissingChannelError(LogError):
    """A channel that the file does not have."""

    def __init__(self, path: object, name: str, names: Sequence[str]) -> None:
        parts = [n for n in names if name in (n.rpartition("[")[0], n.split("[")[0].rpartition(".")[2])]
        near = difflib.get_close_matches(name, names, n=3, cutoff=0.6)
        close = _some(parts, 3) if parts else ", ".join(near)
        meant = f"Closest: {close}. " if close else ""
        super().__init__(f"{path} has no channel {name!r}. {meant}Channels of this file: {_some(names)}.")


class NotNumericError(LogError):
    """A channel that holds something else than real numbers."""

    def __init__(self, path: object, name: str, kind: str) -> None:
        super().__init__(
            f"{path}: channel {name!r} holds {kind}, not real numbers. Save it as floats or integers "
            "(stamps of a calendar as integers, with time_unit)."
        )


class ChannelGuessError(LogError):
    """A log read without channels, whose names do not say what they are."""

    def __init__(self, path: object, what: str, names: Sequence[str]) -> None:
        super().__init__(
            f"{path}: {what}. Without `channels`, haptid takes t or time, q1..qn (or pos1, position1) and "
            "tau1..taun (or torque1, u1). Say which they are with haptid.Channels. Channels of this file: "
            f"{_some(names)}."
        )


class UnequalChannelsError(LogError):
    """Channels of different lengths."""

    def __init__(self, path: object, first: str, n: int, other: str, m: int) -> None:
        super().__init__(
            f"{path}: {first} has {n} samples and {other} has {m}. All mapped channels must be sampled "
            "together: bring them to one time base first."
        )


class UnknownUnitError(LogError):
    """A unit that is in no table."""

    def __init__(self, unit: str, quantity: str, known: Sequence[str], meant: str | None) -> None:
        hint = f"Write {meant!r}. " if meant else ""
        super().__init__(f"unit {unit!r} of the {quantity} is not known. {hint}Known: {', '.join(known)}.")


class WrongKindOfUnitError(LogError):
    """A unit of something else."""

    def __init__(self, unit: str, quantity: str, kind: str, known: Sequence[str]) -> None:
        super().__init__(
            f"unit {unit!r} of the {quantity} is a unit of {kind}. Units of {quantity}: "
            f"{', '.join(known)}. Check that the two signals are not exchanged."
        )


class CountsGainError(LogError):
    """Positions in counts whose size is not given."""

    def __init__(self) -> None:
        super().__init__(
            "positions in counts need `gain`, the rad or m of one count, for example 2*pi/(4*lines) for "
            "an encoder read on both edges of both tracks."
        )


class SignalError(LogError):
    """A signal or a mapping that contradicts itself."""

    def __init__(self, name: str, found: str, wanted: str) -> None:
        super().__init__(f"{name} is {found}; wanted {wanted}.")


class TimeBaseError(LogError):
    """No time, or two of them."""

    def __init__(self, time: str | None, rate_hz: float | None) -> None:
        found = "neither `time` nor `rate_hz`" if time is None else f"time={time!r} and rate_hz={rate_hz:g}"
        super().__init__(
            f"the channels have {found}. Give one: the channel with the sample times, or the rate where "
            "there is none or where it is better than the stamps."
        )


class MappedTwiceError(LogError):
    """One channel in two places of the mapping."""

    def __init__(self, name: str, first: str, second: str) -> None:
        super().__init__(
            f"channel {name!r} is mapped twice, as {first} and as {second}. Give each its own channel."
        )


class StretchError(LogError):
    """A stretch that is not in the log."""

    def __init__(self, path: object, stretch: tuple[float, float], end: float) -> None:
        super().__init__(
            f"{path}: no samples in the stretch ({stretch[0]:g}, {stretch[1]:g}) s. The log runs from 0 to "
            f"{end:g} s, counted from its first sample; give (from, to) inside it."
        )


class NonFiniteError(LogError):
    """NaN, infinities or missing cells."""

    def __init__(self, path: object, name: str, count: int, index: int, time: float | None) -> None:
        self.channel, self.count, self.index = name, count, index
        when = "" if time is None else f" (t = {time:.6g} s)"
        samples = "1 sample" if count == 1 else f"{count} samples"
        super().__init__(
            f"{path}: channel {name!r} is missing, infinite or beyond 1e30 at {samples}, first at sample "
            f"{index}{when}. Use `stretch` to keep a part without them, or repair the log."
        )


class TimeBackwardsError(LogError):
    """Stamps that decrease."""

    def __init__(self, path: object, index: int, before: float, after: float, count: int) -> None:
        self.index = index
        more = f", and at {count - 1} more places" if count > 1 else ""
        super().__init__(
            f"{path}: time runs backwards at sample {index}, from {before:.9g} to {after:.9g} s{more}. "
            "Either two recordings are in one file (split them, or keep one with `stretch`), or a counter "
            "of the clock overflowed, or rows are out of order."
        )


class RepeatedStampError(LogError):
    """The same stamp on samples that are not the same, or too often."""

    def __init__(
        self, path: object, count: int, samples: int, index: int, time: float, differing: str | None
    ) -> None:
        why = (
            f"channel {differing!r} has different values at one of them"
            if differing
            else f"that is {100 * count / samples:.2g} % of the samples, above the limit of 1 %"
        )
        super().__init__(
            f"{path}: {count} stamps equal the one before, first at sample {index} (t = {time:.9g} s), and "
            f"{why}. If the stamps are coarser than the sampling, leave `time` out and give `rate_hz`."
        )


class GapError(LogError):
    """A hole in the log that is too long to be filled."""

    def __init__(
        self, path: object, time: float, length: float, step: float, count: int, longest: float
    ) -> None:
        self.time, self.length = time, length
        more = f" It is the first of {count}." if count > 1 else ""
        super().__init__(
            f"{path}: no samples for {length:.4g} s from t = {time:.6g} s, {length / step:.0f} steps of "
            f"{step:.4g} s; at most {longest:.0f} steps are filled.{more} Keep a part without it with "
            "`stretch`, or split the log there."
        )


class MissingSamplesError(LogError):
    """Short holes, each of which could be filled, but too many of them."""

    def __init__(self, path: object, missing: int, samples: int, gaps: int, limit: float) -> None:
        super().__init__(
            f"{path}: {missing} samples are missing in {gaps} short gaps, {100 * missing / samples:.2g} % "
            f"of the log; at most {100 * limit:g} % are filled. Keep a part without them with `stretch`, "
            "or leave `time` out and give `rate_hz` if the samples are regular and only their stamps are "
            "not."
        )


class LogTooShortError(LogError):
    """Too few samples for anything."""

    def __init__(self, path: object, samples: int, limit: int) -> None:
        super().__init__(
            f"{path}: {samples} samples, below the limit of {limit}. Record longer, or widen `stretch`."
        )


class DeadChannelError(LogError):
    """A channel that never changes."""

    def __init__(self, path: object, name: str, value: float, quantity: str) -> None:
        super().__init__(
            f"{path}: {quantity} channel {name!r} is {value:.6g} in every sample, so it is not connected "
            "or nothing moved. Map the channel that is alive, or give its signal constant_ok=True if it "
            "is meant to be constant."
        )


class SaturatedTorqueError(LogError):
    """A torque that was cut off at its limit."""

    def __init__(self, path: object, name: str, value: float, unit: str, share: float, limit: float) -> None:
        super().__init__(
            f"{path}: torque channel {name!r} stays exactly at its extreme {value:.6g} {unit} for "
            f"{100 * share:.2g} % of the samples, above the limit of {100 * limit:g} %: it is saturated "
            "there, and the real torque is unknown. Record a slower motion, cut the part away with "
            "`stretch`, or give allow_saturation=True if the command is what really acted."
        )


class PositionJumpError(LogError):
    """A position that leaps."""

    def __init__(self, path: object, name: str, time: float, jump: float, unit: str, ordinary: float) -> None:
        super().__init__(
            f"{path}: position channel {name!r} jumps by {jump:.6g} {unit} in one sample at t = {time:.6g} "
            f"s, where 99.9 % of its steps are below {ordinary:.3g} {unit}: lost counts, or two recordings "
            "in one. Keep a part without it with `stretch`."
        )


class WrappedPositionError(LogError):
    """An angle or a counter that jumps by its period."""

    def __init__(self, path: object, name: str, time: float, period: float, unit: str, count: int) -> None:
        super().__init__(
            f"{path}: position channel {name!r} jumps by its whole period of {period:.6g} {unit} at t = "
            f"{time:.6g} s ({count} times in the log): it is wrapped. Unwrap it before saving, or give its "
            "signal unwrap=True."
        )


class IdenticalChannelsError(LogError):
    """Two channels that are one."""

    def __init__(self, path: object, first: str, second: str) -> None:
        super().__init__(
            f"{path}: channels {first!r} and {second!r} are equal in every sample, so one was recorded in "
            "place of the other. Map two different channels."
        )


class LooksLikeDegreesError(LogError):
    """Positions read as radians that make sense as degrees."""

    def __init__(
        self, name: str, channel: str, low: float, high: float, limits: tuple[float, float] | None
    ) -> None:
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


class LooksLikeRadiansError(LogError):
    """Positions read as degrees that make sense as radians."""

    def __init__(self, name: str, span: float, limit: float) -> None:
        super().__init__(
            f"with unit 'deg' no joint moves more than {span:.3g} deg (joint {name}), below {limit:g} deg; "
            "as radians the motion would be ordinary. Give the position signal unit='rad'; if the motion "
            "really is this small, keep unit='rad' with gain=pi/180."
        )


class SwappedChannelsError(LogError):
    """Two position channels, each of which fits the other's joint."""

    def __init__(
        self, first: str, second: str, a: str, b: str, value: float, limits: tuple[float, float]
    ) -> None:
        super().__init__(
            f"joint {first} (channel {a!r}) reaches {value:.4g}, outside its limits {limits[0]:.4g} .. "
            f"{limits[1]:.4g}, while channel {b!r} of joint {second} fits them and the other way round. "
            "Exchange the two channels, or correct the limits."
        )


# --- study, treatment, estimation -------------------------------------------------------------------------------


class StudyFileError(StudyError):
    """A study file that cannot be read, or a key in it that is wrong."""

    def __init__(self, path: object, where: str, what: str, known: list[str] | None = None) -> None:
        place = f"{path}, key `{where}`" if where else f"{path}"
        keys = f" Keys here: {', '.join(known)}." if known else ""
        super().__init__(f"{place}: {what}.{keys}")


class StudyLogsError(StudyError):
    """Logs that cannot serve the study."""

    def __init__(self, path: object, what: str) -> None:
        super().__init__(f"{path}, key `logs`: {what}.")


class OutputError(StudyError):
    """A folder that results cannot be written to."""

    def __init__(self, path: object, why: str) -> None:
        super().__init__(f"cannot write results to {path}: {why}. Choose another folder with --out.")


class TreatmentValueError(TreatmentError):
    """A setting of the treatment that means nothing."""

    def __init__(self, name: str, value: object, wanted: str) -> None:
        super().__init__(f"treatment {name} is {value!r}; write {wanted}.")


class CutoffError(TreatmentError):
    """A cut-off that the sampling rate, or the decimation, cannot carry."""

    def __init__(self, name: str, cutoff_hz: float, limit_hz: float) -> None:
        super().__init__(
            f"{name} is {cutoff_hz:g} Hz, and the rate that is left carries only what is well below {limit_hz:g} Hz. "
            f"Lower {name}, or decimate less."
        )


class MotionTooShortError(TreatmentError):
    """A motion shorter than the ends its filters need."""

    def __init__(self, seconds: float, needed: float, what: str) -> None:
        super().__init__(
            f"the motion lasts {seconds:.3g} s, and {what} alone take {needed:.3g} s. Record a longer motion, raise "
            f"the cut-off, or decimate less."
        )


class ChannelCountError(EstimationError):
    """A log with more or fewer channels than the device has."""

    def __init__(self, what: str, got: int, names: list[str]) -> None:
        super().__init__(
            f"the log has {got} {what} channels, and the device wants {len(names)}: {', '.join(names)}. "
            f"Map one channel for each, in this order."
        )


class CommandUnitError(EstimationError):
    """A torque channel in a unit that the device's motors are not driven in."""

    def __init__(self, motor: str, got: str, wanted: str, side: str) -> None:
        super().__init__(
            f"the torque channel of motor {motor} is in {got!r} at the {side} side, and the device file says {wanted!r}. "
            f"Give the channel that unit, or change the motor's `unit` and `gain` in the device file."
        )


class NoRowsError(EstimationError):
    """A motor whose rows were all dropped."""

    def __init__(self, motor: str, low_speed: object) -> None:
        super().__init__(
            f"every row of motor {motor} is slower than low_speed = {low_speed}, so none is left. Lower `low_speed`, "
            f"or record motion that turns this joint faster."
        )


class TooFewRowsError(EstimationError):
    """Fewer rows than parameters."""

    def __init__(self, rows: int, parameters: int) -> None:
        super().__init__(
            f"{rows} rows cannot tell {parameters} parameters. Record a longer motion, or decimate less."
        )


class UnexcitedError(EstimationError):
    """A parameter that the log says nothing about."""

    def __init__(self, name: str, ratio: float, limit: float) -> None:
        super().__init__(
            f"base parameter {name} is not excited by this log: its direction carries {ratio:.1e} of the largest one, "
            f"below the limit {limit:.1e}. Record motion that turns its link, or leave the term out of the device file."
        )


class MethodSettingError(EstimationError):
    """A setting of an estimator that means nothing."""

    def __init__(self, method: str, name: str, value: object, wanted: str) -> None:
        super().__init__(f"{method}: {name} is {value!r}; write {wanted}.")


class DifferentModelError(EstimationError):
    """Two values of different devices put together."""

    def __init__(self, one: str, other: str) -> None:
        super().__init__(
            f"these are of two devices, {one!r} and {other!r}, or of one device read twice. Read the device once, and "
            f"make every observation with it."
        )


class SameRowsError(EstimationError):
    """The same stretch of a log counted twice."""

    def __init__(self, log: str, start: float, stop: float) -> None:
        super().__init__(
            f"both observations hold the rows from {start:.3f} to {stop:.3f} s of log {log[:12]}: counting them twice "
            f"would halve every variance. Leave one out."
        )


class SeenRowsError(EstimationError):
    """Rows of the fit offered as unseen ones."""

    def __init__(self, log: str, start: float, stop: float) -> None:
        super().__init__(
            f"the rows from {start:.3f} to {stop:.3f} s of log {log[:12]} were in the fit, so they prove nothing. "
            f"Validate on another log, or hold blocks out of this one before the fit."
        )


class ShapeError(HaptidError):
    """An array whose shape is not what the call needs."""

    def __init__(self, name: str, got: tuple[int, ...], wanted: tuple[int | None, ...]) -> None:
        shown = tuple("any" if n is None else n for n in wanted)
        super().__init__(f"{name} has shape {got}, wanted {shown}; pass it with that shape.")
