"""Covariance estimators and confidence intervals."""
