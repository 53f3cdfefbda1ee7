"""template: an associator. Regions near each other are one object."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from toolkit.registry import Plugin, PluginConfig
from toolkit.stages import Associator
from toolkit.types import Float, Frame, Region


class TemplateConfig(PluginConfig):
    """Settings of `template`."""

    radius_m: float = Field(0.08, gt=0, description="Regions whose centres are nearer than this are one object.")


class Template(Plugin[TemplateConfig], Associator):
    """Gives every region to the first object within a radius, or begins a new one."""

    stage = "associator"
    name = "template"

    def associate(self, regions: Sequence[Region], frames: Sequence[Frame]) -> NDArray[np.int64]:
        """Return (R,) int64 instance ids 0..K-1, numbered by first occurrence."""
        centers: list[Float] = []
        ids: list[int] = []
        for region in regions:
            center = region.centroid[:2]
            near = [i for i, other in enumerate(centers) if np.linalg.norm(center - other) < self.config.radius_m]
            if not near:
                centers.append(center)
            ids.append(near[0] if near else len(centers) - 1)
        return np.array(ids, np.int64)
