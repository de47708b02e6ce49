"""Worst-case execution time: written C does what its header counts, without loops, branches and divisions by zero."""

import platform
import re
import shutil
import subprocess
from collections import Counter

import numpy as np
import pytest

import haptid
from compiled import NAME, STRICT, compiler, run
from haptid.export import CCode, export_c
from true_parameters import true_parameters

DEVICES = ("phantom_premium_15", "cea_medical_branch", "puma560", "arm7", "five_bar", "staubli_tx40")
LIBRARY = "sin|cos|tan|tanh|exp|sqrt|fabs|fmax|fmin|pow"
# Statements of the functions in the table: constants, outputs, what is idle, the status.
STATEMENT = re.compile(
    r"const double t\d+ = [^;?]*;|const double \*const k = model->k;|\(void\)\w+;|\w+\[\d+\] = [^;?]*;"
    r"|const int sound = [^;?]*;|\w+\[\d+\] = \(sound != 0\) \? [^;?]*;|return \(sound != 0\) \? 0 : 1;"
)
LINE = re.compile(r"^ \*   (\w+)( [+*])? +(\d+) +(\d+) +(\d+)  (.*)$", re.MULTILINE)
GUARD = re.compile(r"\((\w+|k\[\d+\]) \+ \(double\)\(\1 == 0\.0\)\)")


@pytest.fixture(scope="module", params=DEVICES)
def written(request, tmp_path_factory):
    model = haptid.DynamicModel(haptid.read_device(request.param))
    folder = tmp_path_factory.mktemp("code")
    export_c((model, model.base.of(true_parameters(model))), folder, CCode(NAME))
    return folder


def table(folder):
    """Lines of the header: mark, additions, multiplications, divisions, and calls by function."""
    found = {}
    for name, mark, *counts, library in LINE.findall((folder / f"{NAME}.h").read_text()):
        calls = {} if library == "none" else {f: int(n) for n, f in (each.split() for each in library.split(", "))}
        found[name] = (mark.strip(), *map(int, counts), calls)
    assert "inverse_dynamics" in found
    return found


def bodies(folder):
    text = (folder / f"{NAME}.c").read_text()
    return {
        name: re.search(rf"{NAME}_{name}\([^{{;]*\)\n\{{\n(.*?)\n\}}", text, re.DOTALL)[1] for name in table(folder)
    }


def test_functions_are_straight_lines_that_do_what_the_header_counts(written):
    counted, read = table(written), bodies(written)
    for name, (mark, additions, multiplications, divisions, calls) in counted.items():
        lines = [line.strip() for line in read[name].splitlines()]
        assert not [line for line in lines if not STATEMENT.fullmatch(line)], name
        # Comparisons with zero, the tests of the status and the choice by it are not in the counts.
        body = GUARD.sub(r"\1", "\n".join(line for line in lines if not line.startswith("return")))
        assert body.count(" / ") == divisions
        assert len(re.findall(r" \* ", body)) == multiplications
        assert len(re.findall(r"[\w\])] [+-] ", body)) == additions
        assert Counter(re.findall(rf"\b({LIBRARY})\(", body)) == calls
        assert (mark == "+") == ("sound" in body)
        assert (mark == "*") == (divisions > 0 and "sound" not in body)
        if mark == "+":
            assert len(GUARD.findall(read[name])) == divisions


def test_compiled_functions_have_no_conditional_jump(written):
    """Of the machine code: no jump but to a last call, and calls of the named functions of the library alone."""
    if platform.machine() != "x86_64" or shutil.which("objdump") is None:
        pytest.skip("reads the disassembly of x86-64")
    run([compiler("gcc"), *STRICT, "-O2", "-fno-math-errno", "-c", f"{NAME}.c", "-o", "dev.o"], written)
    listed = subprocess.run(["objdump", "-dr", "dev.o"], cwd=written, capture_output=True, text=True, check=True).stdout
    seen = 0
    for name, (mark, *_, calls) in table(written).items():
        code = re.search(rf"<{NAME}_{name}>:\n(.*?)(?:\n\n|$)", listed, re.DOTALL)[1]
        jumps = [line for line in code.splitlines() if re.search(r"\tj(?!mp)\w+ ", line)]
        called = set(re.findall(r"R_X86_64_PLT32\s+(\w+)-", code))
        # The compiler makes one call of the sine and the cosine of an angle.
        assert called <= {*calls, *(["sincos"] if {"sin", "cos"} <= set(calls) else [])}, name
        if not mark:
            assert not jumps, (name, jumps)
            seen += 1
    assert seen > 2


DRIVER = """
#include "dev.h"
#include <fenv.h>
int main(void)
{{
    static const double p[DEV_PARAMETERS];
    dev_model model;
    double q[{n}] = {{0.0}}, qd[{n}] = {{0.0}}, tau[{n}] = {{1.0}}, qdd[{n}];
    int failed;
    dev_init(&model, p);
    feclearexcept(FE_ALL_EXCEPT);
    failed = dev_forward_dynamics(&model, q, qd, tau, qdd);
    return (failed == 1 && fetestexcept(FE_DIVBYZERO | FE_INVALID) == 0 && qdd[0] == 0.0) ? 0 : 1;
}}
"""


def test_a_singular_matrix_divides_by_nothing(tmp_path):
    """A device without mass: the status says it, and processors that trap divisions by zero go on."""
    model = haptid.DynamicModel(haptid.read_device("puma560"))
    export_c((model, np.ones(len(model.base))), tmp_path, CCode(NAME))
    (tmp_path / "main.c").write_text(DRIVER.format(n=6))
    run([compiler("gcc"), *STRICT, "-O0", f"{NAME}.c", "main.c", "-lm", "-o", "main"], tmp_path)
    run(["./main"], tmp_path)
