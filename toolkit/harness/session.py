"""One scene after another with the same models and compiled code: what a robot's program keeps open."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from toolkit.errors import ToolkitError
from toolkit.geometry import invert
from toolkit.harness.experiment import Cell, load_experiment, only_cell
from toolkit.harness.worker import make_runner, require_ready
from toolkit.perception.checks.capture import check_current, check_goal, doubted, refuse, together, usable
from toolkit.perception.database import Database
from toolkit.perception.scene import Scene
from toolkit.types import Finding, Frame, PoseEstimate


class Session:
    """An experiment's pipeline, held ready: `database` looks at a current scene, `estimate` at one goal after another.

    The same frames and goal give the same bytes, whatever the session saw before.

    Args:
        experiment: a shipped experiment's name, a YAML file, or settings that were read already.

    Attributes:
        findings: what was found wrong with the current frames and the last goal, worst first.

    Raises:
        ToolkitError: there is no such experiment, it makes several settings, or a stage lacks something.
    """

    def __init__(self, experiment: str | Path | Cell = "estimate") -> None:
        cell = experiment if isinstance(experiment, Cell) else only_cell(load_experiment(str(experiment)))
        require_ready([cell])
        self._runner = make_runner(cell, cache=None)
        self._scene: Scene | None = None
        self._of_frames: list[Finding] = []
        self.findings: list[Finding] = []

    @property
    def weights(self) -> dict[str, str]:
        """sha256 by name of the weights its stages use."""
        return self._runner.weights

    def database(self, frames: Sequence[Frame]) -> Database:
        """Check the current frames, and build the database of their scene.

        Raises:
            RefusedError: the frames cannot be right.
            ToolkitError: a stage refuses its input.
        """
        self._scene = None
        self._of_frames = check_current(frames)
        self.findings = self._of_frames
        refuse(self.findings)
        pipeline = self._runner.pipeline
        built = pipeline.build_database(usable(frames, self.findings))
        self._scene = pipeline.scene(built)
        return built

    def estimate(self, goal: Frame) -> list[PoseEstimate]:
        """Check a goal image, and estimate the motions towards it; none is surer than what was found allows.

        Raises:
            RefusedError: the goal cannot be right.
            ToolkitError: no database was built yet, or a stage refuses its input.
        """
        scene = self.scene
        # In the table's own frame, where it has been found already.
        level, T_world_level = scene.database.level, scene.database.T_world_level
        in_level = goal.moved(invert(T_world_level))
        self.findings = together(self._of_frames, check_goal(in_level, level.frames, T_world_level))
        refuse(self.findings)
        return doubted(scene.estimate(goal), self.findings)

    @property
    def scene(self) -> Scene:
        """The current scene, its instances as the last goal joined them; raises ToolkitError before `database`."""
        if self._scene is None:
            raise ToolkitError("the session has seen no current frames; call `database` first")
        return self._scene
