"""Results of the logs of a fleet on disk, so that an interrupted run goes on with those that are missing."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar

from haptid._core import __version__
from haptid._internal.kept_parts import KeptParts
from haptid._internal.late import dataclass
from haptid.dynamics.model import DynamicModel
from haptid.log import Log
from haptid.log.file_format import sha256_of
from haptid.motion.treatment import Treatment
from haptid.study.study import Study


@dataclass(frozen=True)
class FleetResults(KeptParts):
    """One JSON file for each log, by what its result depends on."""

    noun: ClassVar[str] = "logs"
    suffix: ClassVar[str] = ".json"

    def read(self, study: str, log: Path) -> dict[str, Any] | None:
        """The result of a log; None where there is none, or where it or the log cannot be read.

        Args:
            study: `fleet_fingerprint` of the study.
            log: its file.
        """
        try:
            made = json.loads((self.folder / _name(study, sha256_of(log))).read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return None
        return made if isinstance(made, dict) else None

    def write(self, study: str, log: str, result: dict[str, Any]) -> None:
        """Keep the result of a log, by the SHA-256 of its file."""
        self.put(self.folder / _name(study, log), json.dumps(result).encode())


def _name(study: str, log: str) -> str:
    return hashlib.sha256(f"{study} {log}".encode()).hexdigest()[:24] + FleetResults.suffix


def fleet_fingerprint(study: Study, model: DynamicModel, own: Sequence[Log], treatment: Treatment) -> str:
    """Hash of all that the results of a fleet's logs depend on besides the logs themselves.

    Args:
        study: whose method and channels they have.
        model: of its device.
        own: its logs, from which the treatment and what that leaves uncertain are.
        treatment: of all logs.
    """
    content = (
        __version__,
        model.device.tables.model_dump_json(by_alias=True),
        model.base.names,
        repr((study.method, study.intervals, study.controller, dict(study.treatment))),
        [(log.sha256, repr(replace(entry, path=""))) for log, entry in zip(own, study.logs, strict=True)],
        repr(treatment),
    )
    return hashlib.sha256(json.dumps(content).encode()).hexdigest()
