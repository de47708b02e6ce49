"""The dynamic model evaluated: base parameters, regressor, inverse and forward dynamics, kinematics."""
