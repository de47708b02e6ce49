"""Plumbing that every package uses: arrays, checked TOML, files published whole."""
