"""Friction tests at constant velocities."""
