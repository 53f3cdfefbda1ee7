"""template: a registration. Frames that see the table at another height than the rest are moved up or down."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from pydantic import Field

from toolkit.geometry import lift
from toolkit.registry import Plugin, PluginConfig
from toolkit.stages import Registration
from toolkit.types import Frame


class TemplateConfig(PluginConfig):
    """Settings of `template`."""

    most_mm: float = Field(10.0, ge=0, description="A camera is moved by no more than this.")


class Template(Plugin[TemplateConfig], Registration):
    """Brings the table, which is where most points are, to one height in all frames; z is up in the world."""

    stage = "registration"
    name = "template"

    def register(self, frames: Sequence[Frame]) -> list[Frame]:
        """Return the current frames with cameras moved along z."""
        heights = [_table_height(frame) for frame in frames]
        known = [height for height in heights if height is not None]
        common = float(np.median(known)) if known else 0.0
        return [f if h is None else self._moved(f, common - h) for f, h in zip(frames, heights, strict=True)]

    def locate(self, goal: Frame, frames: Sequence[Frame]) -> Frame:
        """Return the goal image as it is: without depth it does not tell its height."""
        return goal

    def _moved(self, frame: Frame, shift: float) -> Frame:
        most = self.config.most_mm / 1000
        T = frame.camera.T_world_camera.copy()
        T[2, 3] += float(np.clip(shift, -most, most))
        return replace(frame, camera=replace(frame.camera, T_world_camera=T))


def _table_height(frame: Frame) -> float | None:
    if frame.depth is None or not (frame.depth > 0).any():
        return None
    y, x = np.nonzero(frame.depth > 0)
    pixels = np.stack([x, y], axis=1).astype(np.float64)
    points = lift(frame.camera.K, frame.camera.T_world_camera, pixels, frame.depth[y, x])
    return float(np.median(points[:, 2]))
