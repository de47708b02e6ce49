"""Estimators: one per file, all through `estimate(observation, method)`."""

from haptid.estimators.cone import pseudo_inertia
from haptid.estimators.consistent import Consistent, Cost, Held
from haptid.estimators.estimate import Estimate, Parameter, Reduced, Restricted, estimate
from haptid.estimators.method import Method
from haptid.estimators.ols import OLS
from haptid.estimators.possible import Possible, possible, project
from haptid.estimators.reduced import Without
from haptid.estimators.wls import WLS

__all__ = [
    "OLS",
    "WLS",
    "Consistent",
    "Cost",
    "Estimate",
    "Held",
    "Method",
    "Parameter",
    "Possible",
    "Reduced",
    "Restricted",
    "Without",
    "estimate",
    "possible",
    "project",
    "pseudo_inertia",
]
