"""Download of public recordings, from a server of the test; and what the shipped list says of the real files."""

import hashlib
import http.server
import threading
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from typer.testing import CliRunner

import haptid
from haptid.cli import app
from haptid.demos.public_recordings import (
    Joined,
    PublicRecording,
    RecordedFile,
    fetch_recording,
    public_recording,
    public_recordings,
)
from haptid.errors import LogFileError, UnknownNameError
from json_outputs import valid

TABLE = b"a,b\n" + b"".join(b"%d,%d\n" % (k, 2 * k) for k in range(50))


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    """Address of a server of a folder with two tables; /cut sends less than it announces."""
    folder = tmp_path_factory.mktemp("served")
    for name in ("one.csv", "two.csv"):
        (folder / name).write_bytes(TABLE)

    class Handler(http.server.SimpleHTTPRequestHandler):
        def __init__(self, *args, **keys):
            super().__init__(*args, directory=str(folder), **keys)

        def do_GET(self):
            if self.path != "/cut.csv":
                return super().do_GET()
            self.send_response(200)
            self.send_header("Content-Length", str(len(TABLE)))
            self.end_headers()
            self.wfile.write(TABLE[:40])
            return None

        def log_message(self, *_):
            pass

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler) as made:
        thread = threading.Thread(target=made.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{made.server_port}/"
        made.shutdown()
        thread.join()


def recording(address: str, *names: str, joined: Joined | None = None, **other) -> PublicRecording:
    digest = hashlib.sha256(TABLE).hexdigest()
    files = [RecordedFile(**{"from": name, "bytes": len(TABLE), "sha256": digest, **other}) for name in names]
    about = dict.fromkeys(("what", "licence", "cite", "page"), "-")
    return PublicRecording(name="tables", address=address, files=files, joined=joined, **about)


def test_files_are_written_as_they_are(server, tmp_path):
    (tmp_path / "note.txt").write_text("kept")
    shares = []
    made = fetch_recording(recording(server, "one.csv", "two.csv"), tmp_path, lambda _, share: shares.append(share))
    assert made == (tmp_path / "one.csv", tmp_path / "two.csv")
    assert all(path.read_bytes() == TABLE for path in made)
    assert (tmp_path / "note.txt").read_text() == "kept"
    assert shares == sorted(shares)
    assert shares[-1] == 1.0


def test_tables_are_joined(server, tmp_path):
    joined = Joined(to="log.parquet", rate_hz=100.0, columns=["q", "tau"])
    (made,) = fetch_recording(recording(server, "one.csv", "two.csv", joined=joined), tmp_path)
    table = pq.read_table(made)
    assert table.column_names == ["t", "q1", "q2", "tau1", "tau2"]
    assert np.array_equal(table["tau2"], 2 * np.arange(50))
    assert np.allclose(table["t"], np.arange(50) / 100)
    assert not list(tmp_path.glob("*.csv"))


@pytest.mark.parametrize(
    ("names", "other", "told"),
    [
        (["one.csv", "missing.csv"], {}, "missing.csv cannot be downloaded: File not found"),
        (["one.csv", "cut.csv"], {}, "cut.csv is not the published file: it has 40 bytes"),
        (["one.csv"], {"bytes": 100}, "one.csv is not the published file: it has more than 100 bytes"),
        (["one.csv"], {"sha256": "0" * 64}, "another SHA-256"),
    ],
)
def test_what_is_not_the_published_file_is_not_written(server, tmp_path, names, other, told):
    with pytest.raises(LogFileError, match=told):
        fetch_recording(recording(server, *names, **other), tmp_path / "out")
    assert not list(tmp_path.iterdir())


def test_without_a_network(tmp_path):
    with pytest.raises(LogFileError, match="cannot be downloaded") as raised:
        fetch_recording(recording("http://127.0.0.1:9/", "one.csv"), tmp_path / "out")
    assert "Check the connection" in raised.value.advice
    assert not list(tmp_path.iterdir())


def test_the_command_lists_fetches_and_refuses(server, tmp_path, monkeypatch):
    made = recording(server, "one.csv")
    monkeypatch.setattr("haptid.demos.public_recordings.public_recordings", lambda: (made,))
    listed = CliRunner().invoke(app, ["fetch"])
    assert listed.exit_code == 0
    assert "licence" in listed.output
    got = CliRunner().invoke(app, ["fetch", "tables", "--out", str(tmp_path / "out"), "--json"])
    assert valid("fetch", got.output)["files"] == [str(tmp_path / "out" / "one.csv")]
    assert CliRunner().invoke(app, ["fetch", "table"]).exit_code == 2


def test_each_recording_is_of_a_shipped_device():
    for known in public_recordings():
        assert known.name in haptid.shipped_devices()
        assert known.address.startswith("https://")
    with pytest.raises(UnknownNameError, match="there is no recording 'emp'"):
        public_recording("emp")


def test_the_published_hashes_are_those_of_the_files(shared_data: Path):
    for known in public_recordings():
        if known.joined is None:
            for file in known.files:
                content = (shared_data / known.name / file.name).read_bytes()
                assert (len(content), hashlib.sha256(content).hexdigest()) == (file.bytes, file.sha256)
