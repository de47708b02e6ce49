"""Exported C code, compiled and loaded with ctypes, so that the bench runs the code that goes to a real device."""

from __future__ import annotations

import ctypes
import os
import re
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import field
from pathlib import Path
from typing import Any

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.atomic_folder import verified
from haptid._internal.late import dataclass
from haptid.errors import ExportError, MissingDependencyError, setting_error

FLAGS = ("-std=c99", "-O2", "-fPIC", "-shared")
# Fields of the observer's and the differentiator's structs: scalars, then vectors; and the argument of their init.
_SCALARS = {"observer": ("dt", "keep"), "differentiator": ("a", "b")}
VECTORS = {"observer": ("p", "pushed", "torque"), "differentiator": ("q", "qd")}
_SETTINGS = {"observer": "gain", "differentiator": "cutoff_hz"}


@dataclass(frozen=True)
class Prototype:
    """A function of the code, as its header declares it.

    Attributes:
        takes_model: whether its first argument is the model.
        inputs: sizes of the input arrays, by name.
        outputs: sizes of the output arrays, by name.
        checks: whether it returns a status.
    """

    takes_model: bool
    inputs: Mapping[str, int]
    outputs: Mapping[str, int]
    checks: bool


@dataclass(frozen=True, eq=False)
class Compiled:
    """Compiled code of an exported folder; see `Compiled.of`.

    Attributes:
        name: prefix of its names.
        coordinates: their number.
        functions: by name, without the prefix.
        real: ctypes type of its numbers.
        library: the loaded shared library.
        constants: the model's struct of precomputed values.
    """

    name: str
    coordinates: int
    functions: Mapping[str, Prototype]
    real: Any
    library: ctypes.CDLL
    constants: Any = field(repr=False)

    @staticmethod
    def of(folder: str | Path) -> Compiled:
        """Compile and load a folder of `export_c`, with the compiler of the environment variable CC, else `cc`.

        Args:
            folder: with NAME.h and NAME.c.

        Raises:
            ExportError: the folder does not have exactly one model, its loops are not linear, or it does not compile.
            MissingDependencyError: there is no compiler.
            ResultFileError: header and source are of different exports.
        """
        header = _header(Path(folder))
        for path in (header, header.with_suffix(".c")):
            verified(path, path.read_bytes())
        text, name = header.read_text(encoding="utf-8"), header.stem
        if f"{name}_loops;" in text:
            raise ExportError(
                f"{header} is of a device whose loops are not linear; the bench runs code of other devices only.",
                where=header,
                advice="Rehearse it with the Python model, and run the code's self-test.",
            )
        real = ctypes.c_float if f"typedef float {name}_real" in text else ctypes.c_double
        size, coordinates, parameters = (
            _number(text, pattern)
            for pattern in (rf"{name}_real k\[(\d+)\]", r"_COORDINATES (\d+)", r"_PARAMETERS (\d+)")
        )
        library, constants = _built(header), (real * size)()
        getattr(library, f"{name}_init")(constants, (ctypes.c_double * parameters).in_dll(library, f"{name}_beta"))
        return Compiled(name, coordinates, prototypes(text, name), real, library, constants)

    def __call__(self, function: str, *inputs: Array) -> dict[str, Array]:
        """Call a function; returns its outputs by name, zeros where it returns a failure.

        Args:
            function: its name, without the prefix.
            inputs: arrays in the order of the header.
        """
        found = self.functions[function]
        given = [self.array(x) for x in inputs]
        made = {name: (self.real * size)() for name, size in found.outputs.items()}
        self._call(function)(*([self.constants] if found.takes_model else []), *given, *made.values())
        return {name: np.array(values, dtype=float) for name, values in made.items()}

    def _call(self, name: str) -> Any:
        """A function of the library by its name without the prefix; as an attribute, which the library keeps."""
        return getattr(self.library, f"{self.name}_{name}")

    def array(self, values: Array) -> Any:
        """A ctypes array of the values."""
        return (self.real * len(values)).from_buffer_copy(np.ascontiguousarray(values, self.real))

    def friction_compensation(self, qd: Array, share: float) -> Array:
        """Friction compensation torque, (coordinates,), N m or N."""
        tau = (self.real * self.coordinates)()
        self._call("friction_compensation")(self.constants, self.array(qd), self.real(share), tau)
        return np.array(tau, dtype=float)

    def differentiator(self, cutoff_hz: float, dt: float) -> Callable[[Array], Array]:
        """The code's differentiator: velocity from one position sample after another, each (coordinates,)."""
        state = self._state("differentiator", cutoff_hz, dt)

        def update(q: Array) -> Array:
            qd = (self.real * self.coordinates)()
            self._call("differentiator_update")(ctypes.byref(state), self.array(q), qd)
            return np.array(qd, dtype=float)

        return update

    def observer(self, gain: float, dt: float) -> Callable[[Array, Array, Array], Array]:
        """The code's momentum observer: hand torque from position, velocity and motor torque, each (coordinates,)."""
        state = self._state("observer", gain, dt)

        def update(q: Array, qd: Array, tau: Array) -> Array:
            torque = (self.real * self.coordinates)()
            given = [self.array(x) for x in (q, qd, tau)]
            self._call("observer_update")(self.constants, ctypes.byref(state), *given, torque)
            return np.array(torque, dtype=float)

        return update

    def _state(self, kind: str, setting: float, dt: float) -> Any:
        """An initialised observer or differentiator."""
        scalars = [(name, self.real) for name in _SCALARS[kind]]
        vectors = [(name, self.real * self.coordinates) for name in VECTORS[kind]]
        state = type(kind, (ctypes.Structure,), {"_fields_": [*scalars, ("started", ctypes.c_int), *vectors]})()
        failed = self._call(f"{kind}_init")(ctypes.byref(state), self.real(setting), self.real(dt))
        if failed:
            wanted = f"a positive number, feasible at a step of {dt:g} s"
            raise setting_error(_SETTINGS[kind], setting, wanted, kind)
        return state


