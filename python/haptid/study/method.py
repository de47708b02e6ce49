"""The method of estimation and the kind of intervals that a study names."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

from haptid.errors import PulledProfileError, SettingError, StudyControllerError, StudyFileError
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
    OutputErrorMethod,
    PhysicallyConsistent,
    Profile,
    Ridge,
    Sandwich,
    StudentT,
    Tukey,
)
from haptid.estimation.methods.entropic import Entropic
from haptid.estimation.methods.simulating import ClosedLoop
from haptid.simulation import PID
from haptid.study.schema import EstimateTable

# What each method is made of, and the keys of the study that are its settings.
METHODS: Mapping[str, tuple[Callable[..., Method], tuple[str, ...]]] = {
    "OLS": (OLS, ()),
    "WLS": (WLS, ("passes",)),
    "SUR": (SUR, ("passes",)),
    "GLS": (GLS, ("passes",)),
    "IRLS": (IRLS, ("loss",)),
    "heteroscedastic": (Heteroscedastic, ("passes",)),
    "TLS": (TLS, ()),
    "encoder noise": (ErrorsInVariables, ("resolution",)),
    "ridge": (Ridge, ("share", "strength", "passes")),
    "entropic": (Entropic, ("strength",)),
    "IV": (IV, ()),
    "DIDIM": (DIDIM, ()),
    "CLIE": (CLIE, ()),
    "CLOE": (CLOE, ()),
    "output error": (OutputErrorMethod, ()),
    "EKF": (EKF, ()),
    "UKF": (UKF, ()),
}
INTERVALS: Mapping[str, Callable[[], Intervals]] = {
    "clustered": ClusterRobust,
    "jackknife": BlockJackknife,
    "textbook": Classical,
    "sandwich": Sandwich,
    "fixed-b": FixedB,
    "bootstrap": Bootstrap,
    "profile": Profile,
}
LOSSES: Mapping[str, Callable[[], Loss]] = {"Tukey": Tukey, "Huber": Huber, "Student t": StudentT}
SETTINGS = tuple(dict.fromkeys(key for _, keys in METHODS.values() for key in keys))
HOLDING = ("possible", "limits", "relations")


def method_of(study: Path, table: EstimateTable, controller: PID | None) -> Method:
    make, keys = METHODS[table.method]
    given = {key: value for key in SETTINGS if (value := getattr(table, key)) is not None}
    for key in given:
        if key not in keys:
            raise StudyFileError(study, f"estimate.{key}", f"the method {table.method!r} has no such setting")
    if "loss" in given:
        given["loss"] = LOSSES[given["loss"]]()
    if isinstance(make, type) and issubclass(make, ClosedLoop):
        if controller is None:
            raise StudyControllerError(study, table.method)
        given["controller"] = controller
    if isinstance(given.get("resolution"), list):
        given["resolution"] = tuple(given["resolution"])
    if make is Entropic and INTERVALS[table.intervals] is Profile:
        raise StudyFileError(study, "estimate.intervals", str(PulledProfileError()).rstrip("."))
    held = [key for key in HOLDING if getattr(table, key)]
    if len(held) > 1:
        raise StudyFileError(study, f"estimate.{held[1]}", f"beside {held[0]}: give one of {', '.join(HOLDING)}")
    try:
        return _held(table, make(**given))
    except SettingError as error:
        raise StudyFileError(study, "estimate", str(error).rstrip(".")) from error


def _held(table: EstimateTable, weighting: Method) -> Method:
    """The method with what holds its estimate."""
    if table.possible:
        return PhysicallyConsistent(weighting)
    if table.limits:
        return Bounds({name: (limit.low, limit.high) for name, limit in table.limits.items()}, weighting)
    return EqualityConstraints(table.relations, weighting) if table.relations else weighting
