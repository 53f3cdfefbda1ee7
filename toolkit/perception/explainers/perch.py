"""The goal image explained by rendering the current scene's own objects into it."""

from __future__ import annotations

import numpy as np
from pydantic import Field

from toolkit.perception.explainers.searching.evidence import MOST_COST, evidence
from toolkit.perception.explainers.searching.hypotheses import Searcher
from toolkit.perception.explainers.searching.jointly import Candidate, compose, explain_jointly
from toolkit.perception.explainers.searching.renderings import render, surface_of
from toolkit.perception.explainers.searching.segments import object_masks, unexplained
from toolkit.perception.explainers.searching.together import joined, moved_together, owners
from toolkit.perception.explainers.searching.trust import judge, trust
from toolkit.perception.explanation import ExplainTask, Explanation, Placement
from toolkit.perception.stages import Explainer
from toolkit.perception.tabletop.appearance import render_table, scan_table
from toolkit.perception.tabletop.difference import difference
from toolkit.registry import Plugin, PluginConfig
from toolkit.types import Float, Frame, Segment

_FOREGROUND = 4.0
"""Deviations from the empty table's look: what lies beside an object and differs so much belongs to it."""


class PerchConfig(PluginConfig):
    """Settings of `perch`."""

    pixel_mm: float = Field(3.0, gt=0, description="Size on the table of a pixel of the image that is explained.")
    step_mm: float = Field(25.0, gt=0, description="Distance between the places on the table that are tried.")
    yaws: int = Field(24, ge=1, description="Turns about the vertical that are tried at every place.")
    kept: int = Field(12, ge=1, description="Places of an object that compete, besides the one where it stands now.")
    min_pixels: int = Field(60, ge=1, description="Objects of which the goal shows fewer pixels are left out.")


class Perch(Plugin[PerchConfig], Explainer):
    """Perception via search (Narayanan and Likhachev, ICRA 2016): which objects, placed where, would look like this?

    Every instance is rendered where it stands now and all over the table; the hypotheses that together explain the
    whole image best are chosen, each instance once at most, hidden behind each other as they would be. Masks are what
    comes out, so that touching objects part where their models say. What no model explains is unknown.
    """

    stage = "explainer"
    name = "perch"

    def explain(self, task: ExplainTask) -> Explanation:
        """Explain a goal image; raises ToolkitError where no current frame's depth shows a table."""
        scan = scan_table(task.models.frames)
        view = render_table(scan, task.goal.camera)
        found = difference(task.goal.rgb, view)
        factor = self._factor(task.goal, scan.table.T_world_table)
        coarse, fine = (evidence(task.goal, found, view.table, f) for f in (2 * factor, factor))
        searcher = Searcher(
            scan.table, task.goal.camera, coarse, fine, self.config.step_mm / 1e3, self.config.yaws, self.config.kept
        )
        models = task.models.usable()
        surfaces = {instance: surface_of(model) for instance, model in models.items()}

        def place(instance: int, T_goal_current: Float, moved: bool = True) -> Candidate:
            return Candidate(T_goal_current, moved, render(surfaces[instance], T_goal_current, task.goal.camera, fine))

        candidates = {
            instance: [
                place(instance, searcher.motion(model, h), h.moved) for h in searcher.search(model, surfaces[instance])
            ]
            for instance, model in models.items()
        }
        background = np.minimum(fine.background.ravel(), MOST_COST)
        chosen = explain_jointly(candidates, background)
        groups = moved_together(chosen, models, background, place)
        chosen = joined(chosen, groups, place)
        owner = owners(compose(chosen, background).owner, groups).reshape(fine.background.shape)
        masks = object_masks(owner, factor, task.goal.rgb, found.score > _FOREGROUND)
        masks = {instance: mask for instance, mask in masks.items() if mask.sum() >= self.config.min_pixels}
        placements: list[Placement] = []
        for instance, mask in sorted(masks.items(), key=lambda entry: int(entry[1].argmax())):
            judged = judge(instance, chosen, candidates[instance], models, background, scan.table)
            segment, T = Segment(mask, instance=instance), chosen[instance].T_goal_current
            placements.append(Placement(instance, T, segment, trust(judged), judged))
        return Explanation(tuple(placements), unexplained(task.segments, masks), groups)

    def _factor(self, goal: Frame, T_world_table: Float) -> int:
        """Pixels of the goal image that are one pixel of the explained one."""
        distance = float(np.linalg.norm(goal.camera.T_world_camera[:3, 3] - T_world_table[:3, 3]))
        return max(1, round(self.config.pixel_mm / 1e3 * float(goal.camera.K[0, 0]) / distance))
