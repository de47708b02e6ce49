"""Write what a build contains as CycloneDX: `python tools/write_sbom.py OUT.json`; or check it: `--check`. Offline.

Components are the installed packages that haptid requires, with their requirements, and the crates of Cargo.lock. The
check fails on a licence that is not permissive, on a crate in two versions, and on a package without a pinned version
or without a hash in hashes.txt.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
from importlib.metadata import Distribution, PackageNotFoundError, distribution
from pathlib import Path
from typing import Any

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[1]
# Licences under which haptid can be given away; in an expression, one of the alternatives must be made of these.
PERMISSIVE = (
    *("0BSD", "Apache-2.0", "Apache-2.0 WITH LLVM-exception", "BSD-2-Clause", "BSD-3-Clause", "BSL-1.0", "CC0-1.0"),
    *(
        "HPND",
        "ISC",
        "MIT",
        "MIT-CMU",
        "MIT-0",
        "PSF-2.0",
        "Python-2.0",
        "Unicode-3.0",
        "Unlicense",
        "Zlib",
        "bzip2-1.0.6",
    ),
)
# Licences of packages whose metadata have a text or a classifier in place of an expression.
SAID = {
    "BSD": "BSD-3-Clause",
    "ISC License (ISCL)": "ISC",
    "BSD License": "BSD-3-Clause",
    "MIT License": "MIT",
    "Apache License 2.0": "Apache-2.0",
    "Apache Software License": "Apache-2.0",
    "Apache 2.0": "Apache-2.0",
    "Python Software Foundation License": "PSF-2.0",
}
# Crates that stand in the lock in two versions, each with the reason.
TWICE: dict[str, str] = {}


def packages() -> dict[str, Distribution]:
    """Installed packages that haptid requires, with what they require, by name."""
    found: dict[str, Distribution] = {}
    todo = ["haptid"]
    while todo:
        name = canonicalize_name(todo.pop())
        if name in found:
            continue
        found[name] = distribution(name)
        for text in found[name].requires or ():
            needed = Requirement(text)
            if needed.marker is None or needed.marker.evaluate({"extra": ""}):
                todo.append(needed.name)
    del found["haptid"]
    return dict(sorted(found.items()))


def licence_of(package: Distribution) -> str:
    """The licence of a package as an SPDX expression, or as its metadata say it."""
    data = package.metadata
    if expression := data.get("License-Expression"):
        return str(expression)
    classifiers = [c.rsplit(" :: ", 1)[1] for c in data.get_all("Classifier") or () if c.startswith("License :: ")]
    said = [*classifiers, *(data.get("License") or "").splitlines()[:1]]
    return next((SAID.get(one, one) for one in said if one and one != "OSI Approved"), "unknown")


def crates() -> list[dict[str, Any]]:
    """Crates of the lock that are not of this workspace: name, version, licence, checksum."""
    command = ["cargo", "metadata", "--format-version", "1", "--locked", "--offline"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    sums = dict(re.findall(r'name = "([^"]+)"\nversion = "[^"]+"\nsource = [^\n]+\nchecksum = "(\w+)"', _lock()))
    found = (package for package in json.loads(done.stdout)["packages"] if package["source"])
    return [
        {"name": p["name"], "version": p["version"], "licence": p["license"] or "unknown", "sum": sums.get(p["name"])}
        for p in sorted(found, key=lambda p: (p["name"], p["version"]))
    ]


def _lock() -> str:
    return (ROOT / "Cargo.lock").read_text(encoding="utf-8")


def permissive(expression: str) -> bool:
    """Whether one alternative of a licence expression is made of permissive licences alone."""
    plain = re.sub(r"[()]", " ", expression).replace("/", " OR ")
    return any(
        all(part.strip() in PERMISSIVE for part in alternative.split(" AND ")) for alternative in plain.split(" OR ")
    )


def component(kind: str, name: str, version: str, licence: str, checksum: str | None = None) -> dict[str, Any]:
    """One component of the file."""
    made: dict[str, Any] = {
        "type": "library",
        "name": name,
        "version": version,
        "purl": f"pkg:{kind}/{name}@{version}",
        "licenses": [{"license": {"name": licence}}],
    }
    return made | ({"hashes": [{"alg": "SHA-256", "content": checksum}]} if checksum else {})


def document() -> dict[str, Any]:
    """The whole file; the same environment gives the same bytes."""
    python = [component("pypi", name, one.version, licence_of(one)) for name, one in packages().items()]
    rust = [component("cargo", c["name"], c["version"], c["licence"], c["sum"]) for c in crates()]
    about = component("pypi", "haptid", distribution("haptid").version, "Apache-2.0") | {"type": "application"}
    return {
        "bomFormat": "CycloneDX",
        "specVersion": "1.5",
        "version": 1,
        "metadata": {"component": about},
        "components": [*python, *rust],
    }


def faults() -> list[str]:
    """What is wrong with the components, a sentence each."""
    pins = {canonicalize_name(line.split("==")[0]) for line in (ROOT / "constraints.txt").read_text().split()}
    found = [f"{name} has no pinned version in constraints.txt" for name in packages() if name not in pins]
    found += _unhashed()
    licences = [(name, licence_of(one)) for name, one in packages().items()]
    known = crates()
    licences += [(f"crate {c['name']}", c["licence"]) for c in known]
    found += [
        f"{name} has the licence {said!r}, not a permissive one" for name, said in licences if not permissive(said)
    ]
    names = [c["name"] for c in known]
    found += [
        f"crate {name} is there twice" for name in sorted(set(names)) if names.count(name) > 1 and name not in TWICE
    ]
    return found


def _unhashed() -> list[str]:
    """Packages without a hash, or hashed at another version than the pinned one."""
    pinned = dict(line.split("==") for line in (ROOT / "constraints.txt").read_text().split())
    text = (ROOT / "hashes.txt").read_text().replace("\\\n", " ")
    hashed = {
        line.split("==")[0]: line.split("==")[1].split()[0] for line in text.splitlines() if "--hash=sha256:" in line
    }
    wrong = [f"{name} has no hash in hashes.txt: make hashes" for name in packages() if name not in hashed]
    others = {name: version for name, version in hashed.items() if pinned.get(name, version) != version}
    return wrong + [
        f"{name} {version} in hashes.txt is not the pinned one: make hashes" for name, version in others.items()
    ]


def main() -> int:
    """Write or check."""
    try:
        if sys.argv[1:] == ["--check"]:
            wrong = faults()
            sys.stdout.write("".join(f"{one}\n" for one in wrong))
            return int(bool(wrong))
        path = Path(sys.argv[1])
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(document(), indent=1) + "\n", encoding="utf-8")
    except (PackageNotFoundError, subprocess.CalledProcessError) as error:
        sys.stderr.write(f"{error}: build first, with `make test` or `cargo fetch`\n")
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
