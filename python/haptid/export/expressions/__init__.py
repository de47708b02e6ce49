"""Symbolic expressions: graph with common subexpressions, simplification, and straight-line code in several languages."""
