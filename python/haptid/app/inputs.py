"""`digest_of`: one hash over a study, its device and its logs, by which a check is known to be of exactly these."""

from __future__ import annotations

import hashlib
from pathlib import Path

from haptid.device.toml.reader import read_tables
from haptid.study import read_study


def digest_of(study: Path) -> str:
    """SHA-256 over the study's text, the device it names and the size and time of every log file.

    Logs are not hashed as a whole: a folder of an hour's recordings would be read at every look at the page.

    Raises:
        StudyFileError: the study cannot be read.
        DeviceFileError: its device cannot be read.
    """
    found, made = read_study(study), hashlib.sha256(study.read_bytes())
    made.update(read_tables(found.device)[0].model_dump_json(by_alias=True).encode())
    for entry in found.logs:
        path = study.parent / entry.path
        files = sorted(path.rglob("*")) if path.is_dir() else [path]
        for file in files:
            about = file.stat() if file.exists() else None
            name = entry.path if file == path else f"{entry.path}/{file.relative_to(path).as_posix()}"
            made.update(f"{name}:{about and (about.st_size, about.st_mtime_ns)}".encode())
    return made.hexdigest()
