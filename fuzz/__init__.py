"""Fuzzing of everything that reads a file, and of the core's argument checks; see docs/limits.md."""
