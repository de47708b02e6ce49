"""Base parameters and regroupings with the geometric lengths as symbols, by arithmetic modulo primes."""

from haptid.dynamics.symbolic.laurent import Coefficient, Laurent
from haptid.dynamics.symbolic.loops import loop_regroupings
from haptid.dynamics.symbolic.regrouping import Regroupings, regroupings
from haptid.dynamics.symbolic.symbols import Symbol

__all__ = ["Coefficient", "Laurent", "Regroupings", "Symbol", "loop_regroupings", "regroupings"]
