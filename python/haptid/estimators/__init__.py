"""Estimators: one per file, all through `estimate(observation, method)`."""

from haptid.estimators.bounded import Bounded, Within
from haptid.estimators.cone import pseudo_inertia
from haptid.estimators.consistent import Consistent, Cost, Held
from haptid.estimators.estimate import Estimate, Parameter, Restricted, estimate
from haptid.estimators.fit import Fit
from haptid.estimators.jackknife import BlockJackknife
from haptid.estimators.knowledge import Knowledge
from haptid.estimators.method import ByRows, Fitting, Knowing, Method, Reduced
from haptid.estimators.ols import OLS
from haptid.estimators.possible import Possible, possible, project
from haptid.estimators.reduced import Without
from haptid.estimators.spread import Intervals, Spread
from haptid.estimators.wls import WLS

__all__ = [
    "OLS",
    "WLS",
    "BlockJackknife",
    "Bounded",
    "ByRows",
    "Consistent",
    "Cost",
    "Estimate",
    "Fit",
    "Fitting",
    "Held",
    "Intervals",
    "Knowing",
    "Knowledge",
    "Method",
    "Parameter",
    "Possible",
    "Reduced",
    "Restricted",
    "Spread",
    "Within",
    "Without",
    "estimate",
    "possible",
    "project",
    "pseudo_inertia",
]
