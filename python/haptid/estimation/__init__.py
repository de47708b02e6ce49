"""Estimation: methods that turn rows of an observation into parameters, and covariance estimators with intervals.

Everything goes through `estimate(observation, method, intervals)`. This room may use the models, motions, observations
and simulations; it does not use validation or inference.
"""

from haptid.estimation.estimate import Estimate, Parameter, Restricted, estimate
from haptid.estimation.feasibility.cone import pseudo_inertia
from haptid.estimation.feasibility.feasible import Possible, possible, project
from haptid.estimation.intervals.bootstrap import Bootstrap
from haptid.estimation.intervals.cluster_robust import BlockJackknife, Clustered
from haptid.estimation.intervals.covariance import Intervals, Spread
from haptid.estimation.intervals.fixed_b import FixedB
from haptid.estimation.intervals.model_based import Sandwich, Textbook
from haptid.estimation.intervals.profile import Profile
from haptid.estimation.least_squares import Knowledge
from haptid.estimation.method import ByRows, Fit, Fitting, Knowing, Method, Reduced
from haptid.estimation.methods.constrained import Bounded, Consistent, Cost, Equal, Held, Within, Without
from haptid.estimation.methods.errors_in_variables import TLS, Corrected
from haptid.estimation.methods.gls import GLS, SUR
from haptid.estimation.methods.instrumental import IV
from haptid.estimation.methods.kalman import EKF, UKF
from haptid.estimation.methods.open_loop import OutputError
from haptid.estimation.methods.regularised import Entropic, Ridge
from haptid.estimation.methods.robust import IRLS, Huber, Loss, StudentT, Tukey
from haptid.estimation.methods.simulation_based import CLIE, CLOE, DIDIM
from haptid.estimation.methods.wls import OLS, WLS, Heteroscedastic

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
    "Bounded",
    "ByRows",
    "Clustered",
    "Consistent",
    "Corrected",
    "Cost",
    "Entropic",
    "Equal",
    "Estimate",
    "Fit",
    "Fitting",
    "FixedB",
    "Held",
    "Heteroscedastic",
    "Huber",
    "Intervals",
    "Knowing",
    "Knowledge",
    "Loss",
    "Method",
    "OutputError",
    "Parameter",
    "Possible",
    "Profile",
    "Reduced",
    "Restricted",
    "Ridge",
    "Sandwich",
    "Spread",
    "StudentT",
    "Textbook",
    "Tukey",
    "Within",
    "Without",
    "estimate",
    "possible",
    "project",
    "pseudo_inertia",
]
