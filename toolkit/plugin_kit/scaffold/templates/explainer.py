"""template: an explainer. It knows only what has not moved: an instance that the goal shows where it stands now."""

from __future__ import annotations

import numpy as np
from pydantic import Field

from toolkit.geometry import invert, project
from toolkit.perception.explanation import ExplainTask, Explanation, Placement
from toolkit.perception.fusion import FusedModel
from toolkit.registry import Plugin, PluginConfig
from toolkit.stages import Explainer
from toolkit.types import Segment


class TemplateConfig(PluginConfig):
    """Settings of `template`."""

    most_levels: float = Field(20.0, gt=0, description="Grey levels by which an unmoved object's colours may differ.")


class Template(Plugin[TemplateConfig], Explainer):
    """Compares each model's colours with the goal's, where the model would be seen had it not been moved."""

    stage = "explainer"
    name = "template"

    def explain(self, task: ExplainTask) -> Explanation:
        """Place what has not moved; a segment of the goal that shows none of it is unknown."""
        placements: list[Placement] = []
        left = list(task.segments)
        for instance, model in task.models.usable().items():
            pixels, gap = _seen_unmoved(task, model)
            for segment in left:
                inside = segment.mask[pixels[:, 1], pixels[:, 0]]
                if len(inside) and inside.mean() > 0.5 and np.median(gap[inside]) < self.config.most_levels:
                    placements.append(Placement(instance, np.eye(4), Segment(segment.mask, instance=instance), 0.5))
                    left = [other for other in left if other is not segment]
                    break
        return Explanation(tuple(placements), tuple(left))


def _seen_unmoved(task: ExplainTask, model: FusedModel) -> tuple[np.ndarray, np.ndarray]:
    """Pixels (N, 2) of the model's points in the goal image, and by how many grey levels (N,) the colours differ."""
    camera = task.goal.camera
    pixels, _ = project(camera.K, invert(camera.T_world_camera), model.points.astype(np.float64))
    xy = np.rint(np.nan_to_num(pixels, nan=-1)).astype(int)
    seen = ((xy >= 0) & (xy < [camera.width, camera.height])).all(axis=1)
    x, y = xy[seen].T
    gap = np.abs(task.goal.rgb[y, x].astype(np.float64) - model.colors[seen]).mean(axis=1)
    return xy[seen], gap
