"""`haptid excite`."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from haptid._internal.late import dataclass
from haptid.cli import excite_options, excite_search
from haptid.cli.common import AsJson, DeviceName, Quiet, command, errors_shown, out, print_json, progress_bars

if TYPE_CHECKING:
    from haptid.device.priors import PriorBody
    from haptid.experiment.bench import Experiment
    from haptid.experiment.excitation import (
        Excitation,
        FurtherMotions,
        PlannedMotion,
    )

HELP = """\
Optimise an exciting motion: base parameters with narrow intervals, within the limits of the device.

Limits are those of the DEVICE file, unless replaced by --centre with --stroke, or --speed; --acceleration,
--jerk, --torque, --rms-torque, --power and --handle-force add some.
Shapes in [[collision]] of DEVICE, and of the file --world, keep their distance; the whole motion is checked, between
samples too.
The motion is a Fourier series, or triangles with superimposed sines (--triangles). Writes:

- `OUT`: an experiment file for `haptid bench`
- `OUT` with .csv in place of .toml: samples for a real controller: t, then position, velocity and acceleration of each
  joint

  --samples     samples in other formats, by the ending of the name: .csv, .yaml (a ROS 2 JointTrajectory), .mcap
                (the same as a bag), .h (arrays in C), .m (MATLAB timeseries), .json (LeRobot actions, degrees and m)

  --player      one C99 file that plays all motions in the user's control loop: soft start, limits, watchdog, playback,
                numbered recording into a ring buffer; its first lines say how it is called

  --page        one HTML file: each motion over time within its limits, and what is known of each parameter before and
                after

  --rehearsal   OUT-rehearsal.csv: the same path at a share of the speed, such as 0.2

  --motions     number of motions, each designed given those before it: OUT-1.toml, OUT-2.toml, ..

  --buffer      most samples of a motion at --rate-hz, with its start and stop

  --friction-test, --poses, --reversals, --payload
                further motions of the same campaign, within the same limits: OUT-friction.toml, OUT-poses.toml, ..:
                strokes at constant speeds, joint after joint; held poses that determine gravity best, each from both
                sides; small slow motions with many reversals; the motion again with a known body on a link. They go
                into --samples, --player and --page too. With --motions 0 there are no others

  --after       the next motion of a campaign: given the logs of this result (a folder of `haptid identify`), the one
                that lowers the largest relative interval most, over all essential parameters or those of --parameter.
                Prints the predicted intervals; with --accuracy, how long it takes until all have it. Nothing is
                written where they do already.

With --like, controller, instruments and true parameters are those of another experiment. Where these have encoders
or noise, the intervals that a log will give are predicted, behind the treatment that it will get (with --study, what
the [treatment] of a study gives stays). Prints the condition number of the observation matrix, raw and with columns of
unit length, before and after the search.

Exit status: 0 on success, 2 on an error; the message says what to do.

