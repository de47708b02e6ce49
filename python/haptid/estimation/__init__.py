"""Estimation: methods that turn rows of an observation into parameters, and covariance estimators with intervals.

Everything goes through `estimate(observation, method, intervals)`. This room may use the models, motions, observations
and simulations; it does not use validation or inference.
"""

from haptid.estimation.estimate import Estimate, Restricted, estimate
from haptid.estimation.feasibility.cone import pseudo_inertia
from haptid.estimation.feasibility.feasible import FeasibleParameters, feasible_parameters, project_to_feasible
from haptid.estimation.intervals.between_logs import BetweenLogs
from haptid.estimation.intervals.bootstrap import Bootstrap
from haptid.estimation.intervals.cluster_robust import BlockJackknife, ClusterRobust, FixedB
from haptid.estimation.intervals.covariance import Intervals, Spread
from haptid.estimation.intervals.model_based import Classical, Sandwich
from haptid.estimation.intervals.profile import Profile
from haptid.estimation.least_squares import Knowledge
from haptid.estimation.method import ByRows, Fit, Fitting, Knowing, Method, Reduced
from haptid.estimation.methods.constrained import (
    BoundedSolution,
    Bounds,
    Constrained,
    Cost,
    EqualityConstraints,
    FixedAtZero,
    PhysicallyConsistent,
)
from haptid.estimation.methods.errors_in_variables import TLS, ErrorsInVariables
from haptid.estimation.methods.gls import GLS, SUR, TorqueNoise
from haptid.estimation.methods.instrumental import IV
from haptid.estimation.methods.kalman import EKF, UKF
from haptid.estimation.methods.motor_side import MotorSide
from haptid.estimation.methods.open_loop import OutputErrorMethod
from haptid.estimation.methods.regularised import Entropic, Ridge
from haptid.estimation.methods.robust import IRLS, Huber, Loss, StudentT, Tukey
from haptid.estimation.methods.simulation_based import CLIE, CLOE, DIDIM
from haptid.estimation.methods.wls import OLS, WLS, Heteroscedastic
from haptid.estimation.parameter import Parameter
from haptid.estimation.recursive import RecursiveIdentification

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
    "BetweenLogs",
    "BlockJackknife",
    "Bootstrap",
    "BoundedSolution",
    "Bounds",
    "ByRows",
    "Classical",
    "ClusterRobust",
    "Constrained",
    "Cost",
    "Entropic",
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
    "MotorSide",
    "OutputErrorMethod",
    "Parameter",
    "PhysicallyConsistent",
    "Profile",
    "RecursiveIdentification",
    "Reduced",
    "Restricted",
    "Ridge",
    "Sandwich",
    "Spread",
    "StudentT",
    "TorqueNoise",
    "Tukey",
    "estimate",
    "feasible_parameters",
    "project_to_feasible",
    "pseudo_inertia",
]
