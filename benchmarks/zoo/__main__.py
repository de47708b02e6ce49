"""`python benchmarks/zoo`: score the default path on a zoo of simulated logs."""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

for threads in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(threads, "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from zoo.advised import score as advised  # noqa: E402
from zoo.advised import summary  # noqa: E402
from zoo.advised import table as ranks  # noqa: E402
from zoo.case import draw  # noqa: E402
from zoo.coverage import CLASSES as COVERED  # noqa: E402
from zoo.coverage import line, study  # noqa: E402
from zoo.study import CASES, RESULTS, SEED, chosen, final_seed, keep, scores  # noqa: E402
from zoo.table import CLASSES, aggregate, table, worst  # noqa: E402
from zoo.wrong import right_cases, wrong_cases  # noqa: E402


def score_advice(each: int, right: int, seed: int, jobs: int, out: Path | None) -> None:
    """Score advice on wrong and right models, print and store."""
    cases = [*wrong_cases(each, seed), *right_cases(right, seed)]
    rows = []
    with ProcessPoolExecutor(jobs) as pool:
        for row in pool.map(advised, cases):
            rows.append(row)
            print(f"\r{len(rows)} of {len(cases)}", end="", file=sys.stderr, flush=True)
    figures = summary(rows)
    print(ranks(rows))
    print(json.dumps(figures, indent=1))
    keep(out or RESULTS / "zoo-advice.json", {"each": each, "seed": seed}, rows, figures)


def score_coverage(each: int, seed: int, jobs: int, names: Sequence[str], out: Path | None) -> None:
    """Coverage by class, printed and stored as it is made: a run may be ended early."""
    made = {}
    for name, figures in study(each, seed, jobs, names):
        print(line(name, figures), flush=True)
        made[name] = figures
        keep(out or RESULTS / "zoo-coverage.json", {"each": each, "seed": seed}, [], made)


def main() -> None:
    """Score, print, store."""
    parser = argparse.ArgumentParser(prog="zoo", description=__doc__)
    parser.add_argument("--cases", type=int, default=CASES, help="how many are drawn")
    parser.add_argument("--seed", type=int, default=SEED, help="of the draw")
    parser.add_argument("--final", action="store_true", help="take the seed from the hash of the commit")
    parser.add_argument("--only", choices=CLASSES, help="score only the cases of this class")
    parser.add_argument("--jobs", type=int, default=os.cpu_count(), help="processes")
    parser.add_argument("--former", action="store_true", help="print the stored scores of the former proposal beside")
    parser.add_argument("--fresh", action="store_true", help="compute the oracle again")
    parser.add_argument("--diagnose", action="store_true", help="ask for the report's verdict too: minutes")
    parser.add_argument("--worst", type=int, default=10, help="how many of the worst cases are printed")
    parser.add_argument("--list", action="store_true", help="print the cases only")
    parser.add_argument("--out", type=Path, help="where scores are stored; whole draws go to the results unasked")
    parser.add_argument(
        "--advice", type=int, metavar="N", help="score advice instead: N cases of each cause and device"
    )
    parser.add_argument("--right", type=int, default=60, metavar="N", help="with --advice: cases of right models")
    parser.add_argument("--coverage", type=int, metavar="N", help="score intervals instead: N logs of each class")
    parser.add_argument("--of", nargs="+", choices=COVERED, default=list(COVERED), help="with --coverage: classes")
    given = parser.parse_args()
    if given.coverage:
        seed = final_seed() if given.final else given.seed
        score_coverage(given.coverage, seed, given.jobs, given.of, given.out)
        return
    if given.advice:
        score_advice(
            given.advice, given.right, final_seed() % 10_000 if given.final else given.seed, given.jobs, given.out
        )
        return
    seed = final_seed() if given.final else given.seed
    cases = chosen(draw(given.cases, seed), given.only)
    if given.list:
        print(*cases, sep="\n")
        return
    rows = scores(cases, given.jobs, given.fresh, given.diagnose)
    figures = aggregate(cases, rows)
    former = None
    if given.former:
        kept = {r["case"]: r for r in json.loads((RESULTS / "zoo-former.json").read_text(encoding="utf-8"))["cases"]}
        known = [case for case in cases if str(case) in kept]
        former = aggregate(known, [kept[str(case)] for case in known])
    print(table(figures, former))
    print(worst(rows, given.worst))
    out = given.out
    if out is None and given.only is None and given.cases == CASES and (given.final or seed == SEED):
        out = RESULTS / ("zoo-final.json" if given.final else "zoo-cases.json")
    if out is not None:
        keep(out, {"cases": given.cases, "seed": seed, "only": given.only}, rows, figures)


if __name__ == "__main__":
    main()
