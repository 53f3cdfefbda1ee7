"""template: a grasper. Straight from above, across the object's narrow side."""

from __future__ import annotations

import numpy as np
from pydantic import Field

from toolkit.geometry import make_transform
from toolkit.rearrangement.moves import Grasp, GraspRequest
from toolkit.registry import Plugin, PluginConfig
from toolkit.stages import Grasper
from toolkit.types import Failure, Float


class TemplateConfig(PluginConfig):
    """Settings of `template`."""

    spare_m: float = Field(0.01, ge=0, description="Room between an open finger and the object.")
    depth_m: float = Field(0.03, gt=0, description="How far the fingers reach down beside the object.")


class Template(Plugin[TemplateConfig], Grasper):
    """Top-down grasps, every 15 deg, that span the object and have room for both fingers; the narrowest first."""

    stage = "grasp"
    name = "template"

    def grasp(self, request: GraspRequest, seed: int) -> list[Grasp] | Failure:
        """Return grasps, the narrowest first, or why there is none."""
        if len(request.points) < 10:
            return Failure("grasp", f"only {len(request.points)} points of the object were seen")
        found = [g for angle in np.radians(np.arange(0, 180, 15)) if (g := self._across(request, float(angle)))]
        if not found:
            return Failure("grasp", "it is too wide from above, or there is no room for the fingers beside it")
        return sorted(found, key=lambda grasp: -grasp.score)

    def _across(self, request: GraspRequest, angle: float) -> Grasp | None:
        c = self.config
        x = np.array([np.cos(angle), np.sin(angle), 0.0])
        along = request.points @ x
        opening = float(np.ptp(along)) + 2 * c.spare_m
        if opening > request.gripper.stroke_m:
            return None
        low, high = request.points.min(axis=0), request.points.max(axis=0)
        tip = (low + high) / 2
        tip += x * ((along.min() + along.max()) / 2 - tip @ x)
        tip[2] = max(high[2] - c.depth_m, low[2] + 0.005)
        z = np.array([0.0, 0.0, -1.0])
        T = make_transform(np.stack([x, np.cross(z, x), z], axis=1), tip)
        grasp = Grasp(T, opening, c.spare_m, 1 - opening / request.gripper.stroke_m)
        poses = (T, grasp.placed(request.T_place_pick))
        return grasp if all(_has_room(pose, opening, request) for pose in poses) else None


def _has_room(T: Float, opening: float, request: GraspRequest) -> bool:
    """Say whether no point of another object lies about a fingertip, or above it, whence it comes."""
    thickness, width, _ = request.gripper.finger_m
    for side in (-1, 1):
        tip = T[:3, 3] + side * (opening + thickness) / 2 * T[:3, 0]
        above = request.others[request.others[:, 2] > tip[2]]
        if (np.linalg.norm(above[:, :2] - tip[:2], axis=1) < np.hypot(thickness, width)).any():
            return False
    return True
