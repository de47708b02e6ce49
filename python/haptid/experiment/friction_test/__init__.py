"""Friction identification at constant velocities: the friction curve of each joint, and the choice of its model."""
