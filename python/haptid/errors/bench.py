"""What can be wrong with an experiment on the virtual bench, or while it runs."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from haptid.errors._both import (
    ExperimentError,
    ExportError,
    IncompleteDeviceError,
    MissingDependencyError,
    PhysicalConsistencyError,
    SimulationError,
    TrajectoryError,
    UnknownNameError,
    suggestion,
)


class MujocoMissingError(MissingDependencyError):
    """The simulator is not installed."""

    def __init__(self) -> None:
        super().__init__('the virtual bench needs MuJoCo, which is not installed: pip install "haptid[bench]".')


class ParameterNameError(UnknownNameError):
    """A true parameter that the device does not have."""

    def __init__(self, name: str, known: Iterable[str]) -> None:
        super().__init__(f"the device has no free parameter {name!r}. {suggestion(name, known)}")


class LinkNameError(UnknownNameError):
    """A mass on a link that the device does not have."""

    def __init__(self, table: str, name: str, known: Iterable[str]) -> None:
        still = " The base does not move: leave out what is fixed to it." if name == "base" else ""
        super().__init__(f"[[{table}]]: the device has no link {name!r}.{still} {suggestion(name, known)}")


class FigureCountError(ExperimentError):
    """More or fewer figures than joints or motors."""

    def __init__(self, what: str, got: int, names: list[str]) -> None:
        super().__init__(f"{what} has {got} figures; write one for all, or {len(names)}, for {', '.join(names)}.")


class UnphysicalBodyError(PhysicalConsistencyError):
    """A link that no rigid body can be."""

    def __init__(self, link: str, found: str, instead: str) -> None:
        super().__init__(f"link {link}: {found}, which no rigid body has, so it cannot be simulated. {instead}")


class WeightlessLinkError(PhysicalConsistencyError):
    """A joint that moves nothing: its acceleration is not determined."""

    def __init__(self, link: str) -> None:
        super().__init__(
            f"link {link} has neither mass nor rotor inertia, and nothing beyond it has: its mass is 0 and must be "
            f"above 0. Give it a body: [[bodies]] with link, mass, com and inertia in the experiment."
        )


class UnsimulatedLoopError(ExportError):
    """A loop that is cut at a sliding joint and is not linear."""

    def __init__(self, device: str) -> None:
        super().__init__(
            f"{device}: a loop that is not linear is cut at a prismatic joint, which has no pin in the simulator "
            f"(limit: revolute cuts). Cut the loop at a revolute joint, and list the sliding one in [[joints]]."
        )


class UnsimulatedTermError(ExportError):
    """A term that has no counterpart in MuJoCo."""

    def __init__(self, name: str, kind: str, value: float) -> None:
        super().__init__(
            f"term {name} = {value:g} is of kind {kind!r}, which the bench cannot simulate; it knows rotor, viscous, "
            f"coulomb (of no width), spring and offset. Set {name} to 0 in the experiment's [parameters]."
        )


class TrajectoryLimitError(TrajectoryError):
    """A planned motion beyond what a joint, or its motor, can do."""

    def __init__(self, what: str, name: str, time: float, found: float, limit: float, unit: str, instead: str) -> None:
        self.name, self.time = name, time
        super().__init__(
            f"the planned motion takes {what} of {name} to {found:.4g} {unit} at {time:.3f} s; its limit is "
            f"{limit:.4g} {unit}. {instead}"
        )


class FlatLoopError(TrajectoryError):
    """A planned motion through, or close to, a pose in which a loop is flat and its joints are not determined."""

    def __init__(self, time: float, found: float, limit: float, names: Iterable[str]) -> None:
        self.time = time
        super().__init__(
            f"the planned motion brings the loop of {', '.join(names)} close to flat at {time:.3f} s: {found:.3f} on a "
            f"scale from 0, flat, to 1; the limit is {limit:g}. Move the centre, or lower the amplitudes."
        )


class TrajectoryTooShortError(TrajectoryError):
    """No time left between start and stop."""

    def __init__(self, seconds: float, needed: float) -> None:
        super().__init__(
            f"the motion lasts {seconds:g} s, and a smooth start and stop alone take {needed:g} s. Make it longer, or "
            f"shorten `ramp`."
        )


class TimingError(ExperimentError):
    """A period or a delay that is no whole number of the simulator's steps."""

    def __init__(self, what: str, seconds: float, step: float) -> None:
        super().__init__(
            f"{what} is {seconds:g} s, which is no whole number of the simulator's steps of {step:g} s. Change one of "
            f"them: 1 kHz and 1e-4 s go together."
        )


class NoHandleError(IncompleteDeviceError):
    """A payload, a hand or a force sensor on a device without a handle."""

    def __init__(self, what: str, device: str) -> None:
        super().__init__(f"the experiment has a {what}, and {device} has no handle. Add [handle] to the device file.")


class UnstableError(SimulationError):
    """A simulation that ran away."""

    def __init__(self, time: float, joint: str, speed: float, limit: float) -> None:
        self.time, self.joint = time, joint
        super().__init__(
            f"the simulation became unstable at {time:.3f} s: joint {joint} moves at {speed:.3g} rad/s or m/s, and the "
            f"limit is {limit:g}. Lower the controller's gains (kd first), or the simulator's step."
        )


class LimitHitError(SimulationError):
    """A joint at its stop."""

    def __init__(self, time: float, joint: str, position: float, limits: tuple[float, float]) -> None:
        self.time, self.joint = time, joint
        super().__init__(
            f"joint {joint} was at {position:.4g} at {time:.3f} s, outside its limits {limits[0]:.4g} .. "
            f"{limits[1]:.4g}. Keep the planned motion further from them, or raise the controller's gains."
        )


class TrackingLostError(SimulationError):
    """A device that no longer follows its controller."""

    def __init__(self, time: float, joint: str, error: float, limit: float) -> None:
        self.time, self.joint = time, joint
        super().__init__(
            f"joint {joint} was {error:.3g} rad or m away from where it should be at {time:.3f} s; the limit is "
            f"{limit:g}. Raise kp or the amplifier's saturation, ask for a slower motion, or raise `tracking_limit`."
        )


class LoopBrokenError(SimulationError):
    """A loop that the simulator did not keep closed."""

    def __init__(self, time: float, gap: float, limit: float) -> None:
        self.time = time
        super().__init__(
            f"a loop was open by {gap:.2g} m at {time:.3f} s; the limit is {limit:g} m. Lower the simulator's step, or "
            f"keep the motion further from poses in which the loop is flat."
        )


class PictureError(ExperimentError):
    """A picture that cannot be drawn."""

    def __init__(self, path: object, what: str) -> None:
        super().__init__(f"cannot draw {path}: {what}.")


class NoCodeError(ExportError):
    """A folder without the code of one model."""

    def __init__(self, folder: object, found: Sequence[str]) -> None:
        what = f"has the code of several models: {', '.join(found)}" if found else "has no code of a model"
        super().__init__(f"{folder} {what}. Give a folder that `export_c`, or `haptid export --to c`, wrote.")


class NoCompilerError(MissingDependencyError):
    """No compiler for the code of a model."""

    def __init__(self, command: str) -> None:
        super().__init__(f"there is no C compiler {command!r}. Install one, or name it in the environment variable CC.")


class CompileError(ExportError):
    """Code of a model that the compiler refuses."""

    def __init__(self, source: object, said: str) -> None:
        super().__init__(f"{source} does not compile. Export the model again; the compiler said:\n{said.strip()}")
