"""The dynamic model of a device as expressions: inverse dynamics, mass matrix, momentum, friction, end effector."""
