"""Which parameters of two or more independent estimates differ, by Welch's test with Holm's correction."""

from haptid.inference.comparison.differences import (
    Comparison,
    Series,
    confidence_text,
    family_wise,
    significant,
)
from haptid.inference.comparison.welch import compare

__all__ = ["Comparison", "Series", "compare", "confidence_text", "family_wise", "significant"]
