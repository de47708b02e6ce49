"""Dynamic models: base parameters, regressor, inverse and forward dynamics, kinematics and workspace of a device.

It knows devices and their numbers (a pose, a motion, parameter values), but no log and no estimate.
"""
