"""Estimators: one per file, all through `estimate(observation, method)`."""

from haptid.estimation.estimate import Estimate, Parameter, Restricted, estimate
from haptid.estimation.feasibility.cone import pseudo_inertia
from haptid.estimation.feasibility.feasible import FeasibleParameters, possible, project_to_feasible
from haptid.estimation.fit import Fit
from haptid.estimation.intervals.bootstrap import Bootstrap
from haptid.estimation.intervals.classical import Classical
from haptid.estimation.intervals.cluster_robust import ClusterRobust
from haptid.estimation.intervals.fixed_b import FixedB
from haptid.estimation.intervals.jackknife import BlockJackknife
from haptid.estimation.intervals.profile import Profile
from haptid.estimation.intervals.sandwich import Sandwich
from haptid.estimation.intervals.spread import Intervals, Spread
from haptid.estimation.knowledge import Knowledge
from haptid.estimation.method import ByRows, Fitting, Knowing, Method, Reduced
from haptid.estimation.methods.bounded import BoundedSolution, Bounds
from haptid.estimation.methods.consistent import Constrained, Cost, PhysicallyConsistent
from haptid.estimation.methods.didim import DIDIM
from haptid.estimation.methods.ekf import EKF
from haptid.estimation.methods.equal import EqualityConstraints
from haptid.estimation.methods.errors_in_variables import ErrorsInVariables
from haptid.estimation.methods.gls import GLS
from haptid.estimation.methods.heteroscedastic import Heteroscedastic
from haptid.estimation.methods.irls import IRLS
from haptid.estimation.methods.iv import IV
from haptid.estimation.methods.ols import OLS
from haptid.estimation.methods.open_loop import OutputErrorMethod
from haptid.estimation.methods.output_error import CLIE, CLOE
from haptid.estimation.methods.ridge import Ridge
from haptid.estimation.methods.robust import Huber, Loss, StudentT, Tukey
from haptid.estimation.methods.sur import SUR
from haptid.estimation.methods.tls import TLS
from haptid.estimation.methods.ukf import UKF
from haptid.estimation.methods.wls import WLS
from haptid.estimation.methods.zeroed import FixedAtZero

__all__ = [
    "CLIE",
    "CLOE",
    "DIDIM",
    "EKF",
    "GLS",
    "IRLS",
    "IV",
    "OLS",
    "SUR",
    "TLS",
    "UKF",
    "WLS",
    "BlockJackknife",
    "Bootstrap",
    "BoundedSolution",
    "Bounds",
    "ByRows",
    "Classical",
    "ClusterRobust",
    "Constrained",
    "Cost",
    "EqualityConstraints",
    "ErrorsInVariables",
    "Estimate",
    "FeasibleParameters",
    "Fit",
    "Fitting",
    "FixedAtZero",
    "FixedB",
    "Heteroscedastic",
    "Huber",
    "Intervals",
    "Knowing",
    "Knowledge",
    "Loss",
    "Method",
    "OutputErrorMethod",
    "Parameter",
    "PhysicallyConsistent",
    "Profile",
    "Reduced",
    "Restricted",
    "Ridge",
    "Sandwich",
    "Spread",
    "StudentT",
    "Tukey",
    "estimate",
    "possible",
    "project_to_feasible",
    "pseudo_inertia",
]
