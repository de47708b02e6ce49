"""Estimators: one per file, all through `estimate(observation, method)`."""

from haptid.estimators.bootstrap import Bootstrap
from haptid.estimators.bounded import Bounded, Within
from haptid.estimators.clustered import Clustered
from haptid.estimators.cone import pseudo_inertia
from haptid.estimators.consistent import Consistent, Cost, Held
from haptid.estimators.corrected import Corrected
from haptid.estimators.didim import DIDIM
from haptid.estimators.ekf import EKF
from haptid.estimators.equal import Equal
from haptid.estimators.estimate import Estimate, Parameter, Restricted, estimate
from haptid.estimators.fit import Fit
from haptid.estimators.fixed_b import FixedB
from haptid.estimators.gls import GLS
from haptid.estimators.heteroscedastic import Heteroscedastic
from haptid.estimators.irls import IRLS
from haptid.estimators.iv import IV
from haptid.estimators.jackknife import BlockJackknife
from haptid.estimators.knowledge import Knowledge
from haptid.estimators.method import ByRows, Fitting, Knowing, Method, Reduced
from haptid.estimators.ols import OLS
from haptid.estimators.open_loop import OutputError
from haptid.estimators.output_error import CLIE, CLOE
from haptid.estimators.possible import Possible, possible, project
from haptid.estimators.profile import Profile
from haptid.estimators.reduced import Without
from haptid.estimators.ridge import Ridge
from haptid.estimators.robust import Huber, Loss, StudentT, Tukey
from haptid.estimators.sandwich import Sandwich
from haptid.estimators.spread import Intervals, Spread
from haptid.estimators.sur import SUR
from haptid.estimators.textbook import Textbook
from haptid.estimators.tls import TLS
from haptid.estimators.ukf import UKF
from haptid.estimators.wls import WLS

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
