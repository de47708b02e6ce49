"""`haptid response`."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from haptid.cli.common import AsJson, DataFolder, Quiet, StudyFile, command, compute_into

if TYPE_CHECKING:
    from haptid.inference.frequency_response import FrequencyResponse

HELP = """\
Estimate the frequency response of a device from logs of a motion that repeats, and the springs that it shows.

The logs are those of the study with the role `identify`: as many as motors, or more, each of another motion with the
same period (a multisine whose frequencies are multiples of one over it), three periods or more. No model is needed but
which motor moves what: intervals are from what the periods differ by. Writes into OUT:

- `response.csv`: real and imaginary part of position by torque at every excited frequency, for each position and
  torque, and the radius of the circle that holds the true value at 95 %
- `response.json`: the same figures, and of every motor, the others held, stiffness, damping and inertias of a rotor and
  a link on a spring, or why there is none
- `response.png`: compliance of each motor against frequency, and that of the rotor, spring and link

Exit status: 0 on success, 2 on an error; the message says what to do.

Example: `haptid response study.toml --out response`
"""
# Mean square of the error in standard errors, and error over the dynamic stiffness, above which a line says so.
_POOR, _LARGE = 2.0, 0.03


@command(HELP)
def response(
    study: StudyFile,
    data: DataFolder = None,
    period: Annotated[
        float | None, typer.Option(min=1e-6, help="of the motion, s; found in the first log where left out")
    ] = None,
    out_folder: Annotated[Path, typer.Option("--out", help="folder for the results")] = Path("haptid-response"),
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    from haptid._internal.escaping import write_csv
    from haptid.cli.outputs import output_text
    from haptid.report.frequency_response import plot_response

    def compute(folder: Path, progress: Callable[[str, float], None]) -> tuple[str, str]:
        found = _of_study(study, data, period, progress)
        write_csv(folder / "response.csv", found.table())
        text = output_text("response", values(found))
        (folder / "response.json").write_text(text, encoding="utf-8")
        plot_response(found, folder / "response.png")
        return text, "\n".join(sentences(found))

    compute_into(out_folder, quiet, as_json, compute)


def _of_study(
    path: Path, data: Path | None, period: float | None, progress: Callable[[str, float], None]
) -> FrequencyResponse:
    """The frequency response of the logs of a study."""
    from haptid.device import read_device
    from haptid.dynamics.model import DynamicModel
    from haptid.inference.frequency_response import multisine_response
    from haptid.log import read_log
    from haptid.study import read_study

    study = read_study(path)
    model = DynamicModel(read_device(study.device))
    entries, logs = study.of_fit(study.logs), []
    for k, entry in enumerate(entries):
        progress("reading the logs", k / len(entries))
        place = Path(data or study.path.parent) / entry.path
        logs.append(read_log(place, entry.channels, entry.time_range, entry.episodes))
    progress("reading the logs", 1.0)
    return multisine_response(model, logs, period, study.treatment.get("torque_delay_s"))


def values(found: FrequencyResponse) -> dict[str, Any]:
    """All figures as JSON values."""
    pairs = [(i, j) for i in range(len(found.labels)) for j in range(len(found.labels))]
    radius = found.radius
    return {
        "device": found.device,
        "period": found.period,
        "periods": list(found.periods),
        "f": found.f.tolist(),
        "responses": [
            {
                "position": found.labels[i],
                "torque": found.labels[j],
                "unit": found.unit(i, j),
                "real": found.G[:, i, j].real.tolist(),
                "imaginary": found.G[:, i, j].imag.tolist(),
                "radius": radius[:, i, j].tolist(),
            }
            for i, j in pairs
        ],
        "springs": [_spring(found, motor) for motor in range(len(found.labels))],
    }


def _spring(found: FrequencyResponse, motor: int) -> dict[str, Any]:
    """The spring of a motor as JSON values, or why there is none."""
    from haptid.inference.frequency_response import Spring

    spring = found.springs[motor]
    given = {"motor": found.labels[motor]}
    if not isinstance(spring, Spring):
        return {**given, "problem": str(spring)}
    names = ("stiffness", "se", "dof", "damping", "link", "rotor", "link_friction", "rotor_friction")
    return {
        **given,
        "problem": "",
        **{name: getattr(spring, name) for name in names},
        "conf_int": spring.conf_int(),
        "antiresonance_hz": spring.antiresonance,
        "misfit": spring.misfit,
        "error_percent": 100 * spring.error,
    }


def sentences(found: FrequencyResponse) -> list[str]:
    """What a user reads first: frequencies, and a line for each motor."""
    from haptid.inference.frequency_response import Spring
    from haptid.uncertainty.figures import per_cent, with_digits

    count = len(found.periods)
    lines = [
        f"{found.device}: {len(found.f)} frequencies from {found.f[0]:.3g} to {found.f[-1]:.3g} Hz are excited; period "
        f"{found.period:.4g} s, {min(found.periods)} times{f' or more in each of {count} logs' if count > 1 else ''}."
    ]
    for label, spring, unit in zip(found.labels, found.springs, found.units, strict=True):
        if not isinstance(spring, Spring):
            lines.append(f"{label}: {spring}")
            continue
        value, low, high = (with_digits(x, spring.se) for x in (spring.stiffness, *spring.conf_int()))
        lines.append(
            f"{label}: a spring of {value} {'N' if unit == 'm' else 'N m'}/{unit} ({low} to {high}); the link on it, "
            f"the motor held, is at {spring.antiresonance:.3g} Hz. Rotor, spring and link explain the dynamic "
            f"stiffness to {per_cent(100 * spring.error)}."
        )
        if spring.misfit > _POOR and spring.error > _LARGE:
            lines.append(
                f"  That is {spring.misfit**0.5:.1f} times its noise: there is more, dry friction for instance, whose "
                "share a larger motion lowers, or a second spring."
            )
    return lines
