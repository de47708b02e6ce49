"""Estimation method, constraints and kind of confidence intervals of a study."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

from haptid._internal.extensions import extension, extension_names
from haptid.errors import SettingError, suggestion
from haptid.estimation import (
    CLIE,
    CLOE,
    DIDIM,
    EKF,
    GLS,
    IRLS,
    IV,
    OLS,
    SUR,
    TLS,
    UKF,
    WLS,
    BlockJackknife,
    Bootstrap,
    Bounds,
    Classical,
    ClusterRobust,
    EqualityConstraints,
    ErrorsInVariables,
    FixedB,
    Heteroscedastic,
    Huber,
    Intervals,
    Loss,
    Method,
    MotorSide,
    OutputErrorMethod,
    PhysicallyConsistent,
    Profile,
    Ridge,
    Sandwich,
    StudentT,
    TorqueNoise,
    Tukey,
)
from haptid.estimation.methods.regularised import Entropic
from haptid.estimation.methods.simulation_based import ClosedLoop
from haptid.inference.elimination import FixedWeights
from haptid.simulation import PID
from haptid.study.schema import EstimateTable, fault

# Constructor of each method, and the study keys that are its settings.
METHODS: Mapping[str, tuple[Callable[..., Method], tuple[str, ...]]] = {
    "ols": (OLS, ()),
    "wls": (WLS, ("passes",)),
    "sur": (SUR, ("passes",)),
    "torque-noise": (TorqueNoise, ("passes",)),
    "gls": (GLS, ("passes",)),
    "irls": (IRLS, ("loss",)),
    "heteroscedastic": (Heteroscedastic, ("passes",)),
    "total-least-squares": (TLS, ()),
    "errors-in-variables": (ErrorsInVariables, ("resolution",)),
    "ridge": (Ridge, ("share", "strength", "passes")),
    "entropic": (Entropic, ("strength",)),
    "iv": (IV, ()),
    "didim": (DIDIM, ()),
    "clie": (CLIE, ()),
    "cloe": (CLOE, ()),
    "output-error": (OutputErrorMethod, ()),
    "motor-side": (MotorSide, ()),
    "ekf": (EKF, ()),
    "ukf": (UKF, ()),
}
INTERVALS: Mapping[str, Callable[[], Intervals]] = {
    "cluster-robust": ClusterRobust,
    "block-jackknife": BlockJackknife,
    "classical": Classical,
    "sandwich": Sandwich,
    "fixed-b": FixedB,
    "block-bootstrap": Bootstrap,
    "profile-likelihood": Profile,
    "cr2": ClusterRobust,
    "cr3": BlockJackknife,
}
_LOSSES: Mapping[str, Callable[[], Loss]] = {"tukey": Tukey, "huber": Huber, "student-t": StudentT}
_SETTINGS = tuple(dict.fromkeys(key for _, keys in METHODS.values() for key in keys))
CONSTRAINTS = ("constraints", "bounds", "equality_constraints")


def method_name(method: Method) -> str:
    """Name of a method in a study, without the constraints around it; of a method of the user's own, its own name."""
    found = next((name for name, (make, _) in METHODS.items() if type(method) is make), None)
    if found is not None:
        return found
    inner: Method | None = method.method if isinstance(method, FixedWeights) else getattr(method, "weighting", None)
    return method.name if inner is None else method_name(inner)


def intervals_name(intervals: Intervals) -> str:
    """Name of a kind of intervals in a study; of one of the user's own, its own name."""
    return next((name for name, make in INTERVALS.items() if type(intervals) is make), intervals.name)


def method_of(study: Path, table: EstimateTable, controller: PID | None) -> Method:
    """The method of a study, with its constraints.

    Raises:
        StudyFileError: a setting that the method does not have, or that has no meaning; the method requires a
            controller, and there is none.
    """
    method = table.method or "wls"
    make, keys = METHODS[method] if method in METHODS else (_of_extension(study, method), ())
    settings = {key: value for key in _SETTINGS if (value := getattr(table, key)) is not None}
    for key in settings:
        if key not in keys:
            raise fault(study, f"estimate.{key}", f"the method {method!r} has no such setting", settings[key])
    if table.settings is not None:
        if method in METHODS:
            raise fault(
                study,
                "estimate.settings",
                "it holds the arguments of a method of an extension",
                method,
                "Write the settings of this method as keys of [estimate].",
            )
        settings = table.settings
    if "loss" in settings:
        settings["loss"] = _LOSSES[settings["loss"]]()
    if isinstance(make, type) and issubclass(make, ClosedLoop):
        if controller is None:
            raise fault(
                study,
                "estimate.method",
                f"{method} simulates the device under the controller that moved it, and the study has none",
                method,
                "Add a [controller] table with its gains kp and kd; or use a method that needs none, such as wls.",
            )
        settings["controller"] = controller
    if isinstance(settings.get("resolution"), list):
        settings["resolution"] = tuple(settings["resolution"])
    if make is Entropic and INTERVALS[table.intervals] is Profile:
        raise fault(
            study,
            "estimate.intervals",
            "a profile likelihood requires an estimate that maximises the likelihood, which a regularised one does not",
            table.intervals,
            "Use another method than entropic, or other intervals, such as cluster-robust.",
        )
    constraints = [key for key in CONSTRAINTS if getattr(table, key)]
    if len(constraints) > 1:
        raise fault(
            study, f"estimate.{constraints[1]}", f"together with {constraints[0]}: give one of {', '.join(CONSTRAINTS)}"
        )
    try:
        return _constrained(table, make(**settings))
    except SettingError as error:
        raise fault(study, "estimate", str(error).rstrip(".")) from error
    except TypeError as error:
        if method in METHODS:
            raise
        raise fault(study, "estimate.settings", f"the method {method!r} refuses them: {error}", settings) from error


def _of_extension(study: Path, method: str) -> Callable[..., Method]:
    """The constructor of a method that an installed package declares.

    Raises:
        StudyFileError: there is none.
        MissingDependencyError: it cannot be imported.
    """
    constructor: Callable[..., Method] | None = extension("haptid.methods", method)
    if constructor is None:
        known = (*METHODS, *extension_names("haptid.methods"))
        advice = suggestion(method, known)
        raise fault(study, "estimate.method", f"there is no method {method!r}", method, advice)
    return constructor


def _constrained(table: EstimateTable, weighting: Method) -> Method:
    """The method with its constraints."""
    if table.constraints == "physical":
        return PhysicallyConsistent(weighting)
    if table.bounds:
        return Bounds({name: (bound.low, bound.high) for name, bound in table.bounds.items()}, weighting)
    return EqualityConstraints(table.equality_constraints, weighting) if table.equality_constraints else weighting
