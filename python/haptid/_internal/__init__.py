"""Plumbing that every package uses: arrays, checked TOML, executors, atomic result folders."""
