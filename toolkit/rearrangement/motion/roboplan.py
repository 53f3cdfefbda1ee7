"""RRT-Connect (Kuffner, LaValle, ICRA 2000) from RoboPlan, on Pinocchio and Coal: nothing of a search is Python."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from pydantic import Field

from toolkit.rearrangement.moves import MotionProblem
from toolkit.rearrangement.stages import MotionPlanner
from toolkit.registry import Plugin, PluginConfig
from toolkit.sim.roboplan import require_roboplan
from toolkit.types import Failure, Float

if TYPE_CHECKING:
    from toolkit.sim.arm_scene import ArmScene


class RoboplanConfig(PluginConfig):
    """Settings of `roboplan`."""

    range_rad: float = Field(0.8, gt=0, description="Longest branch of the trees.")
    step_rad: float = Field(0.01, gt=0, description="Way between two collision checks, over all joints.")
    nodes: int = Field(10000, ge=2, description="Largest number of poses in both trees; a search ends with them.")
    shortcuts: int = Field(100, ge=0, description="Shortcuts tried on a path that was found.")


class Roboplan(Plugin[RoboplanConfig], MotionPlanner):
    """The straight line where it is free; else RRT-Connect, then shortcuts. It looks at the problem's shapes only."""

    stage = "motion"
    name = "roboplan"

    def __init__(self, config: RoboplanConfig | None = None) -> None:
        super().__init__(config)
        self._latest: ArmScene | None = None

    def check_ready(self) -> None:
        require_roboplan()

    def plan(self, problem: MotionProblem, seed: int) -> Float | Failure:
        c, scene = self.config, self._scene(problem)
        for what, q in (("start", problem.start), ("goal", problem.goal)):
            if not scene.free(q):
                return Failure("motion", f"the arm would touch something at the motion's {what}")
        if scene.straight(problem.start, problem.goal, c.step_rad):
            return np.stack([problem.start, problem.goal])
        path = scene.search(problem.start, problem.goal, seed, reach=c.range_rad, step=c.step_rad, nodes=c.nodes)
        if path is None:
            return Failure("motion", f"no motion was found among {c.nodes} poses")
        return scene.shortened(path, seed, step=c.step_rad, tries=c.shortcuts)

    def _scene(self, problem: MotionProblem) -> ArmScene:
        """The problem's scene. Robot and shapes are kept, since reading them takes longer than most searches."""
        from toolkit.sim.arm_scene import ArmScene

        asked = problem.world, problem.lower, problem.upper
        if self._latest is not None and self._latest.shows(*asked):
            self._latest.arrange(problem.world)
        else:
            self._latest = ArmScene(*asked)
        return self._latest