Example: `haptid excite phantom_premium_15 --like examples/phantom/experiment.toml --speed 3 --out excite.toml`
"""


@command(HELP)
def excite(
    device: DeviceName,
    out_file: Annotated[Path, typer.Option("--out", help="the experiment to write, a .toml file", show_default=False)],
    like: Annotated[Path | None, typer.Option(help="an experiment with the controller to use")] = None,
    study: Annotated[Path | None, typer.Option(help="with --like: a study whose [treatment] the log will get")] = None,
    after: Annotated[Path | None, typer.Option(help="a result: the next motion, given its logs")] = None,
    accuracy: Annotated[
        float | None, typer.Option(help="wanted half width of the intervals, per cent of the value")
    ] = None,
    centre: Annotated[str | None, typer.Option(help="of the motion, rad or m: 0,0.2,0.3")] = None,
    stroke: Annotated[str | None, typer.Option(help="to either side of the centre: one, or one each")] = None,
    speed: Annotated[str | None, typer.Option(help="largest, rad/s or m/s: one, or one each")] = None,
    acceleration: Annotated[str | None, typer.Option(help="largest, rad/s^2 or m/s^2: one, or one each")] = None,
    start: Annotated[str | None, typer.Option(help="pose of rest before and after: 0,0.2,0.3")] = None,
    world: Annotated[Path | None, typer.Option(help="a file of shapes about the device (TOML)")] = None,
    clearance_mm: Annotated[float, typer.Option(min=0.0, help="least distance of collision shapes")] = 10.0,
    triangles: Annotated[bool, typer.Option("--triangles", help="triangles with superimposed sines")] = False,
    seconds: Annotated[float | None, typer.Option(min=1.0, help="duration of the motion")] = None,
    count: Annotated[int, typer.Option("--motions", min=0, max=100, help="number of motions")] = 1,
    friction: Annotated[bool, typer.Option("--friction-test", help="also strokes at constant speeds")] = False,
    poses: Annotated[int | None, typer.Option(min=2, max=200, help="number of held poses, from both sides")] = None,
    reversals: Annotated[bool, typer.Option("--reversals", help="also small motions with many reversals")] = False,
    payload: Annotated[
        str | None, typer.Option(help="also the motion with a body on a link: LINK=KG@X,Y,Z, m in the link's frame")
    ] = None,
    buffer: Annotated[int | None, typer.Option(min=2, help="samples that a controller can hold")] = None,
    keep: Annotated[
        list[str] | None, typer.Option("--parameter", help="a base parameter to excite (default: all)")
    ] = None,
    criterion: Annotated[
        str | None, typer.Option(help="d-optimal (default), condition, raw-condition, a-optimal or largest-error")
    ] = None,
    max_evaluations: Annotated[int, typer.Option(min=1, help="largest number of motions evaluated")] = 1000,
    seed: Annotated[int, typer.Option(min=0, help="of the search")] = 0,
    rate_hz: Annotated[float, typer.Option(min=1.0, help="of the samples in the CSV")] = 1000.0,
    also: Annotated[
        list[Path] | None, typer.Option("--samples", help="more samples: .csv, .yaml, .mcap (ROS 2), .h (C), .m, .json")
    ] = None,
    player: Annotated[Path | None, typer.Option(help="a .c file that plays the motions in a control loop")] = None,
    page_file: Annotated[
        Path | None, typer.Option("--page", help="an .html page: the motion within its limits, information gained")
    ] = None,
    rehearsal: Annotated[
        float | None, typer.Option(min=0.01, max=1.0, help="also samples at this share of the speed")
    ] = None,
    torque: Annotated[str | None, typer.Option(help="largest of each torque row, N m or N: one, or one each")] = None,
    confidence: Annotated[
        float | None, typer.Option("--torque-confidence", help="per cent: of --torque, given uncertain parameters")
    ] = None,
    rms_torque: Annotated[
        str | None, typer.Option(help="largest root mean square of each torque row, N m or N: one, or one each")
    ] = None,
    power: Annotated[str | None, typer.Option(help="largest of each torque row, W: one, or one each")] = None,
    jerk: Annotated[str | None, typer.Option(help="largest, rad/s^3 or m/s^3: one, or one each")] = None,
    handle_force: Annotated[
        float | None, typer.Option(help="largest at the handle that the torques are equivalent to, N")
    ] = None,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    from haptid.device import read_device, read_world
    from haptid.dynamics.model import DynamicModel
    from haptid.experiment.bench import read_experiment
    from haptid.experiment.excitation import CRITERIA, Search
    from haptid.study import read_study

    with errors_shown():
        excite_options.check_criterion(criterion, after, count)
        excite_options.check_instruments(like, study, after, accuracy)
        excite_options.check_files(out_file, also or [], page_file, player)
        excite_options.check_families(count, any((friction, poses, reversals)), after, payload)
        model = DynamicModel(read_device(device))
        other = None if like is None else read_experiment(like)
        setup = None if other is None else other.setup(model)
        given = {} if study is None else read_study(study).treatment
        rates = {"speed": speed, "acceleration": acceleration, "jerk": jerk}
        efforts = {"torque": torque, "rms_torque": rms_torque, "power": power}
        within = replace(
            excite_options.limit_options(model.device, centre, stroke, rates, efforts),
            torque_confidence=None if confidence is None else confidence / 100,
            handle_force=handle_force,
            clearance=1e-3 * clearance_mm,
            world=() if world is None else read_world(world),
        )
        request = excite_search.Request(
            model,
            excite_options.family_options(
                model.device, triangles, seconds, start, None if buffer is None else (buffer, rate_hz)
            ),
            within,
            CRITERIA[criterion or "d-optimal"],
            tuple(keep) if keep else None,
            None if setup is None else model.base.of(setup.chi),
            Search(tries=max_evaluations, seed=seed),
        )
        load = None if payload is None else excite_options.payload_option(payload, model)
        wanted = {"friction": friction, "poses": poses, "reversals": reversals}
        label = "largest relative interval" if after is not None or count > 1 else criterion or "d-optimal"
        with progress_bars(quiet or as_json) as bars:
            task = bars.add_task("searching", total=1.0)

            def progress(share: float, cost: float) -> None:
                bars.update(task, completed=share, description=_so_far(label, cost))

            expected = None if setup is None or after is not None else excite_search.Expected(setup, given)
            motions, further = excite_search.searched(request, count, after, accuracy, expected, progress)
            others = excite_search.others({k: v for k, v in wanted.items() if v}, request, motions, start)
            if load is not None:
                others["payload"] = excite_search.loaded(request, load, motions, progress)
        planned = _Planned(motions, others, further, load)
        files = planned.write(out_file, also or [], other, rate_hz, rehearsal)
        if files:
            _write_together(files, further, rate_hz, player, page_file)
    if as_json:
        print_json("excite", planned.values(files))
    elif not quiet:
        planned.show(files, out_file)


@dataclass(frozen=True, eq=False)
class _Planned:
    """The motions of a command.

    Attributes:
        motions: exciting motions.
        others: of the other families, by name.
        further: what the exciting motions are predicted to bring; None for a single one without logs before it.
        load: link and body of the motion "payload".
    """

    motions: Sequence[Excitation]
    others: Mapping[str, PlannedMotion]
    further: FurtherMotions | None
    load: tuple[str, PriorBody] | None

    @property
    def first(self) -> bool:
        """Whether there is one exciting motion at most, and no log before it."""
        return self.further is None or (self.further.basis is not None and len(self.motions) == 1)

    def write(
        self, out_file: Path, also: Sequence[Path], like: Experiment | None, rate_hz: float, rehearsal: float | None
    ) -> dict[Path, PlannedMotion]:
        """Write the experiment and the samples of each motion; the motions by the path of their experiment."""
        named: dict[str, PlannedMotion] = {
            _suffix(k, len(self.motions)): motion for k, motion in enumerate(self.motions)
        }
        named |= {f"-{name}": motion for name, motion in self.others.items()}
        files = {}
        for name, motion in named.items():
            path = out_file.with_name(f"{out_file.stem}{name}.toml")
            copies = [motion.with_name(f"{motion.stem}{name}{motion.suffix}") for motion in also]
            _write(motion, path, copies, like, rate_hz, rehearsal, self.load if name == "-payload" else None)
            files[path] = motion
        return files

    def values(self, files: Mapping[Path, PlannedMotion]) -> dict[str, Any]:
        """All of them as JSON values."""
        motions = [_values(motion, path) for path, motion in files.items()]
        own = motions[0] if self.first and len(motions) == 1 else {"motions": motions}
        return {**own, **_predicted(self.further)}

    def show(self, files: Mapping[Path, PlannedMotion], out_file: Path) -> None:
        """Print what was found, where it is, and what to do with the logs."""
        for path, motion in files.items():
            _show(motion, path, condition=self.first)
        _show_overlapping(list(files.values()))
        for name in self.others:
            _show_next(name, out_file, self.load)
        if self.further is not None:
            _show_intervals(self.further)


def _suffix(k: int, count: int) -> str:
    """What is added to the name of a motion's file: nothing for the only one, else -1, -2, .."""
    return "" if count == 1 else f"-{k + 1}"


