"""Estimators: one per file, all through `estimate(observation, method)`."""

from haptid.estimators.estimate import Estimate, Method, Parameter, estimate
from haptid.estimators.ols import OLS
from haptid.estimators.wls import WLS

__all__ = ["OLS", "WLS", "Estimate", "Method", "Parameter", "estimate"]
