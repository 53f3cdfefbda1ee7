"""online_descriptor: any descriptor, adapted to tell apart the objects of the scene at hand."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from toolkit.registry import Plugin, PluginConfig
from toolkit.stages import DESCRIPTORS, Adaptation, AdaptiveDescriptor, Descriptor
from toolkit.types import Crop, Float


class OnlineDescriptorConfig(PluginConfig):
    """Settings of `online_descriptor`."""

    base: str = Field("color_hist", description="The descriptor that is adapted.")
    base_settings: dict[str, Any] = Field(default_factory=dict[str, Any], description="Settings of `base`.")
    shrinkage: float = Field(
        0.1,
        gt=0,
        description="Number that is added to every variance, as a share of the largest; if it is large, nothing is "
        "learnt.",
    )


class OnlineDescriptor(Plugin[OnlineDescriptorConfig], Descriptor, AdaptiveDescriptor):
    """A descriptor that learns from the scene's own views, the paper's future work.

    The views show every object several times. How an object's descriptor varies from view to view says nothing about
    which object it is: these directions are shrunk (within-class whitening, as in Fisher's linear discriminant), those
    in which the objects differ count for more. It takes milliseconds, and no weights.
    """

    stage = "descriptor"
    name = "online_descriptor"

    def __init__(self, config: OnlineDescriptorConfig | None = None) -> None:
        super().__init__(config)
        self._base: Any = DESCRIPTORS.create(self.config.base, self.config.base_settings)

    @property
    def crop_size(self) -> int:
        """Side of the crops, pixels: what the base wants."""
        return self._base.crop_size

    def check_ready(self) -> None:
        """The base must be ready."""
        self._base.check_ready()

    def digests(self) -> dict[str, str]:
        """The base's weights."""
        return self._base.digests()

    def describe(self, crops: Sequence[Crop]) -> Float:
        """Return the base's (N, d) float32 rows of unit length."""
        return self._base.describe(crops)

    def adapt(self, rows: Float, instances: NDArray[np.int64]) -> Adaptation:
        """Learn which directions vary within the objects, from (R, d) rows and their (R,) instances."""
        x = np.asarray(rows, np.float64)
        means = np.stack([x[instances == k].mean(axis=0) for k in np.unique(instances)])
        within = x - means[np.unique(instances, return_inverse=True)[1]]
        _, spread, directions = np.linalg.svd(within, full_matrices=False)
        variance = spread**2 / len(x)
        if not variance.max(initial=0.0) > 1e-12:
            return _unit
        # Directions that vary by chance keep their scale; the more one varies, the more it is shrunk.
        floor = self.config.shrinkage * variance.max()
        shrink = np.sqrt(floor / (variance + floor)) - 1
        center = means.mean(axis=0) if len(means) > 1 else np.zeros(x.shape[1])

        def adaptation(given: Float) -> Float:
            centered = np.asarray(given, np.float64) - center
            return _unit(centered + (centered @ directions.T * shrink) @ directions)

        return adaptation


def _unit(rows: Float) -> Float:
    lengths = np.linalg.norm(rows, axis=1, keepdims=True)
    # A row at the very centre is like none of the objects; give it a direction all the same.
    safe = np.where(lengths > 1e-9, rows / np.maximum(lengths, 1e-9), 1 / np.sqrt(rows.shape[1]))
    return safe.astype(np.float32)
