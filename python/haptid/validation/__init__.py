"""Prediction errors of an estimate on rows that were not fitted, and cross-validation.

May use observation and estimation.
"""
