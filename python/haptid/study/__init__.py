"""Studies: identification pipelines from device and logs to a validated estimate, described in TOML.

May import everything that a pipeline consists of, up to validation; it writes no files.
"""

from haptid.study.read import read_study
from haptid.study.schema import Role, study_schema
from haptid.study.study import LogEntry, Study

__all__ = ["LogEntry", "Role", "Study", "read_study", "study_schema"]
