"""The model at the end-effector: torque decomposition, hand-force estimation, compensation and characterisation.

It uses estimates and treated motions, and knows no study, report or experiment.
"""
