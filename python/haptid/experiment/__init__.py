"""Experiments: the virtual bench, exciting motions and friction tests."""
