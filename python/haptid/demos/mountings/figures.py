"""The paper's figures, with the demonstration's own numbers, in units of command."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from haptid._internal.arrays import Array
from haptid.demos.drawing import BLACK, BLUE, GREEN, ORANGE, PURPLE, Curve, lines, panels, picture
from haptid.demos.kind import Tell
from haptid.demos.mountings.finding import Results
from haptid.demos.mountings.fits import Fit, Fits
from haptid.demos.mountings.hand import Felt
from haptid.dynamics.model import DynamicModel
from haptid.end_effector.torque_decomposition import decompose_torque
from haptid.motion.treatment import Motion
from haptid.observation.rows import chunks
from haptid.validation.prediction import predict

# Seconds that are drawn, from the beginning of the half that validates.
TORQUES, PARTS = 9.0, 10.0
FIRST_OF_PARTS = 7


def draw_all(found: Results, folder: Path, tell: Tell) -> None:
    """Every figure, into files fig03.png and so on."""
    first, last = found.fits[found.demo.mountings[0].key], FIRST_OF_PARTS + len(found.fits)
    jobs: list[tuple[str, Callable[[Path], None]]] = [
        ("fig03.png", partial(draw_constants, first)),
        ("fig04.png", partial(draw_clusters, first)),
        ("fig05.png", partial(draw_friction_fit, first)),
        ("fig06.png", partial(draw_friction, first)),
        *(
            (f"fig{k:02d}.png", partial(draw_parts, fits, k))
            for k, fits in enumerate(found.fits.values(), FIRST_OF_PARTS)
        ),
        (f"fig{last:02d}.png", partial(draw_hand, found, last)),
    ]
    for k, (name, draw) in enumerate(jobs):
        tell("drawing", k / len(jobs))
        draw(folder / name)
    tell("drawing", 1.0)


def per_command(model: DynamicModel) -> Array:
    """Command per torque of each motor, (motors,)."""
    return np.array([1.0 / (drive.gear * drive.gain) for drive in model.device.motors])


def beginning(motion: Motion, seconds: float) -> Motion:
    """The first seconds of a motion whose rates are known."""
    n = min(len(motion), round(seconds / motion.dt))
    assert motion.rates is not None
    qd, qdd = motion.rates
    return replace(motion, q=motion.q[:n], tau=motion.tau[:n], rates=(qd[:n], qdd[:n]))


def torques(fit: Fit, seconds: float, beta: Array | None = None) -> tuple[Array, Array, Array]:
    """Times (rows,), measured and predicted command (motors, rows) of the first seconds of the unseen half."""
    model = fit.estimate if beta is None else replace(fit.estimate, beta=beta)
    made, scale = predict(model, beginning(fit.unseen, seconds)), per_command(fit.estimate.model)[:, None]
    return made.t, scale * made.measured, scale * made.predicted


def draw_constants(fits: Fits, path: Path) -> None:
    """Measured torque, and predicted without friction: by a fit and by the constants of measured bodies."""
    fit = fits["frictionless"]
    model = fit.estimate.model
    t, measured, predicted = torques(fit, TORQUES)
    constants = torques(fit, TORQUES, model.base.of(np.nan_to_num(model.device.chi_prior)))[2]
    curves = [
        Curve("measured", measured, BLACK, 2.0),
        Curve("fit of 8 parameters", predicted, BLUE),
        Curve("constants of [1]", constants, ORANGE, style="--"),
    ]
    panels("Fig. 3: filtered torque without a friction model", t, curves, _labels(model), path)


def draw_friction_fit(fits: Fits, path: Path) -> None:
    """The same with friction: the fit follows."""
    t, measured, predicted = torques(fits["exact"], TORQUES)
    curves = [Curve("measured", measured, BLACK, 2.0), Curve("fit of 14 parameters", predicted, BLUE)]
    panels("Fig. 5: filtered torque with friction in the model", t, curves, _labels(fits.model), path)


def draw_clusters(fits: Fits, path: Path) -> None:
    """The error of the fit without friction against velocity: two clusters, by the sign of the velocity."""
    fit = fits["frictionless"]
    model, scale = fit.estimate.model, per_command(fit.estimate.model)[:, None]
    made = predict(fit.estimate, fit.unseen)
    speed = np.concatenate([s.filtered(s.cd) for s in chunks(model, fit.unseen)], axis=1)
    error = scale * (made.measured - made.predicted)
    figure = picture("Fig. 4: what 8 parameters do not predict, against velocity", (10, 3.6))
    for k, panel in enumerate(figure.subplots(1, len(error))):
        panel.plot(speed[k], error[k], ".", color=BLUE, markersize=2)
        panel.axhline(0, color=BLACK, linewidth=0.6)
        panel.axvline(0, color=BLACK, linewidth=0.6)
        panel.set_xlabel(f"velocity of joint {k + 1}, rad/s")
        panel.set_title(model.device.row_labels[k], fontsize="medium")
        panel.grid(alpha=0.3)
        if k == 0:
            panel.set_ylabel("measured less predicted,\nN m of command")
    figure.savefig(path, dpi=120)


def draw_friction(fits: Fits, path: Path) -> None:
    """Friction of every motor: viscous, Coulomb, and both."""
    t, parts = _parts(fits["exact"], TORQUES)
    both = parts["viscous"] + parts["Coulomb"]
    curves = [
        Curve("friction", both, BLACK, 2.0),
        Curve("Coulomb", parts["Coulomb"], BLUE),
        Curve("viscous", parts["viscous"], ORANGE),
    ]
    panels("Fig. 6: friction", t, curves, _labels(fits.model), path)


def draw_parts(fits: Fits, number: int, path: Path) -> None:
    """What the torque of one mounting is made of."""
    t, parts = _parts(fits["exact"], PARTS)
    names = {
        "measured": ("torque", BLACK, 2.0),
        "inertia": ("inertia", BLUE, 1.2),
        "Coriolis and centrifugal": ("Coriolis and centrifugal", GREEN, 1.2),
        "gravity": ("gravity", ORANGE, 1.2),
        "friction": ("friction", PURPLE, 1.2),
    }
    curves = [Curve(name, parts[part], colour, width) for part, (name, colour, width) in names.items()]
    title = f"Fig. {number}: what the torque is made of, mounting {fits.mounting.title}"
    panels(title, t, curves, _labels(fits.model), path)


def draw_hand(found: Results, number: int, path: Path) -> None:
    """The hand's force along one axis: measured, estimated with the model and without, and the errors."""
    felt, axis = found.felt, found.demo.hand.axis
    name = "xyz"[axis]
    upper = _along(felt, axis, {"measured": (BLACK, 2.0), "bare": (ORANGE, 1.0), "modelled": (BLUE, 1.0)})
    sensor = felt.measured[:, axis]
    errors = [
        Curve("without the model", (felt.bare[:, axis] - sensor)[None], ORANGE, 1.0),
        Curve("with the model", (felt.modelled[:, axis] - sensor)[None], BLUE, 1.0),
    ]
    fine = [
        Curve("with the model", (felt.modelled_late - felt.true_late)[:, axis][None], BLUE, 2.4),
        Curve("momentum observer", (felt.observed - felt.true_late)[:, axis][None], GREEN, 1.0),
    ]
    figure = picture(f"Fig. {number}: force of the hand on the device along {name}", (10, 7.5))
    rows = figure.subplots(3, 1, sharex=True)
    lines(rows[0], felt.t, upper, 0, "force, N")
    lines(rows[1], felt.t, errors, 0, "error, N")
    lines(rows[2], felt.t, fine, 0, "error at the observer's\nbandwidth, N")
    rows[2].set_xlabel("time, s")
    figure.savefig(path, dpi=120)


def _along(felt: Felt, axis: int, styles: Mapping[str, tuple[str, float]]) -> list[Curve]:
    titles = {"measured": "force sensor", "bare": "without the model", "modelled": "with the model"}
    return [Curve(titles[key], getattr(felt, key)[:, axis][None], *style) for key, style in styles.items()]


def _parts(fit: Fit, seconds: float) -> tuple[Array, dict[str, Array]]:
    """Times, and the parts of the command by name, measured and friction among them, each (motors, rows)."""
    made, scale = (
        decompose_torque(fit.estimate, beginning(fit.unseen, seconds)),
        per_command(fit.estimate.model)[:, None],
    )
    parts = {part: scale * made[part] for part in made.parts}
    return made.t, parts | {"friction": scale * made.friction, "measured": scale * made.measured}


def _labels(model: DynamicModel) -> list[str]:
    return [f"{label},\nN m of command" for label in model.device.row_labels]
