"""What can be wrong with writing a model out for other programs."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from haptid.errors._both import (
    ExportError,
    PhysicalConsistencyError,
    SettingError,
    UnknownNameError,
    UnvalidatedModelError,
)


class UnexportableTermError(ExportError):
    """A term of the device that code for a control loop cannot compute."""

    def __init__(self, name: str, why: str) -> None:
        super().__init__(
            f"term {name} cannot be written as code: {why}. Write it with positions and velocities only, or leave it "
            f"out of the device file and add its torque in the control loop."
        )


class FailedValidationError(UnvalidatedModelError):
    """A model that predicts unseen motion worse than its criterion allows."""

    def __init__(self, relative: float, limit: float) -> None:
        super().__init__(
            f"the model misses {relative:.2f} % of the unseen torque, the criterion is {limit:.2f} %. Identify it "
            f"again, or export it anyway: the header will then say that it failed."
        )


class CodeNameError(SettingError):
    """A name that is none in C, or too long for the linker of an old compiler."""

    def __init__(self, name: str, longest: int) -> None:
        super().__init__(
            f"{name!r} cannot begin the names of C functions. Write a lower-case letter, then lower-case letters, "
            f"digits and underscores, at most {longest} characters."
        )


class CodeSettingError(SettingError):
    """A setting of the written code that means nothing."""

    def __init__(self, name: str, value: object, wanted: str) -> None:
        super().__init__(f"{name} is {value!r}; write {wanted}.")


class UnvalidatedError(UnvalidatedModelError):
    """A model with a criterion that nothing has tested."""

    def __init__(self, limit: float) -> None:
        super().__init__(
            f"the criterion is {limit:.2f} %, and the model was not validated on unseen motion. Give a validation or a "
            f"log with the role validate, or export it anyway: the header will then say that it was not tested."
        )


class VaryingLoopError(ExportError):
    """A loop whose joints do not follow the active ones in proportion."""

    def __init__(self, device: str, joints: Sequence[str]) -> None:
        super().__init__(
            f"{device} has loops that are solved at every pose: {', '.join(joints)} do not follow the active joints in "
            f"proportion. Code without iterations is only written of loops such as parallelograms, couplings and mimic "
            f"joints."
        )


class ImpossibleModelError(PhysicalConsistencyError):
    """Base parameters that no bodies have, for a format that asks for bodies."""

    def __init__(self, failing: Sequence[str]) -> None:
        super().__init__(
            f"no real bodies have these base parameters: {'; '.join(failing)}. A simulator needs bodies. Identify with "
            f"`possible = true` under [estimate] in the study, or hold the estimate with `haptid.Consistent`."
        )


class ExportFormatError(UnknownNameError):
    """A format that haptid does not write."""

    def __init__(self, name: str, known: Iterable[str]) -> None:
        super().__init__(f"there is no format {name!r} to export to; write one of {', '.join(known)}.")
