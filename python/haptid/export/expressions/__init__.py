"""Symbolic expressions: a graph with common subexpressions shared, simplification, and straight-line code."""
