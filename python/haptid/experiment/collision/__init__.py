"""Distances between the shapes of a device and its surroundings, and the least distance along a motion."""

from haptid.experiment.collision.clearance import Clearance, clearance_along
from haptid.experiment.collision.distances import CollisionModel

__all__ = ["Clearance", "CollisionModel", "clearance_along"]
