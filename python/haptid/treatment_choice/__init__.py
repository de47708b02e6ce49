"""Proposed treatment of a log, and an estimate of the delay of its torque.

May use log, motion, observation and estimation.
"""
