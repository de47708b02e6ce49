"""Kill commands at random moments, and look at what is left: `python -m fuzz.interruptions --kills 500`.

Each command runs to its end, then again and again into the same output, killed (SIGKILL, or SIGINT for every third) at
random moments. What is there must be whole: all files of one run, by their manifest; and after a further run nothing of
the killed ones may be left. Exit status 1 if anything else was found.
"""

from __future__ import annotations

import argparse
import random
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from fuzz.make_seeds import DEVICE, STUDY, columns, write_csv
from haptid._internal.atomic_folder import MANIFEST, verified
from haptid.errors import HaptidError


def study(folder: Path) -> Path:
    """A study of two short logs."""
    (folder / "device.toml").write_text(DEVICE)
    (folder / "study.toml").write_text(STUDY)
    for seed, log in ((1, "log.csv"), (2, "check.csv")):
        write_csv(folder / log, columns(seed))
    return folder / "study.toml"


def command(name: str, folder: Path) -> list[str]:
    """A command line, with its output in `folder`/out, or `folder`/out.html."""
    told = {
        "identify": ["identify", str(folder / "study.toml"), "--out", str(folder / "out"), "--quiet"],
        "export": ["export", str(folder / "result"), "--to", "c", "--to", "json", "--out", str(folder / "out")],
        "report": ["report", str(folder / "result"), "--out", str(folder / "out.html"), "--quiet"],
    }
    return [sys.executable, "-m", "haptid", *told[name]]


def state(folder: Path) -> dict[str, str]:
    """Names and contents of the outputs; only names of pictures, whose bytes may differ."""
    files = [path for path in folder.glob("out*/**/*") if path.is_file() and path.name != MANIFEST]
    files += folder.glob("out.*")
    return {str(path.relative_to(folder)): path.read_text(errors="replace") for path in sorted(set(files))}


def wrong(folder: Path, names: set[str], torn: bool) -> str:
    """What is wrong with the outputs; empty where nothing is."""
    there = state(folder)
    if set(there) != names:
        return f"other files: {sorted(set(there) ^ names)}"
    try:
        for manifest in folder.glob(f"out/**/{MANIFEST}"):
            for path in manifest.parent.iterdir():
                if path.is_file() and path.name != MANIFEST:
                    verified(path, path.read_bytes())
    except HaptidError as error:
        return str(error)
    page = there.get("out.html", "</html>").rstrip()
    if not page.endswith("</html>"):
        return "a page that is cut short"
    left = [path.name for path in folder.glob(".*")]
    return f"leftovers {left}" if left and not torn else ""


def main() -> int:
    """Kill each command in turn."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=30)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    rng, faults, killed = random.Random(given.seed), 0, 0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        study(folder)
        subprocess.run([*command("identify", folder)[:-3], "--out", str(folder / "result"), "--quiet"], check=True)
        for which in ("identify", "export", "report"):
            for path in folder.glob("out*"):
                subprocess.run(["rm", "-r", str(path)], check=True)
            line, start = command(which, folder), time.monotonic()
            subprocess.run(line, check=True, stdout=subprocess.DEVNULL)
            lasted, names = time.monotonic() - start, set(state(folder))
            for k in range(given.kills // 3):
                with subprocess.Popen(line, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as running:
                    time.sleep(lasted * rng.uniform(0.4, 1.05))
                    running.send_signal(signal.SIGINT if k % 3 == 2 else signal.SIGKILL)
                killed += running.returncode != 0
                found = wrong(folder, names, torn=True)
                if not found and k % 5 == 4:
                    subprocess.run(line, check=True, stdout=subprocess.DEVNULL)
                    found = wrong(folder, names, torn=False)
                if found:
                    faults += 1
                    sys.stdout.write(f"{which}, kill {k}: {found}\n")
            sys.stdout.write(f"{which}: {given.kills // 3} runs, {faults} faults so far\n")
            sys.stdout.flush()
    sys.stdout.write(f"{killed} runs killed before their end, {faults} faults\n")
    return int(bool(faults))


if __name__ == "__main__":
    sys.exit(main())
