"""Pooled estimates: one device from all log files of a data set together, in memory that does not grow with it."""

from __future__ import annotations

import os
import pickle
import platform
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from dataclasses import field, replace
from functools import cached_property
from itertools import pairwise
from pathlib import Path

import numpy as np

from haptid._internal.arrays import freeze
from haptid._internal.blas_threads import on_one_blas_thread
from haptid._internal.late import dataclass
from haptid.device import read_device
from haptid.dynamics.model import DynamicModel
from haptid.errors import EstimationError, HaptidError, LogFileError
from haptid.estimation import OLS, WLS, Estimate, estimate
from haptid.estimation.method import Fitting
from haptid.estimation.nonlinear.load_friction import has_nonlinear_constants
from haptid.executors import Executor, SerialExecutor
from haptid.log.data_set import DataFile, data_files
from haptid.motion.motion import treat
from haptid.motion.treatment import Treatment
from haptid.observation.observation import MotorRows, Observation, concatenated, observe
from haptid.observation.plan import MOST_BLOCKS, Block
from haptid.observation.r_factor import r_factor
from haptid.study import Study
from haptid.study.fleet_results import fleet_fingerprint
from haptid.study.identify import check_kind, logs_to_propose_from, read_entry, with_all_uncertainty
from haptid.study.pool_parts import FileWork, PoolParts, ReducedFile
from haptid.study.schema import fault
from haptid.study.study import silent
from haptid.treatment_choice.noise_effect import without_bias
from haptid.treatment_choice.propose import Proposal, propose
from haptid.uncertainty.quantities import aligned
from haptid.validation.validation import Validation, pooled, validate

# Files of which the problem is printed, those with a defect first.
_SHOWN = 5
_DEFECT = "defect of haptid"
_Progress = Callable[[str, float], None]


@dataclass(frozen=True, eq=False)
class Pool:
    """All files of a data set identified together.

    Attributes:
        name: of the study.
        treatment: of all files, as the study's own logs propose it.
        estimate: from the rows of all files.
        unseen: errors of alternate blocks, each predicted from the others; None where the blocks are too few.
        files: the work on each.
        seconds: from the first file to the last, s of the clock.
        notes: what of the study does not count for the files, and why errors are left out.
    """

    name: str
    treatment: Treatment
    estimate: Estimate
    unseen: Validation | None
    files: tuple[FileWork, ...] = field(repr=False)
    seconds: float
    notes: tuple[str, ...] = ()

    @property
    def failed(self) -> tuple[FileWork, ...]:
        """The files that gave no rows."""
        return tuple(one for one in self.files if one.problem)

    @property
    def sentences(self) -> tuple[str, ...]:
        """What was read and what failed, the errors, and what it took."""
        return tuple(self._sentences())

    def _sentences(self) -> Iterator[str]:
        good = [one for one in self.files if not one.problem]
        samples, gigabytes = sum(one.samples for one in good), sum(one.fetched for one in good) / 1e9
        yield f"{len(good)} of {len(self.files)} files, {samples:.4g} samples and {gigabytes:.3g} GB, are identified."
        for one in sorted(self.failed, key=lambda one: not one.problem.startswith(_DEFECT))[:_SHOWN]:
            yield f"{one.name}: {one.problem}"
        if len(self.failed) > _SHOWN:
            yield f"{len(self.failed) - _SHOWN} more files failed: files.csv has their problems."
        if self.unseen is not None:
            yield f"Error on unseen blocks: {self.unseen.relative:.3g} %."
        yield from self.notes
        processor, slowest = sum(one.processor for one in self.files), max(self.files, key=lambda one: one.seconds)
        yield (
            f"It took {self.seconds:.3g} s on {len({one.worker for one in self.files})} workers, {processor:.3g} s of "
            f"their processors, {1e6 * processor / max(samples, 1):.2g} us a sample; the slowest file, {slowest.name}, "
            f"{slowest.seconds:.3g} s."
        )

    def file_table(self) -> list[list[object]]:
        """Every file and its work, with a row of headings."""
        return work_table(self.files)

    def summary(self) -> str:
        """A table of the parameters, then the sentences."""
        rows = [["parameter", "value", "se", "unit"]]
        rows += [
            [one.name, f"{one.value:.5g}", f"{one.se:.2g}" if np.isfinite(one.se) else "unknown", one.unit]
            for one in self.estimate.parameters
        ]
        return "\n".join([*aligned(rows), "", *self.sentences])


