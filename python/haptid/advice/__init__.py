"""Advice: changes of a study, each tested on the same data before it is proposed.

May import study and inference; it is used by commands and reports.
"""

from haptid.advice.action import Action, Advice
from haptid.advice.advise import advise
from haptid.advice.apply import Applied, apply_advice
from haptid.advice.edits import Edit
from haptid.advice.verdict import verdict_with

__all__ = ["Action", "Advice", "Applied", "Edit", "advise", "apply_advice", "verdict_with"]
