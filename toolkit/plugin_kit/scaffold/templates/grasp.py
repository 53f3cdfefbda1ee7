"""template: a grasper. Straight from above, across the object's narrow side."""

from __future__ import annotations

import numpy as np
from pydantic import Field

from toolkit.geometry import make_transform
from toolkit.rearrangement.moves import Grasp, PickPlace
from toolkit.registry import Plugin, PluginConfig
from toolkit.stages import Grasper
from toolkit.types import Failure, Float


class TemplateConfig(PluginConfig):
    """Settings of `template`."""

    stroke_m: float = Field(0.085, gt=0, description="Widest opening of the gripper.")
    spare_m: float = Field(0.01, ge=0, description="Room between an open finger and the object.")
    depth_m: float = Field(0.03, gt=0, description="How far the fingers reach down beside the object.")
    finger_m: float = Field(0.02, gt=0, description="Room a finger needs.")


class Template(Plugin[TemplateConfig], Grasper):
    """Top-down grasps, every 15 deg, that span the object and have room for both fingers; the narrowest first."""

    stage = "grasp"
    name = "template"

    def grasp(self, request: PickPlace, seed: int) -> list[Grasp] | Failure:
        """Return grasps, the narrowest first, or why there is none."""
        if len(request.points) < 10:
            return Failure("grasp", f"only {len(request.points)} points of the object were seen")
        found = [g for angle in np.radians(np.arange(0, 180, 15)) if (g := self._across(request, float(angle)))]
        if not found:
            return Failure("grasp", "it is too wide from above, or there is no room for the fingers beside it")
        return sorted(found, key=lambda grasp: -grasp.score)

    def _across(self, request: PickPlace, angle: float) -> Grasp | None:
        c = self.config
        x = np.array([np.cos(angle), np.sin(angle), 0.0])
        along = request.points @ x
        opening = float(np.ptp(along)) + 2 * c.spare_m
        if opening > c.stroke_m:
            return None
        low, high = request.points.min(axis=0), request.points.max(axis=0)
        tip = (low + high) / 2
        tip += x * ((along.min() + along.max()) / 2 - tip @ x)
        tip[2] = max(high[2] - c.depth_m, low[2] + 0.005)
        z = np.array([0.0, 0.0, -1.0])
        grasp = Grasp(make_transform(np.stack([x, np.cross(z, x), z], axis=1), tip), opening, 1 - opening / c.stroke_m)
        here, there = grasp.T_world_gripper, grasp.placed(request.T_place_pick)
        return grasp if all(self._has_room(T, opening, request.others) for T in (here, there)) else None

    def _has_room(self, T: Float, opening: float, others: Float) -> bool:
        """No point of another object within a finger's room of either fingertip, or above it."""
        tips = [T[:3, 3] + side * (opening + self.config.finger_m) / 2 * T[:3, 0] for side in (-1, 1)]
        return not any(
            ((np.linalg.norm(others[:, :2] - tip[:2], axis=1) < self.config.finger_m) & (others[:, 2] > tip[2])).any()
            for tip in tips
        )
