"""The public names, and the module of each: `__init__.py` reads them here, and imports a module at first use."""

from haptid import errors
from haptid._core import __version__
from haptid.added import Addition, addition
from haptid.base import BaseParameters, base_parameters
from haptid.causal import Causal, HighPass
from haptid.characterisation import Characterisation, FeltMass, GivenModel, characterise, felt_mass
from haptid.comparison import Comparison, compare
from haptid.compensation import Compensation, stable_share
from haptid.definite import Definiteness, definiteness
from haptid.delay import Delay, find_delay
from haptid.device import Device, device_schema, read_device, shipped_devices
from haptid.diagnosis import Diagnosis, Finding, Verdict, diagnose
from haptid.dissection import Dissection, dissect
from haptid.drive_gains import DriveGains, drive_gains
from haptid.dynamics import bias_torque, gravity_torque, inverse_dynamics, mass_matrix
from haptid.estimators import (
    GLS,
    IRLS,
    OLS,
    SUR,
    TLS,
    WLS,
    BlockJackknife,
    Bootstrap,
    Bounded,
    Consistent,
    Corrected,
    Cost,
    Equal,
    Estimate,
    Fit,
    FixedB,
    Held,
    Heteroscedastic,
    Huber,
    Intervals,
    Method,
    Parameter,
    Possible,
    Profile,
    Ridge,
    Sandwich,
    Spread,
    StudentT,
    Textbook,
    Tukey,
    Within,
    Without,
    estimate,
    possible,
    project,
    pseudo_inertia,
)
from haptid.estimators.entropic import Entropic
from haptid.estimators.essential import AtMost, Essential, Reduction, TimesSmallest, essential, essential_by_motor
from haptid.exact import Regroupings, loop_regroupings, regroupings
from haptid.export import CCode, CExport, export_c
from haptid.force import HandleForce, estimate_force
from haptid.friction import ByModel, ByPairs, Constant, FrictionCurve, friction_curve
from haptid.friction_choice import FrictionChoice, choose_friction
from haptid.identification import Identification, Run, identify
from haptid.kinematics import HandleMotion, handle_motion, link_poses
from haptid.loads import load_shift, without_load
from haptid.log import Channels, Log, Signal, open_log, read_log
from haptid.observation import Block, MotorRows, Observation, observe
from haptid.observer import MomentumObserver, Watched, observe_force
from haptid.prediction import Prediction, predict
from haptid.projection import Projection, variable_projection
from haptid.proposal import Proposal, propose
from haptid.reach import Box, Workspace, workspace
from haptid.recorded import Recorded, RecordedLog, read_result
from haptid.reduction import Kept, observe_all
from haptid.result_file import result, write_result
from haptid.shapes import Bell, Sharp
from haptid.study import Study, read_study, study_schema
from haptid.target_parameters import Targets, side_by_side, target_map, targets
from haptid.treatment import Motion, Treatment, treat
from haptid.validation import MotorError, Validation, direct, validate
from haptid.workers import Cluster, Here, Processes, Workers

__all__ = [
    "GLS",
    "IRLS",
    "OLS",
    "SUR",
    "TLS",
    "WLS",
    "Addition",
    "AtMost",
    "BaseParameters",
    "Bell",
    "Block",
    "BlockJackknife",
    "Bootstrap",
    "Bounded",
    "Box",
    "ByModel",
    "ByPairs",
    "CCode",
    "CExport",
    "Causal",
    "Channels",
    "Characterisation",
    "Cluster",
    "Comparison",
    "Compensation",
    "Consistent",
    "Constant",
    "Corrected",
    "Cost",
    "Definiteness",
    "Delay",
    "Device",
    "Diagnosis",
    "Dissection",
    "DriveGains",
    "Entropic",
    "Equal",
    "Essential",
    "Estimate",
    "FeltMass",
    "Finding",
    "Fit",
    "FixedB",
    "FrictionChoice",
    "FrictionCurve",
    "GivenModel",
    "HandleForce",
    "HandleMotion",
    "Held",
    "Here",
    "Heteroscedastic",
    "HighPass",
    "Huber",
    "Identification",
    "Intervals",
    "Kept",
    "Log",
    "Method",
    "MomentumObserver",
    "Motion",
    "MotorError",
    "MotorRows",
    "Observation",
    "Parameter",
    "Possible",
    "Prediction",
    "Processes",
    "Profile",
    "Projection",
    "Proposal",
    "Recorded",
    "RecordedLog",
    "Reduction",
    "Regroupings",
    "Ridge",
    "Run",
    "Sandwich",
    "Sharp",
    "Signal",
    "Spread",
    "StudentT",
    "Study",
    "Targets",
    "Textbook",
    "TimesSmallest",
    "Treatment",
    "Tukey",
    "Validation",
    "Verdict",
    "Watched",
    "Within",
    "Without",
    "Workers",
    "Workspace",
    "__version__",
    "addition",
    "base_parameters",
    "bias_torque",
    "characterise",
    "choose_friction",
    "compare",
    "definiteness",
    "device_schema",
    "diagnose",
    "direct",
    "dissect",
    "drive_gains",
    "errors",
    "essential",
    "essential_by_motor",
    "estimate",
    "estimate_force",
    "export_c",
    "felt_mass",
    "find_delay",
    "friction_curve",
    "gravity_torque",
    "handle_motion",
    "identify",
    "inverse_dynamics",
    "link_poses",
    "load_shift",
    "loop_regroupings",
    "mass_matrix",
    "observe",
    "observe_all",
    "observe_force",
    "open_log",
    "possible",
    "predict",
    "project",
    "propose",
    "pseudo_inertia",
    "read_device",
    "read_log",
    "read_result",
    "read_study",
    "regroupings",
    "result",
    "shipped_devices",
    "side_by_side",
    "stable_share",
    "study_schema",
    "target_map",
    "targets",
    "treat",
    "validate",
    "variable_projection",
    "without_load",
    "workspace",
    "write_result",
]