def prototypes(header: str, name: str) -> dict[str, Prototype]:
    """Functions of a header whose arguments are the model and arrays only."""
    found = {}
    for kind, function, arguments in re.findall(rf"^(void|int) {name}_(\w+)\(([^)]*)\);", header, re.MULTILINE):
        parts = [" ".join(part.split()) for part in arguments.split(",")]
        arrays = [re.fullmatch(rf"(const )?{name}_real (\w+)\[(\d+)\]", part) for part in parts]
        takes_model = parts[0] == f"const {name}_model *model"
        sized = [a for a in arrays if a]
        if len(sized) + takes_model == len(parts):
            inputs = {a[2]: int(a[3]) for a in sized if a[1]}
            outputs = {a[2]: int(a[3]) for a in sized if not a[1]}
            found[function] = Prototype(takes_model, inputs, outputs, kind == "int")
    return found


def _header(folder: Path) -> Path:
    """The header of the folder's one model."""
    found = [path for path in sorted(folder.glob("*.h")) if path.with_suffix(".c").is_file()]
    if len(found) != 1:
        names = [path.name for path in found]
        what = f"has the code of several models: {', '.join(names)}" if names else "has no exported code"
        raise ExportError(
            f"{folder} {what}.",
            where=folder,
            found=names,
            advice="Give a folder written by `export_c` or `haptid export --to c`.",
        )
    return found[0]


def _number(text: str, pattern: str) -> int:
    found = re.search(pattern, text)
    assert found is not None  # haptid wrote the header
    return int(found[1])


def _built(header: Path) -> ctypes.CDLL:
    """The source of a header, compiled and loaded."""
    command = os.environ.get("CC", "cc")
    if shutil.which(command) is None:
        raise MissingDependencyError(
            f"there is no C compiler {command!r}.",
            where=command,
            advice="Install one, or set the environment variable CC.",
        )
    with tempfile.TemporaryDirectory() as scratch:
        out = Path(scratch) / "model.so"
        source = header.with_suffix(".c").resolve()
        done = subprocess.run(
            [command, *FLAGS, str(source), "-lm", "-o", str(out)], capture_output=True, text=True, check=False
        )
        if done.returncode:
            raise ExportError(
                f"{source} does not compile.",
                where=source,
                advice=f"Export the model again. Output of the compiler:\n{done.stderr.strip()}",
            )
        return ctypes.CDLL(str(out))
