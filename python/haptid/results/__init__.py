"""The result folder: `result.json` as one model that an identification writes and that is read without its logs.

May import study and all before it; reports, exports and commands read results from here.
"""

from haptid.results.result import Result, result_schema
from haptid.results.schema import ResultLog, ResultUse

__all__ = ["Result", "ResultLog", "ResultUse", "result_schema"]
