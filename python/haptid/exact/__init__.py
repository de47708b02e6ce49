"""Base parameters and regroupings with the geometric lengths as symbols, by arithmetic modulo primes."""

from haptid.exact.laurent import Coefficient, Laurent
from haptid.exact.loops import loop_regroupings
from haptid.exact.regrouping import Regroupings, regroupings
from haptid.exact.symbols import Symbol

__all__ = ["Coefficient", "Laurent", "Regroupings", "Symbol", "loop_regroupings", "regroupings"]
