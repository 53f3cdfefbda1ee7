"""Table and arm as they are seen: from beside the table, for films, and by the camera in the arm's own hand."""

from __future__ import annotations

from toolkit.data.cameras import filming_camera
from toolkit.data.scenery.props import AWAY
from toolkit.data.tabletop import Studio, TabletopScene
from toolkit.paths import cache_root
from toolkit.sim.bench import Bench
from toolkit.sim.robot import Robot
from toolkit.sim.robots import RobotModel
from toolkit.types import Camera, Float, Frame, Image

_NEAR_M = 0.02
"""A camera in the hand sees the fingers."""


class FilmSet:
    """A second table with the same objects and an arm, which are only looked at; close it after use.

    Args:
        task: what stands on the table.
        model: the robot.
        T_world_base: (4, 4) where it stands.
    """

    def __init__(self, task: TabletopScene, model: RobotModel, T_world_base: Float) -> None:
        self._task = task
        self._goal: Image | None = None
        self._studio = Studio(task, cache_root(), _NEAR_M)
        self._camera = filming_camera(task.config.resolution)
        self._robot = Robot(self._studio.client, model, T_world_base, pictures=True)

    def frame(self, T_world_camera: Float, bench: Bench) -> Frame:
        """An RGB-D frame by a camera like those of the task, at a (4, 4) pose, with everything as it is on a bench."""
        self._follow(bench)
        like = self._task.cameras[0]
        return self._studio.frame(Camera(like.K, T_world_camera, like.width, like.height), bench.poses())

    def picture(self, bench: Bench) -> Image:
        """(H, W, 3) uint8, with everything where it is on a bench now."""
        self._follow(bench)
        return self._studio.picture(self._camera, bench.poses())

    def goal(self, bench: Bench) -> Image:
        """(H, W, 3) uint8, with every object at its goal, and the arm where it was when this was first asked for."""
        if self._goal is None:
            self._follow(bench)
            gone = [AWAY] * (len(self._task.assets) - len(self._task.goal))
            self._goal = self._studio.picture(self._camera, [*self._task.goal, *gone])
        return self._goal

    def close(self) -> None:
        """Leave the simulator."""
        self._studio.close()

    def _follow(self, bench: Bench) -> None:
        """Put the arm where it is on a bench."""
        self._robot.set(bench.robot.q)
        self._robot.set_drive(bench.robot.drive)
