"""template: a refiner. It moves nothing, and believes a motion only where it puts the object into its silhouette."""

from __future__ import annotations

import numpy as np
from pydantic import Field

from toolkit.geometry import invert, project, transform_points
from toolkit.perception.fusion import RefineTask
from toolkit.registry import Plugin, PluginConfig
from toolkit.stages import Refiner
from toolkit.types import Abstention, Failure, Float, Refined


class TemplateConfig(PluginConfig):
    """Settings of `template`."""

    min_inside: float = Field(
        0.6, ge=0, le=1, description="Share of points in the silhouette, below which it abstains."
    )


class Template(Plugin[TemplateConfig], Refiner):
    """Verifies PnP's motion: the share of the moved model's points that fall into the object's mask in the goal."""

    stage = "refiner"
    name = "template"

    def refine(self, task: RefineTask) -> Refined | Failure:
        """Return the first start as it is, with that share as its confidence."""
        if not task.starts:
            return Failure("refiner", "there is no motion to verify")
        model = task.models.get(task.instance)
        if isinstance(model, Failure):
            return model
        start = task.starts[0]
        inside = _inside(task, transform_points(start.T_goal_current, model.points.astype(np.float64)))
        if inside < self.config.min_inside:
            return Abstention("refiner", f"{inside:.0%} of the points fall into the silhouette")
        covariance = np.zeros((6, 6)) if start.covariance is None else start.covariance
        return Refined(start.T_goal_current, inside, start.T_goal_current[None], "none", covariance)

    def verify(self, task: RefineTask) -> None:
        """Instances are not compared."""


def _inside(task: RefineTask, points: Float) -> float:
    camera = task.goal.camera
    pixels, _ = project(camera.K, invert(camera.T_world_camera), points)
    xy = np.rint(np.nan_to_num(pixels, nan=-1)).astype(int)
    seen = ((xy >= 0) & (xy < [camera.width, camera.height])).all(axis=1)
    return float(task.segment.mask[xy[seen, 1], xy[seen, 0]].sum() / len(points))
