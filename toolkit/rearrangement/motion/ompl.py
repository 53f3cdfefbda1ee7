"""RRT-Connect from the Open Motion Planning Library (Sucan, Moll, Kavraki, RAM 2012), the planner behind MoveIt."""

from __future__ import annotations

import ctypes
import importlib
import importlib.util
from functools import cache
from itertools import count
from pathlib import Path
from typing import Any, cast

import numpy as np
from pydantic import Field

from toolkit.errors import ToolkitError
from toolkit.rearrangement.moves import MotionProblem
from toolkit.rearrangement.paths import densify, shortcut
from toolkit.rearrangement.stages import MotionPlanner
from toolkit.registry import Plugin, PluginConfig
from toolkit.types import Failure, Float

_PARTS = ("base", "geometric", "util")
_SET_SEED = "_ZN4ompl3RNG7setSeedEm"


class OmplConfig(PluginConfig):
    """Settings of `ompl`."""

    range_rad: float = Field(0.8, gt=0, description="Longest branch of the trees.")
    step_rad: float = Field(0.01, gt=0, description="Way between two collision checks, over all joints.")
    iterations: int = Field(
        4000, ge=1, description="Largest number of branches that are tried; a search ends with them."
    )
    shortcuts: int = Field(60, ge=0, description="Shortcuts tried on a path that was found.")


class Ompl(Plugin[OmplConfig], MotionPlanner):
    """RRT-Connect, then shortcuts. It asks the problem whether a pose is free, and does not look at its shapes."""

    stage = "motion"
    name = "ompl"

    def check_ready(self) -> None:
        if importlib.util.find_spec("ompl") is None:
            raise ToolkitError("motion 'ompl' needs OMPL: pip install 'rearrange-toolkit[arm]'")

    def plan(self, problem: MotionProblem, seed: int) -> Float | Failure:
        for what, q in (("start", problem.start), ("goal", problem.goal)):
            if not problem.free(q):
                return Failure("motion", f"the arm would touch something at the motion's {what}")
        rng = np.random.default_rng(seed)
        direct = np.stack([problem.start, problem.goal])
        if all(problem.free(q) for q in densify(direct, self.config.step_rad)):
            return direct
        found = self._search(problem, int(rng.integers(1, 2**31)))
        if found is None:
            return Failure("motion", f"no motion was found in {self.config.iterations} iterations")
        return shortcut(found, problem.free, self.config.step_rad, self.config.shortcuts, rng)

    def _search(self, problem: MotionProblem, seed: int) -> Float | None:
        # Any: its stubs type states and paths by their base classes, which lack what is used here.
        base, geometric, util = (cast(Any, importlib.import_module(f"ompl.{part}")) for part in _PARTS)
        util.setLogLevel(util.LogLevel.LOG_NONE)
        _seed(seed)
        dimensions = len(problem.start)
        space = base.RealVectorStateSpace(0)
        for low, high in zip(problem.lower.tolist(), problem.upper.tolist(), strict=True):
            space.addDimension(low, high)
        info = base.SpaceInformation(space)
        info.setStateValidityChecker(lambda state: bool(problem.free(np.array(state[0:dimensions]))))
        info.setStateValidityCheckingResolution(self.config.step_rad / space.getMaximumExtent())
        info.setup()
        ends: list[Any] = []
        for q in (problem.start, problem.goal):
            state = space.allocState()
            state[0:dimensions] = q.tolist()
            ends.append(state)
        definition = base.ProblemDefinition(info)
        definition.setStartAndGoalStates(*ends)
        planner = geometric.RRTConnect(info)
        planner.setRange(self.config.range_rad)
        planner.setProblemDefinition(definition)
        planner.setup()
        asked = count()
        planner.solve(base.PlannerTerminationCondition(lambda: next(asked) >= self.config.iterations))
        if not definition.hasExactSolution():
            return None
        return np.array([state[0:dimensions] for state in definition.getSolutionPath().getStates()])


def _seed(seed: int) -> None:
    """Seed OMPL's generators, which its Python bindings leave to the clock; only its C++ interface has a way to."""
    set_seed = getattr(_library(), _SET_SEED)
    set_seed.argtypes, set_seed.restype = [ctypes.c_ulong], None
    set_seed(seed)


@cache
def _library() -> ctypes.CDLL:
    import ompl

    (path,) = Path(str(ompl.__file__)).parent.glob("libompl.*")
    return ctypes.CDLL(str(path))
