"""Advice: changes of a study, each tested on the same data before it is proposed.

May import study and inference; it is used by commands and reports.
"""