def _write(
    motion: PlannedMotion,
    out_file: Path,
    also: list[Path],
    like: Experiment | None,
    rate_hz: float,
    rehearsal: float | None,
    weight: tuple[str, PriorBody] | None,
) -> None:
    """Write the experiment of a motion, with a weight on a link or without, and its samples."""
    from haptid.experiment.excitation import MotionSamples, write_experiment, write_motion
    from haptid.experiment.excitation.writing import plain_experiment

    files = [(path, 1.0) for path in also]
    if rehearsal is not None:
        files.append((out_file.with_name(f"{out_file.stem}-rehearsal.csv"), rehearsal))
    for path, share in files:
        write_motion(path, MotionSamples.of(motion, rate_hz, share))
    write_experiment(out_file, motion, plain_experiment(motion) if like is None else like, rate_hz, weight)


def _write_together(
    files: Mapping[Path, PlannedMotion],
    further: FurtherMotions | None,
    rate_hz: float,
    player: Path | None,
    page_file: Path | None,
) -> None:
    """Write what has all motions of the command: the player and the page."""
    from haptid._internal.atomic_folder import publishing_files
    from haptid.experiment.excitation import MotionSamples, write_player

    if player is not None:
        write_player(player, [MotionSamples.of(motion, rate_hz) for motion in files.values()])
    if page_file is not None:
        from haptid.report.motion_page import motion_page

        text = motion_page({file.stem: motion for file, motion in files.items()}, further)
        with publishing_files(page_file) as folder:
            (folder / page_file.name).write_text(text, encoding="utf-8")