def work_table(files: Sequence[FileWork]) -> list[list[object]]:
    """Files and the work on each, with a row of headings."""
    names = [*FileWork.__dataclass_fields__]
    return [list(names), *([getattr(one, name) for name in names] for one in files)]


@dataclass(frozen=True)
class _Reducer:
    """Reduction of one file, sent to the workers once.

    Attributes:
        study, proposal: as all files have them.
        blocks: most blocks that a file is returned in.
    """

    study: Study
    proposal: Proposal
    blocks: int

    @cached_property
    def _model(self) -> DynamicModel:
        return DynamicModel(read_device(self.study.device))

    def __call__(self, file: DataFile) -> ReducedFile:
        stamps, worker = [time.perf_counter()], f"{platform.node()}:{os.getpid()}"
        begun, before = time.time(), time.process_time()
        entry = replace(self.study.logs[0], time_range=None, episodes=None, exclude=())
        model = self._model
        try:
            with file.here() as path:
                stamps.append(time.perf_counter())
                log = read_entry(replace(entry, path=str(path)), Path(), silent)
                stamps.append(time.perf_counter())
                found = in_fewer_blocks(observe(model, treat(log, self.proposal.carried_by(log))), self.blocks)
        except Exception as error:  # a defect that one file shows does not cost the others
            return ReducedFile(FileWork(file.name, worker, begun, problem=_problem(error)))
        stamps.append(time.perf_counter())
        fetching, reading, reducing = (b - a for a, b in pairwise(stamps))
        work = FileWork(
            file.name,
            worker,
            begun,
            fetching,
            reading,
            reducing,
            time.process_time() - before,
            file.size,
            len(pickle.dumps((found.motors, found.blocks), pickle.HIGHEST_PROTOCOL)),
            len(log.t),
            found.rows,
        )
        return ReducedFile(work, found.motors, found.blocks)


def _problem(error: Exception) -> str:
    """Why a file gives no rows; of what is no error of the file, where in the program it was raised."""
    said = " ".join(str(error).split())
    if isinstance(error, HaptidError):
        return said
    if isinstance(error, MemoryError):
        return "its worker has too little memory: write shorter files, or use fewer workers."
    last = traceback.extract_tb(error.__traceback__)[-1]
    at = f"{Path(last.filename).name}:{last.lineno}"
    return f"{_DEFECT}, please report it with the file: {type(error).__name__} in {at}: {said}"


def in_fewer_blocks(observation: Observation, most: int) -> Observation:
    """An observation in at most so many time blocks, each of neighbours; without its motions."""
    count = len(observation.blocks)
    edges = np.linspace(0, count, min(most, count) + 1).astype(int).tolist()
    spans = list(pairwise(edges))

    def of(motor: MotorRows) -> MotorRows:
        size = motor.r_factors.shape[-1]
        stacks = [r_factor(motor.r_factors[a:b].reshape(-1, size)) for a, b in spans]
        rows = np.array([motor.rows[a:b].sum() for a, b in spans])
        return replace(motor, r_factors=freeze(np.array(stacks)), rows=rows)

    first_and_last = [(observation.blocks[a], observation.blocks[b - 1]) for a, b in spans]
    blocks = tuple(
        replace(a, stop=b.stop) if a.log == b.log else Block(f"{a.log} to {b.log}", 0.0, 1.0) for a, b in first_and_last
    )
    return replace(observation, motors=tuple(map(of, observation.motors)), blocks=blocks, motions=())


