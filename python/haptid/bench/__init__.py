"""The virtual bench: a device in MuJoCo with its controller, encoders and amplifiers, and the logs that it gives."""

from haptid.bench.bodies import Body, bodies
from haptid.bench.mjcf import Payload, Physics, mjcf

__all__ = ["Body", "Payload", "Physics", "bodies", "mjcf"]
