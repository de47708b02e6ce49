"""Signed values that a recorder wrote as the positive whole numbers of a drive's registers.

Servos keep the sign in one bit beside the magnitude (Feetech: bit 10 of loads, bit 15 of speeds and positions), or
count down from 2^16 or 2^32 (two's complement, as Dynamixel's currents). Read as they are, a reversal is a jump.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass

# Widths of words, and bits of the sign, that drives use.
_WORDS, _SIGN_BITS = (16, 32), (10, 11, 15)
# A register is recognised if values change sign so often, and the sum of all steps falls below this share.
_CHANGES, _STEPS = 3, 0.5


@dataclass(frozen=True)
class Register:
    """How a sign is written.

    Attributes:
        sign_bit: the bit of the sign, above the magnitude; None where there is none.
        word_bits: width of a word in two's complement; None where it is none.
    """

    sign_bit: int | None = None
    word_bits: int | None = None

    def __bool__(self) -> bool:
        return self.sign_bit is not None or self.word_bits is not None

    def __str__(self) -> str:
        key, value = ("sign_bit", self.sign_bit) if self.sign_bit is not None else ("word_bits", self.word_bits)
        return f"{key} = {value}"

    def signed(self, column: Array) -> Array:
        """The values with their sign, (n,); the column itself where no register is given."""
        if self.sign_bit is not None:
            half = 2.0**self.sign_bit
            return np.where(column >= half, half - column, column)
        if self.word_bits is not None:
            return np.where(column >= 2.0 ** (self.word_bits - 1), column - 2.0**self.word_bits, column)
        return column


def register_of(column: NDArray[np.generic]) -> Register:
    """The register whose signs make the steps of whole numbers short, or none where they are short as they are."""
    values = np.asarray(column, dtype=np.float64)
    values = values[np.isfinite(values)]
    if values.size < 2 or values.min() < 0 or values.max() < 2.0 ** _SIGN_BITS[0] or (values != np.rint(values)).any():
        return Register()
    as_it_is = float(np.abs(np.diff(values)).sum())
    best, least = Register(), _STEPS * as_it_is
    for register in (*(Register(sign_bit=b) for b in _SIGN_BITS), *(Register(word_bits=b) for b in _WORDS)):
        top = 2.0 ** (register.word_bits or (register.sign_bit or 0) + 1)
        signed = register.signed(values)
        changes = int(np.count_nonzero(np.diff(np.signbit(signed))))
        steps = float(np.abs(np.diff(signed)).sum())
        if values.max() < top and changes >= _CHANGES and steps < least:
            best, least = register, steps
    return best
