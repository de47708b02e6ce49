"""What can be wrong where a model is simulated."""

from __future__ import annotations

from haptid.errors._both import ConvergenceError, SettingError, SimulationError


class NoControllerError(SettingError):
    """A method that simulates the closed loop, without the controller that closed it."""

    def __init__(self, method: str) -> None:
        super().__init__(
            f"{method} simulates the device under the controller that moved it, and none is given. Write "
            f"{method}(PID(kp=(...), kd=(...), reference=...)) with the gains at the joint side, N m/rad and "
            f"N m s/rad; or estimate with WLS, which needs none."
        )


class ControllerError(SettingError):
    """A setting of a controller that means nothing, or does not fit the device or the log."""

    def __init__(self, name: str, value: object, wanted: str) -> None:
        super().__init__(f"controller: {name} is {value}; write {wanted}.")


class SimulationLostError(SimulationError):
    """A simulated model that runs away."""

    def __init__(self, time: float, row: str, speed: float, limit: float) -> None:
        self.time = time
        super().__init__(
            f"the simulated model runs away: at {time:.3f} s {row} moves at {speed:.3g} rad/s or m/s, beyond the limit "
            f"{limit:g}. Check the controller's gains and reference; or start from parameters that bodies can have, "
            f"such as those of Consistent()."
        )


class MasslessError(SimulationError):
    """Parameters whose mass matrix cannot be inverted."""

    def __init__(self, row: str, ratio: float, limit: float) -> None:
        super().__init__(
            f"these parameters give {row} no inertia: the least eigenvalue of the mass matrix is {ratio:.1e} of the "
            f"largest, below the limit {limit:.1e}, so no torque tells its acceleration. Start from parameters that "
            f"bodies can have, such as those of Consistent()."
        )


class UnsettledError(ConvergenceError):
    """Passes that do not come to rest."""

    def __init__(self, method: str, passes: int, name: str, moved: float, limit: float) -> None:
        super().__init__(
            f"{method} has not come to rest after {passes} passes: the last moved {name} by {moved:.2g} of its "
            f"deviations (limit {limit:g}). Allow more passes with `most`, or a larger `tolerance`; or begin nearer "
            f"with another `start`."
        )


class RowsByBlockError(SettingError):
    """Single rows asked of a method that has only blocks of them."""

    def __init__(self, method: str) -> None:
        super().__init__(
            f"{method} keeps what each block of time tells of the parameters, and no single rows, which this kind of "
            f"interval needs. Take BlockJackknife() or Classical()."
        )
