"""The result folder: `result.json` as one model that an identification writes and that is read without its logs."""

from haptid.results.result import Result, result_schema
from haptid.results.schema import ResultLog, ResultUse

__all__ = ["Result", "ResultLog", "ResultUse", "result_schema"]
