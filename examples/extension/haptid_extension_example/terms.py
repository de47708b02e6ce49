"""Terms of a device."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from haptid.device import TermFormula


def fluid_drag(position: str, velocity: str, prismatic: bool, settings: Mapping[str, Any]) -> list[TermFormula]:  # noqa: ARG001
    """Drag of a fluid, quadratic in the velocity."""
    unit = "N s^2/m^2" if prismatic else "N m s^2/rad^2"
    return [TermFormula(settings.get("stem", "FQ"), unit, f"{velocity}*abs({velocity})")]