def _predicted(further: FurtherMotions | None) -> dict[str, Any]:
    """Predicted intervals as JSON values; nothing without a campaign."""
    if further is None:
        return {}
    intervals = [
        {"name": name, "before_percent": before, "after_percent": after} for name, before, after in further.table()
    ]
    return {
        "intervals": intervals,
        "accuracy_percent": further.accuracy,
        "reached": further.reached,
        "seconds": further.seconds,
        "seconds_needed": further.needed,
        "sentences": list(further.sentences),
    }


def _show_intervals(further: FurtherMotions) -> None:
    """Print predicted intervals, the widest first."""
    if not further.reached:
        out.print("95 % intervals, per cent of the value: so far, and predicted with the motion", highlight=False)
        for name, before, after in further.table():
            texts = [f"+-{x:.3g}" if math.isfinite(x) else "none" for x in (before, after)]
            out.print(f"  {name:10s} {texts[0]:>9s} {texts[1]:>9s}", highlight=False)
    for sentence in further.sentences:
        out.print(sentence, highlight=False, soft_wrap=True)


def _so_far(criterion: str, cost: float) -> str:
    """State of the search, for its progress bar."""
    return f"{criterion} {math.exp(cost):.4g}" if math.isfinite(cost) else "no motion within the limits yet"


def _values(motion: PlannedMotion, path: Path) -> dict[str, Any]:
    """A motion as JSON values."""
    from haptid.experiment.excitation import Excitation

    files = {"experiment": str(path), "samples": str(path.with_suffix(".csv"))}
    if not isinstance(motion, Excitation):
        return {**files, "seconds": motion.seconds}
    conditions = {
        when: {"raw": value.raw, "scaled": value.scaled}
        for when, value in (("first_condition", motion.before), ("condition", motion.after))
    }
    searched = {"parameters": list(motion.after.names), "motions_evaluated": motion.tried}
    return {**files, **searched, **conditions, "predicted_relative_se_percent": dict(motion.predicted)}


def _show(motion: PlannedMotion, path: Path, condition: bool) -> None:
    """Print condition numbers before and after, and the paths of the files."""
    from haptid.experiment.excitation import Excitation

    if isinstance(motion, Excitation):
        _show_condition(motion, condition)
    if motion.clearance is not None:
        out.print(f"  {motion.clearance}", highlight=False)
    lasts = f"{motion.seconds:.4g} s; experiment in {path}, samples in {path.with_suffix('.csv')}"
    out.print(lasts, highlight=False, soft_wrap=True)


def _show_condition(motion: Excitation, condition: bool) -> None:
    """Print what the search did, and condition numbers before and after where they count."""
    out.print(
        f"{motion.model.device.name}: {len(motion.after.names)} parameters, {motion.tried} motions evaluated",
        style="bold",
    )
    for when, value in (("first motion within the limits", motion.before), ("motion found", motion.after)):
        if not condition:
            break
        out.print(f"  {when}: condition {value.raw:.4g} raw, {value.scaled:.4g} with unit columns", highlight=False)
    weak = [name for name, se in motion.predicted.items() if 50 < se < math.inf]
    if condition and weak and len(weak) < len(motion.after.names):
        out.print(f"  poorly identifiable at the prior values: {', '.join(weak)}", highlight=False)


def _show_overlapping(motions: Sequence[PlannedMotion]) -> None:
    """Print the pairs of shapes that are left out."""
    collision = motions[0].bounds.collision if motions else None
    if collision is not None and collision.overlapping:
        pairs = "; ".join(collision.overlapping)
        out.print(f"left out, as they overlap in every pose: {pairs}", highlight=False, soft_wrap=True)


def _show_next(name: str, out_file: Path, load: tuple[str, PriorBody] | None) -> None:
    """Print what the log of another family is for, and the command that evaluates it."""
    from haptid.experiment.excitation import CAMPAIGN_FAMILIES

    stem = f"{out_file.stem}-{name}"
    if name == "payload":
        assert load is not None  # as there is such a motion
        link, body = load
        com = ", ".join(f"{x:g}" for x in body.com.tolist())
        text = f'`payload = {{ link = "{link}", mass = {body.mass:g}, com = [{com}] }}` with its log in the study'
        out.print(f"{stem}: torque constants; {text}, then `haptid payload --gains`", highlight=False, soft_wrap=True)
    else:
        family = CAMPAIGN_FAMILIES[name]
        out.print(f"{stem}: {family.what}; `{family.then}`", highlight=False, soft_wrap=True)
