"""haptid: dynamic models of haptic devices and robots from their own motion logs.

The corridor, one value after the other:

    device = haptid.read_device("stylus.toml")
    log = haptid.read_log("sweep.csv")
    motion = haptid.treat(log, haptid.propose(device, log).treatment)
    observation = haptid.observe(device, motion)
    estimate = haptid.estimate(observation, haptid.WLS())
    validation = haptid.validate(estimate, haptid.observe(device, unseen))
"""

from haptid import errors
from haptid._core import __version__
from haptid.base import BaseParameters, base_parameters
from haptid.comparison import Comparison, compare
from haptid.delay import Delay, find_delay
from haptid.device import Device, device_schema, read_device, shipped_devices
from haptid.dynamics import inverse_dynamics
from haptid.estimators import OLS, WLS, Estimate, Method, Parameter, estimate
from haptid.identification import Identification, Run, identify
from haptid.log import Channels, Log, Signal, read_log
from haptid.observation import Block, MotorRows, Observation, observe
from haptid.prediction import Prediction, predict
from haptid.proposal import Proposal, propose
from haptid.result import result, write_result
from haptid.shapes import Bell, Sharp
from haptid.study import Study, read_study, study_schema
from haptid.targets import Targets, side_by_side, target_map, targets
from haptid.treatment import Motion, Treatment, treat
from haptid.validation import MotorError, Validation, direct, validate

__all__ = [
    "OLS",
    "WLS",
    "BaseParameters",
    "Bell",
    "Block",
    "Channels",
    "Comparison",
    "Delay",
    "Device",
    "Estimate",
    "Identification",
    "Log",
    "Method",
    "Motion",
    "MotorError",
    "MotorRows",
    "Observation",
    "Parameter",
    "Prediction",
    "Proposal",
    "Run",
    "Sharp",
    "Signal",
    "Study",
    "Targets",
    "Treatment",
    "Validation",
    "__version__",
    "base_parameters",
    "compare",
    "device_schema",
    "direct",
    "errors",
    "estimate",
    "find_delay",
    "identify",
    "inverse_dynamics",
    "observe",
    "predict",
    "propose",
    "read_device",
    "read_log",
    "read_study",
    "result",
    "shipped_devices",
    "side_by_side",
    "study_schema",
    "target_map",
    "targets",
    "treat",
    "validate",
    "write_result",
]
