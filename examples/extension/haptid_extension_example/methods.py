"""Estimation methods."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from haptid.errors import SettingError
from haptid.observation import Observation


@dataclass(frozen=True)
class RatedTorque:
    """Least squares with each motor's rows divided by its rated torque, so that each counts by its own capability.

    Attributes:
        torques: rated torque of each motor, N m or N.
    """

    torques: list[float]
    name: ClassVar[str] = "rated torque"
    # The weighted residual does not have unit variance: the variance is estimated.
    unit_residual: ClassVar[bool] = False

    def weights(self, observation: Observation) -> np.ndarray:
        """One over the rated torque of each motor, (motors,)."""
        if len(self.torques) != len(observation.motors):
            raise SettingError(
                f"{len(self.torques)} rated torques are given for {len(observation.motors)} motors.",
                where="torques",
                found=len(self.torques),
                limit=len(observation.motors),
                advice="Give one for each motor.",
            )
        return 1.0 / np.array(self.torques)
