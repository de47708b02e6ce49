"""Base parameters and regroupings with symbolic lengths, computed by exact arithmetic modulo primes."""

from haptid.dynamics.symbolic.arithmetic import Coefficient, Laurent
from haptid.dynamics.symbolic.regrouping import Regroupings, loop_regroupings, regroupings
from haptid.dynamics.symbolic.symbols import Symbol

__all__ = ["Coefficient", "Laurent", "Regroupings", "Symbol", "loop_regroupings", "regroupings"]
