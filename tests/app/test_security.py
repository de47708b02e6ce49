"""Attacks on the workbench's server: each is refused, and the disk stays as it was."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("starlette")

from haptid.app.guard import HEADERS
from workbenches import ended, started


def contents(folder: Path) -> dict[str, str]:
    """Every file of a folder but the index, with its hash."""
    files = (path for path in folder.rglob("*") if path.is_file() and ".haptid" not in path.parts)
    return {str(path): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


@pytest.fixture
def unchanged(bench):
    """The disk is after the test as it was before."""
    before = contents(bench.folder)
    yield bench
    assert contents(bench.folder) == before


@pytest.mark.parametrize("host", ["evil.example", "127.0.0.1", "127.0.0.1:1", "127.0.0.1.evil.example", "[::1]", ""])
def test_a_foreign_host_is_refused(unchanged, host):
    for path in ("/", "/api/workspace", "/enter?token=x"):
        answer = unchanged.raw("GET", path, host=host, cookie=unchanged.cookie)
        assert answer.status in (400, 421)
        assert b"two-links" not in answer.content


def test_the_token_is_asked_for(unchanged):
    name, _, token = unchanged.cookie.partition("=")
    other = f"{name}x"
    wrong = [
        "",
        f"{name}=",
        f"{name}={token[:-1]}",
        f"{name}={token}x",
        f"{other}={token}",
        f"{name}=%00",
        "=;=",
        "\x7f",
    ]
    for cookie in wrong:
        assert unchanged.raw("GET", "/api/workspace", cookie=cookie).status == 401
    assert unchanged.raw("GET", "/enter?token=wrong").status == 401
    assert unchanged.raw("GET", "/enter").status == 401
    assert unchanged.ask("GET", "/api/workspace")[0] == 200


def test_the_cookie_is_for_this_server_alone(bench):
    said = bench.raw("GET", bench.address.removeprefix(bench.origin)).getheader("set-cookie").lower()
    assert f"haptid-{bench.port}=" in said
    assert "httponly" in said
    assert "samesite=strict" in said


@pytest.mark.parametrize("origin", ["http://evil.example", "null", "http://127.0.0.1:1", "https://127.0.0.1", None])
def test_a_foreign_origin_changes_nothing(unchanged, origin):
    given = {"cookie": unchanged.cookie} | ({} if origin is None else {"origin": origin})
    calls = ["file", "check", "identify", "try-out", "drop?name=a.csv", "device/check", "live/start", "live/stop"]
    calls = [f"/api/{one}" for one in [*calls, "experiment/search", "experiment/rehearse", "registry/remove"]]
    for path in calls:
        answer = unchanged.raw("POST", path, b'{"path": "devices/evil.toml", "text": "", "known": ""}', **given)
        assert answer.status == 403
    for method in ("PUT", "DELETE", "OPTIONS", "PATCH"):
        assert unchanged.raw(method, "/api/file", b"", **given).status == 403


@pytest.mark.parametrize(
    "path", ["/", "/api/workspace", "/static/main.js", "/report/page.css", "/api/nothing", "/nothing"]
)
def test_every_answer_has_the_policy(bench, path):
    for cookie in (bench.cookie, ""):
        answer = bench.raw("GET", path, cookie=cookie)
        assert {name: answer.getheader(name) for name in HEADERS} == HEADERS
    assert "unsafe" not in HEADERS["content-security-policy"]
    assert answer.getheader("access-control-allow-origin") is None


OUTSIDE = [
    "../secret.toml",
    "devices/../../secret.toml",
    "devices/../studies/two-links.toml",
    "/etc/passwd",
    "devices//etc/passwd",
    "devices/./two-links.toml",
    "devices/deeper/two-links.toml",
    "devices\\..\\secret.toml",
    "devices/..\\secret.toml",
    "C:\\secret.toml",
    "devices/C:secret.toml",
    "devices/two-links.toml\0.png",
    ".haptid/open",
    "devices",
    "",
    "devices/outside/secret.toml",
    "devices/link.toml",
    "%2e%2e/secret.toml",
]


@pytest.fixture
def linked(bench):
    """Links out of the folder, and a file outside of it."""
    secret = bench.folder.parent / "secret.toml"
    secret.write_text('token = "secret"\n')
    links = [bench.folder / "devices" / "outside", bench.folder / "devices" / "link.toml"]
    links[0].symlink_to(bench.folder.parent)
    links[1].symlink_to(secret)
    yield bench
    for link in links:
        link.unlink()
    secret.unlink()


@pytest.mark.parametrize("path", OUTSIDE)
def test_no_path_leads_out(linked, path):
    secret = linked.folder.parent / "secret.toml"
    for call, values in (
        ("file", {"path": path, "text": "changed", "known": hashlib.sha256(secret.read_bytes()).hexdigest()}),
        ("device/check", {"path": path, "text": ""}),
        ("study/read", {"path": path, "text": ""}),
        ("check", {"path": path}),
        ("identify", {"path": path, "out": "results/x"}),
        ("identify", {"path": "studies/two-links.toml", "out": path}),
        ("export", {"path": path, "to": ["c"]}),
        ("study/draft", {"device": "emps", "logs": [path]}),
        ("experiment/search", {"device": path or "/", "name": "x", "evaluations": "1", "seconds": "5"}),
        ("experiment/rehearse", {"device": "emps", "path": path}),
        ("registry/remove", {"path": path}),
        ("live/start", {"study": path, "name": "x", "rate": "100"}),
    ):
        status, said = linked.ask("POST", f"/api/{call}", values)
        assert (status, "secret" in str(said).replace("secret.toml", "")) == (400, False), (call, said)
    quoted = "".join(f"%{byte:02x}" for byte in path.encode())
    for call in (
        "file?path=",
        "log?path=",
        "samples?channel=t&path=",
        "result?path=",
        "download?path=",
        "export?to=c&path=",
        "experiment?path=",
    ):
        for sent in (quoted, quoted.replace("%", "%25")):
            status, said = linked.ask("GET", f"/api/{call}{sent}")
            assert status in (400, 404), (call, said)
            assert b'secret"' not in (said if isinstance(said, bytes) else str(said).encode())
    assert secret.read_text() == 'token = "secret"\n'


@pytest.mark.parametrize(
    "path", ["../../../guard.py", "..%2f..%2fguard.py", "%2e%2e/guard.py", "....//guard.py", "..\\guard.py"]
)
def test_no_static_path_leads_out(bench, path):
    for folder in ("static", "report"):
        assert bench.raw("GET", f"/{folder}/{path}", cookie=bench.cookie).status == 404


def test_a_log_that_is_too_large_is_not_kept(tmp_path, plain):
    for name in ("devices", "studies", "logs"):
        (tmp_path / name).mkdir()
    small = started(tmp_path, "--largest-log", "1")
    try:
        before = contents(tmp_path)
        status, said = small.ask("POST", "/api/drop?name=large.csv", b"0" * (2**20 + 1))
        assert status == 413
        assert "more than 1 MiB" in said["error"]
        assert contents(tmp_path) == before
        status, said = small.ask("POST", "/api/drop?name=small.csv", (plain / "logs" / "sweep.csv").read_bytes())
        assert (status, said["path"]) == (200, "logs/small.csv")
        again = small.ask("POST", "/api/drop?name=other.csv", (plain / "logs" / "sweep.csv").read_bytes())[1]
        assert (again["known"], again["path"]) == (True, "logs/small.csv")
        other = small.ask("POST", "/api/drop?name=small.csv", (plain / "logs" / "check.csv").read_bytes())[1]
        assert other["path"] == "logs/small-2.csv"
    finally:
        ended(small)


@pytest.mark.parametrize(
    "name", ["../a.csv", "a.exe", "a.pkl", "con.csv", ".hidden.csv", "a b.csv", "a.csv\0", "", "x" * 200 + ".csv"]
)
def test_a_log_has_a_harmless_name(unchanged, name):
    quoted = "".join(f"%{byte:02x}" for byte in name.encode())
    assert unchanged.ask("POST", f"/api/drop?name={quoted}", b"t,q\n0,1\n")[0] == 400


def test_large_and_broken_bodies_are_refused(unchanged):
    for body in (b"{" + b" " * 5 * 2**20, b"[" * 100_000, b"[1]", b"{", b"\xff\xfe", b"{}"):
        status, said = unchanged.ask("POST", "/api/file", body)
        assert status == 400, said
        assert said["error"]
    status, said = unchanged.ask("POST", "/api/file", {"path": "devices/run.py", "text": "x", "known": ""})
    assert status == 400


def test_a_text_is_saved_against_the_hash_that_was_read(bench):
    first = bench.ask("GET", "/api/file?path=devices/two-links.toml")[1]
    mine = {"path": "devices/two-links.toml", "text": first["text"] + "# mine\n", "known": first["sha256"]}
    assert bench.ask("POST", "/api/file", mine)[0] == 200
    status, said = bench.ask("POST", "/api/file", mine | {"text": "# theirs\n"})
    assert status == 409
    assert said["current"].endswith("# mine\n")
    assert (bench.folder / "devices" / "two-links.toml").read_text().endswith("# mine\n")
    assert bench.ask("POST", "/api/file", mine | {"known": ""})[0] == 409


def test_one_workbench_writes_into_a_folder(bench):
    second = subprocess.run(
        [sys.executable, "-m", "haptid", "app", str(bench.folder), "--no-browser"], capture_output=True, text=True
    )
    assert second.returncode == 2
    assert bench.address in second.stderr.replace("\n", "")
    if os.name == "posix":
        assert (bench.folder / ".haptid" / "open").stat().st_mode & 0o077 == 0


def test_a_port_that_is_taken_is_said(bench, tmp_path):
    command = [sys.executable, "-m", "haptid", "app", str(tmp_path), "--no-browser", "--port", str(bench.port)]
    second = subprocess.run(command, capture_output=True, text=True)
    assert second.returncode == 2
    assert f"port {bench.port}" in second.stderr
