"""Readers of log file formats."""
