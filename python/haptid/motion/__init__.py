"""How a log becomes a motion: treatment, filters, time shift, and joint-side channels.

May use device and log.
"""

from haptid.motion.filters import Causal, HighPass, KaiserSmoother, WindowedSinc
from haptid.motion.holds import HoldDetection, Poses, find_poses, join_poses, read_poses
from haptid.motion.motion import Motion, treat
from haptid.motion.treatment import Treatment

__all__ = [
    "Causal",
    "HighPass",
    "HoldDetection",
    "KaiserSmoother",
    "Motion",
    "Poses",
    "Treatment",
    "WindowedSinc",
    "find_poses",
    "join_poses",
    "read_poses",
    "treat",
]
