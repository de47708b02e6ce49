"""How a motion becomes rows of y = W beta + rho, and their R factors.

May use device, log, dynamics and motion; contains no estimate.
"""

from haptid.observation.batch import observe_all
from haptid.observation.cache import RFactorCache
from haptid.observation.known_payload import Payload, log_without_payload, payload_torque, without_payload
from haptid.observation.observation import MotorRows, Observation, concatenated, observe
from haptid.observation.plan import Block
from haptid.observation.static import observe_poses
from haptid.observation.stream import RowStream

__all__ = [
    "Block",
    "MotorRows",
    "Observation",
    "Payload",
    "RFactorCache",
    "RowStream",
    "concatenated",
    "log_without_payload",
    "observe",
    "observe_all",
    "observe_poses",
    "payload_torque",
    "without_payload",
]
