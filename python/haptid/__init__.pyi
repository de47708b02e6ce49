"""The public names, and the module of each: `__init__.py` reads them here, and imports a module at first use.

All other names are public in their room: `haptid.estimation.Bounds`, `haptid.inference.drift`.
"""

from haptid import advice as advice
from haptid import device as device
from haptid import dynamics as dynamics
from haptid import end_effector as end_effector
from haptid import errors
from haptid import estimation as estimation
from haptid import executors as executors
from haptid import experiment as experiment
from haptid import export as export
from haptid import inference as inference
from haptid import live as live
from haptid import log as log
from haptid import motion as motion
from haptid import observation as observation
from haptid import registry as registry
from haptid import report as report
from haptid import results as results
from haptid import robot_files as robot_files
from haptid import simulation as simulation
from haptid import study as study
from haptid import treatment_choice as treatment_choice
from haptid import uncertainty as uncertainty
from haptid import validation as validation
from haptid._core import __version__
from haptid.device import Device, read_device, shipped_devices
from haptid.dynamics.inverse import inverse_dynamics
from haptid.dynamics.model import DynamicModel
from haptid.end_effector.characterisation import characterise
from haptid.end_effector.force import estimate_force
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
    Classical,
    ClusterRobust,
    ErrorsInVariables,
    Estimate,
    FixedB,
    OutputErrorMethod,
    PhysicallyConsistent,
    Profile,
    Ridge,
    Sandwich,
    estimate,
)
from haptid.experiment.bench import simulate
from haptid.experiment.excitation import design_excitation
from haptid.export import export_model
from haptid.inference.comparison import Comparison, compare
from haptid.inference.diagnosis import Diagnosis, diagnose
from haptid.inference.elimination import eliminate
from haptid.inference.payloads import identify_payloads
from haptid.inference.static_poses import identify_poses
from haptid.log import Channels, Log, Signal, open_log, read_log
from haptid.motion.motion import Motion, treat
from haptid.motion.treatment import Treatment
from haptid.observation.batch import observe_all
from haptid.observation.observation import Observation, observe
from haptid.report import make_report
from haptid.results.result import Result
from haptid.study import Study, read_study
from haptid.study.identify import Identification, identify
from haptid.treatment_choice.propose import propose
from haptid.validation.prediction import predict
from haptid.validation.validation import Validation, fit_errors, validate

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
    "Channels",
    "Classical",
    "ClusterRobust",
    "Comparison",
    "Device",
    "Diagnosis",
    "DynamicModel",
    "ErrorsInVariables",
    "Estimate",
    "FixedB",
    "Identification",
    "Log",
    "Motion",
    "Observation",
    "OutputErrorMethod",
    "PhysicallyConsistent",
    "Profile",
    "Result",
    "Ridge",
    "Sandwich",
    "Signal",
    "Study",
    "Treatment",
    "Validation",
    "__version__",
    "characterise",
    "compare",
    "design_excitation",
    "diagnose",
    "eliminate",
    "errors",
    "estimate",
    "estimate_force",
    "export_model",
    "fit_errors",
    "identify",
    "identify_payloads",
    "identify_poses",
    "inverse_dynamics",
    "make_report",
    "observe",
    "observe_all",
    "open_log",
    "predict",
    "propose",
    "read_device",
    "read_log",
    "read_study",
    "shipped_devices",
    "simulate",
    "treat",
    "validate",
]