@on_one_blas_thread
def identify_pool(
    study: Study,
    source: str,
    data: str | Path | None = None,
    progress: _Progress | None = None,
    workers: Executor | None = None,
    done: Callable[[FileWork], None] | None = None,
    kept: PoolParts | None = None,
) -> Pool:
    """Identify one device from all log files of a data set together.

    Each file is read, checked, filtered and reduced by itself, whatever worker has it, and a file of a lost worker is
    given to another one. R factors come back, of at most 512 time blocks in all: memory grows with one file and not
    with their number. The treatment is proposed from the study's own logs, and what it leaves uncertain there, such as
    the delay, is in every standard error: it does not become less with more files.

    A file that cannot be read is listed with its problem, and so are copies of another one, which counts once. Each
    loses the rows at its ends that the filters reach.
    Times, episodes and criteria of the study do not count for the files, which the notes say.

    Args:
        study: whose first log's channels all files have.
        source: see `data_files`.
        data: where the study's relative log paths start; the study's own folder where None.
        progress: called with the name of a step and the share of it done.
        workers: executor of the files; this process where None.
        done: called with the work on each file as soon as it is done.
        kept: rows of the files of an interrupted run, to which those of this one are added; of files that are the same,
            and of the same study, device and version of haptid, they are not computed again.

    Raises:
        StudyFileError: the device or the method asks for more than R factors.
        LogFileError: the data set has no log file, or none that can be identified.
        HaptidError: any error of the study's own logs.
    """
    progress = progress or silent
    model = DynamicModel(read_device(study.device))
    study = study.on(model.device)
    _refuse_more_than_r_factors(study, model)
    files = data_files(source)
    own = [read_entry(entry, Path(data or study.path.parent), progress) for entry in study.logs]
    progress("choosing a treatment", 0.0)
    proposal = propose(model, *logs_to_propose_from(study, own), **study.treatment)
    alone = observe(model, *(treat(log, proposal.treatment) for log in study.of_fit(own)))
    progress("choosing a treatment", 1.0)
    begin = time.perf_counter()
    work = _Reducer(study, proposal, max(1, MOST_BLOCKS // len(files)))
    key = f"{fleet_fingerprint(study, model, own, proposal.treatment)} {work.blocks}"
    reduced = _told(_each_once(_reduced(work, files, workers or SerialExecutor(), kept, key)), done)
    rows, works = _together(model, files, reduced, progress)
    seconds = time.perf_counter() - begin
    found = _with_uncertainty(estimate(rows, study.method, study.intervals), alone, study, proposal)
    unseen, why = _unseen(rows, study)
    return Pool(study.name, proposal.treatment, found, unseen, works, seconds, (*why, *_left_out(study)))


def _left_out(study: Study) -> Iterator[str]:
    """Sentences on what of a study does not count for the files."""
    keys = {"time_range": None, "exclude": (), "episodes": None}
    given = [f"`{key}`" for key, nothing in keys.items() if any(getattr(one, key) != nothing for one in study.logs)]
    if given:
        yield (
            f"{', '.join(given)} of the study's own logs count where the treatment is proposed; the files are used as "
            "a whole."
        )
    if study.use != "auto":
        yield f'`use = "{study.use}"` of the study does not count: the parameters are those of {study.method.name}.'
    if study.largest_error is not None:
        yield f"The study's criterion, at most {study.largest_error:g} % on unseen rows, is not judged."


def _each_once(results: Iterator[tuple[int, ReducedFile]]) -> Iterator[tuple[int, ReducedFile]]:
    """The results; of files with one content the first that is done, as twice its rows would halve every variance."""
    seen: dict[str, str] = {}
    for k, one in results:
        content = one.blocks[0].log if one.blocks else one.work.name
        name = seen.setdefault(content, one.work.name)
        if name != one.work.name:
            why = f"left out, as it has the content of {name}, which would count twice."
            yield k, ReducedFile(replace(one.work, problem=why))
        else:
            yield k, one


def _reduced(
    work: _Reducer, files: Sequence[DataFile], workers: Executor, kept: PoolParts | None, study: str
) -> Iterator[tuple[int, ReducedFile]]:
    """Index and rows of each file: those of an interrupted run, then the others as they are done."""
    missing = []
    for k, file in enumerate(files):
        before = kept.read(study, file) if kept is not None else None
        if before is None:
            missing.append(k)
        else:
            yield k, before
    for j, one in workers.map(work, [files[k] for k in missing]):
        if kept is not None and one.motors:
            kept.write(study, files[missing[j]], one)
        yield missing[j], one


def _told(
    results: Iterator[tuple[int, ReducedFile]], done: Callable[[FileWork], None] | None
) -> Iterator[tuple[int, ReducedFile]]:
    """The results, each after its work was told."""
    for k, one in results:
        if done:
            done(one.work)
        yield k, one


def _refuse_more_than_r_factors(study: Study, model: DynamicModel) -> None:
    """Raise StudyFileError where R factors alone do not do."""
    check_kind(study)
    if study.calibration is not None or has_nonlinear_constants(model) or any(entry.body for entry in study.logs):
        raise fault(
            study.path,
            "device" if has_nonlinear_constants(model) else "logs",
            "has nonlinear constants, friction by load, zeros of encoders or payloads to find, which a pool does not",
            advice="Find them from a few of the logs with `haptid identify`, and fix them in the device file.",
        )
    weighting = getattr(study.method, "weighting", study.method)
    if isinstance(study.method, Fitting) or not isinstance(weighting, OLS | WLS):
        raise fault(
            study.path,
            "estimate.method",
            f"is {study.method.name}, which needs the samples again",
            found=study.method.name,
            advice='Write method = "wls" or "ols", with constraints if wanted: they need R factors alone.',
        )


def _together(
    model: DynamicModel, files: Sequence[DataFile], done: Iterator[tuple[int, ReducedFile]], progress: _Progress
) -> tuple[Observation, tuple[FileWork, ...]]:
    """The rows of all files in the files' order, whatever order they come in, and the work on each."""
    size = -(-len(files) // MOST_BLOCKS)  # files of one block
    works: dict[int, FileWork] = {}
    waiting: dict[int, dict[int, ReducedFile]] = {}
    groups: dict[int, Observation] = {}
    for k, one in done:
        works[k] = one.work
        group = waiting.setdefault(k // size, {})
        group[k] = one
        if len(group) == min(size, len(files) - k // size * size):
            parts = [group[j] for j in sorted(group) if group[j].motors]
            if parts:
                groups[k // size] = _group(model, parts, size)
            del waiting[k // size]
        progress("reducing files", len(works) / len(files))
    if not groups:
        raise LogFileError(
            f"none of {len(files)} files gives rows; the first, {files[0].name}: {works[0].problem}",
            where=files[0].name,
            found=len(files),
            advice="Mend what it says, or the study's channels.",
        )
    rows = concatenated(groups[k] for k in sorted(groups))
    return rows, tuple(works[k] for k in range(len(files)))


def _group(model: DynamicModel, parts: Sequence[ReducedFile], size: int) -> Observation:
    """The rows of neighbouring files: the blocks of one, or one block of several."""
    rows = concatenated(Observation(model, part.motors, part.blocks, ()) for part in parts)
    return rows if size == 1 else in_fewer_blocks(rows, 1)


def _with_uncertainty(found: Estimate, alone: Observation, study: Study, proposal: Proposal) -> Estimate:
    """An estimate with what its treatment leaves uncertain in the study's own logs."""
    own = estimate(alone, study.method, study.intervals)
    found, _ = without_bias(found, proposal.effects)
    return found.with_nuisances_of(with_all_uncertainty(own, proposal, None))


def _unseen(rows: Observation, study: Study) -> tuple[Validation | None, tuple[str, ...]]:
    """Errors of alternate blocks, each half predicted from the other; None where a half does not do, and why."""
    count = len(rows.blocks)
    left_out = f"The error on unseen blocks is left out: the files that give rows are in {count} time "
    if count < 2:
        return None, (
            "Nothing says how uncertain the parameters are: standard errors are from the scatter between time blocks, "
            f"and all {rows.rows} rows are in one. Add files, or mend those that failed; until then use the values for "
            "nothing that has to hold.",
            f"{left_out}block.",
        )
    halves = rows.alternate()
    try:
        fits = [estimate(half, study.method) for half in halves]
    except EstimationError as error:
        why = " ".join(str(error).removesuffix(error.advice).split())
        return None, (f"{left_out}blocks, and every other one alone is too little: {why}",)
    return pooled(*(validate(fit, half) for fit, half in zip(fits, reversed(halves), strict=True))), ()
