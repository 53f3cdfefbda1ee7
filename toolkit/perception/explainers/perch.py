"""The goal image explained by rendering the current scene's own objects into it."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace

import numpy as np
from pydantic import Field

from toolkit.perception.explainers.searching.evidence import MOST_COST, evidence, with_known
from toolkit.perception.explainers.searching.hypotheses import Searcher
from toolkit.perception.explainers.searching.jointly import Candidate, compose, explain_jointly
from toolkit.perception.explainers.searching.renderings import Surface, render, surface_of
from toolkit.perception.explainers.searching.segments import object_masks, unexplained
from toolkit.perception.explainers.searching.together import moved_together, owners
from toolkit.perception.explainers.searching.trust import judge, trust
from toolkit.perception.explanation import ExplainTask, Explanation, Placement
from toolkit.perception.fusion import FusedModel, united
from toolkit.perception.stages import Explainer
from toolkit.perception.tabletop.appearance import scan_table
from toolkit.perception.tabletop.difference import against_table
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
    rounds: int = Field(
        2, ge=1, description="How often every object is looked for, each time in what the others leave over."
    )
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
        view, found = against_table(task.goal, scan)
        factor = self._factor(task.goal, scan.table.T_world_table)
        coarse, fine = (evidence(task.goal, found, view.table, f) for f in (2 * factor, factor))
        searcher = Searcher(
            scan.table, task.goal.camera, coarse, fine, self.config.step_mm / 1e3, self.config.yaws, self.config.kept
        )
        models = task.models.usable()
        surfaces = {instance: surface_of(model) for instance, model in models.items()}

        def place(instance: int, T_goal_current: Float, moved: bool = True) -> Candidate:
            return Candidate(T_goal_current, moved, render(surfaces[instance], T_goal_current, task.goal.camera, fine))

        def searched(model: FusedModel, surface: Surface, others: Mapping[int, Candidate]) -> list[tuple[Float, bool]]:
            known = compose(others, background)
            images = [image.reshape(fine.background.shape) for image in (known.cost, known.depth)]
            there = replace(searcher, coarse=with_known(coarse, *images), fine=with_known(fine, *images))
            return [(there.motion(model, h), h.moved) for h in there.search(model, surface)]

        def as_one(instances: Collection[int], others: Mapping[int, Candidate]) -> list[Float]:
            model = united([models[i] for i in sorted(instances)])
            return [T for T, moved in searched(model, surface_of(model), others) if moved]

        background = np.minimum(fine.background.ravel(), MOST_COST)
        candidates: dict[int, list[Candidate]] = {instance: [] for instance in models}
        chosen: dict[int, Candidate] = {}
        for _ in range(self.config.rounds):
            for instance, model in models.items():
                others = {i: c for i, c in chosen.items() if i != instance}
                candidates[instance] += [
                    place(instance, *found) for found in searched(model, surfaces[instance], others)
                ]
            chosen = explain_jointly(candidates, background, chosen)
        groups, chosen = moved_together(chosen, models, background, place, as_one)
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
