"""Pictures of a device in motion: stick figures from its poses, or MuJoCo's off-screen rendering."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from haptid._internal.arrays import Array, expect
from haptid._internal.extras import needing
from haptid.device import poses
from haptid.dynamics.model import DynamicModel
from haptid.errors import ExperimentError
from haptid.experiment.bench.limits import frame_origin
from haptid.experiment.bench.mjcf import closed, mjcf, size
from haptid.experiment.bench.simulation import load_mujoco

# Colour-blind safe palette (Okabe and Ito 2008).
BAR, HANDLE_MARK, _TRAIL = "#0072B2", "#D55E00", "0.6"
# Height of one picture, inches, and pixels.
INCHES, _PIXELS = 3.0, 360


def draw_strip(
    model: DynamicModel, qa: Array, times: Sequence[float] | Array, path: str | Path, pictures: int = 5
) -> None:
    """Draw stick figures side by side with the path of the handle, seen along the axis of least extent.

    Args:
        qa: positions of the active joints along the motion, (samples, active), rad or m.
        times: of the samples, (samples,), s.
        path: of the picture, PNG, PDF or SVG.
        pictures: number of instants, evenly spaced over the motion.

    Raises:
        ExperimentError: there is no sample or no picture to draw, or it cannot be written.
    """
    expect("qa", qa.shape, (len(times), len(model.device.active)))
    if len(times) == 0 or pictures < 1:
        raise ExperimentError(f"cannot draw {path}: no instant was given.", where=path, advice="Give at least one.")
    drawn = np.unique(np.linspace(0, len(times) - 1, pictures).round().astype(int))
    lines, handle = stick_figure(model, qa)
    across = _view(lines)
    with needing("drawing pictures"):
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    figure = Figure(figsize=(INCHES * len(drawn), INCHES), layout="constrained")
    FigureCanvasAgg(figure)
    panels = np.atleast_1d(figure.subplots(1, len(drawn), sharex=True, sharey=True))
    for k, panel in zip(drawn, panels, strict=True):
        for ends in lines[k]:
            panel.plot(*ends[:, across].T, color=BAR, linewidth=2.5, solid_capstyle="round", marker="o", markersize=3)
        if handle is not None:
            panel.plot(*handle[: k + 1, across].T, color=_TRAIL, linewidth=1)
            panel.plot(*handle[k, across], color=HANDLE_MARK, marker="o", markersize=6)
        panel.set_title(f"{times[k]:.2f} s")
        panel.set_aspect("equal", adjustable="box")
    panels[0].set_xlabel(f"{'xyz'[across[0]]}, m")
    panels[0].set_ylabel(f"{'xyz'[across[1]]}, m")
    try:
        figure.savefig(path, dpi=120, bbox_inches="tight")
    except (OSError, ValueError) as error:
        advice = "Choose a writable folder, and the suffix .png, .pdf or .svg."
        raise ExperimentError(f"cannot draw {path}: {error}.", where=path, advice=advice) from error


def stick_figure(model: DynamicModel, qa: Array) -> tuple[Array, Array | None]:
    """Bars of the mechanism, (samples, bars, 2, 3), and the handle, (samples, 3) or None, in the base frame, m.

    Bars connect each link's origin to its children's origins, to its pins and to the handle.
    """
    q = model.device.closure.positions(qa.T).T
    at = poses(model.device, q)
    frames = [frame for cut in model.device.closure.cuts for frame in (cut.frame_a, cut.frame_b)]
    frames += [] if model.device.handle is None else [model.device.handle]
    ends = [(joint.parent, at[:, j, :3, 3]) for j, joint in enumerate(model.device.joints)]
    ends += [(frame.link, frame_origin(at, frame)) for frame in frames]
    ground = np.zeros((len(q), 3))
    bars = [np.stack([ground if link < 0 else at[:, link, :3, 3], end], axis=1) for link, end in ends]
    handle = None if model.device.handle is None else frame_origin(at, model.device.handle)
    return np.stack(bars, axis=1), handle


def _view(lines: Array) -> list[int]:
    """The two axes of largest extent, the horizontal one first."""
    extent = np.ptp(lines.reshape(-1, 3), axis=0)
    least = int(np.argmin(extent))
    return sorted({0, 1, 2} - {least}, reverse=least == 0)


def render_strip(model: DynamicModel, chi: Array, qa: Array, path: Path) -> None:
    """The same by MuJoCo's off-screen renderer; needs OpenGL (or EGL: MUJOCO_GL=egl).

    Args:
        chi: its free standard parameters, (p,), SI.
        qa: positions of the active joints, (pictures, active), rad or m.
        path: of the PNG picture.

    Raises:
        ExperimentError: off-screen rendering does not work on this machine.
    """
    from matplotlib.image import imsave

    expect("qa", qa.shape, (None, len(model.device.active)))
    mujoco = load_mujoco()
    mj_model = mujoco.MjModel.from_xml_string(mjcf(model, chi))
    data, camera = mujoco.MjData(mj_model), mujoco.MjvCamera()
    camera.distance, camera.elevation = 2.5 * size(model), -20
    try:
        with mujoco.Renderer(mj_model, _PIXELS, _PIXELS) as renderer:
            shots = []
            for position in qa:
                data.qpos[:] = closed(model, position)
                mujoco.mj_forward(mj_model, data)
                renderer.update_scene(data, camera)
                shots.append(renderer.render())
    except Exception as error:  # the graphics stack has no common exception class
        what = str(error) or type(error).__name__
        advice = "Draw stick figures with `draw_strip`."
        raise ExperimentError(f"cannot draw {path}: {what}.", where=path, advice=advice) from error
    imsave(path, np.concatenate(shots, axis=1))
