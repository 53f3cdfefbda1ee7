"""How far stated camera poses are to be believed."""

from __future__ import annotations

import numpy as np
from pydantic import Field

from toolkit.registry import PluginConfig
from toolkit.types import Float


class StatedConfig(PluginConfig):
    """Settings of every registration: how far stated poses are off."""

    rotation_deg: float = Field(
        0.2, gt=0, description="Expected error of a camera's orientation, in degrees about each axis."
    )
    translation_mm: float = Field(
        2.0, gt=0, description="Expected error of a camera's place, in millimetres along each axis."
    )

    @property
    def sigma(self) -> Float:
        """(6,) of turn, radians, and shift, metres."""
        return np.repeat([np.radians(self.rotation_deg), self.translation_mm / 1e3], 3)
