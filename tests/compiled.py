"""Written code, compiled and called on many states at once; and expressions evaluated without a compiler."""

from __future__ import annotations

import ctypes
import math
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from haptid.export.expressions.emit import Function
from haptid.export.model.functions import Code

STRICT = ["-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Werror"]
NAME = "dev"


def named(beta: np.ndarray, **arrays: np.ndarray) -> dict[str, np.ndarray]:
    """Values of p[k], and of x[k] for every array x of shape (n, samples)."""
    made = {f"p[{k}]": value for k, value in enumerate(beta)}
    for name, rows in arrays.items():
        made |= {f"{name}[{k}]": row for k, row in enumerate(rows)}
    return made


def run(command: list[str], folder: Path) -> subprocess.CompletedProcess[str]:
    """A compiler or a program; fails with all that it said."""
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{' '.join(command)}\n{done.stdout}\n{done.stderr}"
    return done


def compiler(name: str) -> str:
    import pytest

    found = shutil.which(name)
    if found is None:
        pytest.skip(f"{name} is not installed")
    return found


@dataclass
class Library:
    """The functions of a folder of written code, each called for many states."""

    code: Code
    real: type
    handle: ctypes.CDLL
    constants: ctypes.Array

    @staticmethod
    def built(folder: Path, code: Code, precision: str) -> Library:
        real = "double" if precision == "double" else "float"
        (folder / "batch.c").write_text(
            f'#include "{NAME}.h"\nsize_t model_size(void) {{ return sizeof({NAME}_model); }}\n'.replace(
                "#include", "#include <stddef.h>\n#include", 1
            )
            + "".join(_batch(function, real) for function in code.functions)
        )
        shared = [compiler("gcc"), *STRICT, "-O1", "-shared", "-fPIC", f"{NAME}.c", "batch.c", "-lm", "-o", "lib.so"]
        run(shared, folder)
        handle = ctypes.CDLL(str(folder / "lib.so"))
        handle.model_size.restype = ctypes.c_size_t
        constants = ctypes.create_string_buffer(handle.model_size())
        count = len(code.model.base)
        getattr(handle, f"{NAME}_init")(constants, (ctypes.c_double * max(count, 1)).in_dll(handle, f"{NAME}_beta"))
        return Library(code, np.float64 if real == "double" else np.float32, handle, constants)

    def __call__(self, name: str, arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Outputs, (samples, size), from inputs (n, samples)."""
        function = self.code[name]
        inputs = [np.ascontiguousarray(arrays[x].T, dtype=self.real) for x, _ in function.inputs]
        samples = len(inputs[0])
        outputs = {x: np.zeros((samples, len(values)), dtype=self.real) for x, values in function.outputs}
        pointers = [x.ctypes.data_as(ctypes.c_void_p) for x in (*inputs, *outputs.values())]
        getattr(self.handle, f"batch_{name}")(self.constants, ctypes.c_int(samples), *pointers)
        return {x: values.astype(float) for x, values in outputs.items()}


def _batch(function: Function, real: str) -> str:
    """A loop over states around one function."""
    arrays = [(name, size, "const ") for name, size in function.inputs]
    arrays += [(name, len(values), "") for name, values in function.outputs]
    declared = ", ".join(f"{const}{real} *{name}" for name, _, const in arrays)
    passed = [*(["model"] if function.parameters else []), *(f"{name} + {size} * i" for name, size, _ in arrays)]
    call = f"{NAME}_{function.name}({', '.join(passed)});"
    head = f"void batch_{function.name}(const {NAME}_model *model, int samples, {declared})"
    return f"{head};\n{head}\n{{\n    (void)model;\n    for (int i = 0; i < samples; i++) {{ {call} }}\n}}\n"


def relative(got: np.ndarray, wanted: np.ndarray) -> float:
    """Largest difference beside the largest entry wanted; of nothing, the difference itself."""
    largest = float(np.abs(wanted).max(initial=0.0))
    return float(np.abs(got - wanted).max(initial=0.0)) / (largest if largest > 0 and math.isfinite(largest) else 1.0)
