"""template: a motion planner. A tree grows from the start towards random poses, and now and then towards the goal."""

from __future__ import annotations

import numpy as np
from pydantic import Field

from toolkit.rearrangement.moves import MotionProblem
from toolkit.rearrangement.paths import densify, shortcut
from toolkit.registry import Plugin, PluginConfig
from toolkit.stages import MotionPlanner
from toolkit.types import Failure, Float


class TemplateConfig(PluginConfig):
    """Settings of `template`."""

    nodes: int = Field(5000, ge=1, description="Largest number of poses in the tree.")
    reach_rad: float = Field(0.3, gt=0, description="Longest branch.")
    step_rad: float = Field(0.02, gt=0, description="Way between two collision checks, over all joints.")
    goal_share: float = Field(0.2, gt=0, le=1, description="How often the tree grows towards the goal.")


class Template(Plugin[TemplateConfig], MotionPlanner):
    """RRT (LaValle, 1998) with shortcuts."""

    stage = "motion"
    name = "template"

    def plan(self, problem: MotionProblem, seed: int) -> Float | Failure:
        """Return the (N, J) joint angles of a free path from start to goal, or a Failure that says why not."""
        for what, q in (("start", problem.start), ("goal", problem.goal)):
            if not problem.free(q):
                return Failure("motion", f"the arm would touch something at the motion's {what}")
        c, rng = self.config, np.random.default_rng(seed)
        nodes, parents = [problem.start], [0]
        while len(nodes) < c.nodes:
            towards_goal = rng.random() < c.goal_share
            target = problem.goal if towards_goal else rng.uniform(problem.lower, problem.upper)
            nearest = int(np.linalg.norm(np.array(nodes) - target, axis=1).argmin())
            way = target - nodes[nearest]
            reached = np.linalg.norm(way) <= c.reach_rad
            new = target if reached else nodes[nearest] + way * (c.reach_rad / np.linalg.norm(way))
            if not all(problem.free(q) for q in densify(np.stack([nodes[nearest], new]), c.step_rad)):
                # A failed try counts too, so that the search ends.
                new = nodes[nearest]
            nodes.append(new)
            parents.append(nearest)
            if towards_goal and np.array_equal(new, problem.goal):
                path = [len(nodes) - 1]
                while path[-1]:
                    path.append(parents[path[-1]])
                return shortcut(np.array([nodes[i] for i in reversed(path)]), problem.free, c.step_rad, 60, rng)
        return Failure("motion", f"no motion was found among {len(nodes)} poses")
