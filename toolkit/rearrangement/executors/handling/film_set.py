"""Table and arm as they are seen from beside the table, for films."""

from __future__ import annotations

from toolkit.data.cameras import filming_camera
from toolkit.data.scenery.props import AWAY
from toolkit.data.tabletop import Studio, TabletopScene
from toolkit.paths import cache_root
from toolkit.sim.bench import Bench
from toolkit.sim.robot import Robot
from toolkit.sim.robots import RobotModel
from toolkit.types import Float, Image


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
        self._studio = Studio(task, cache_root())
        self._camera = filming_camera(task.config.resolution)
        self._robot = Robot(self._studio.client, model, T_world_base, pictures=True)

    def picture(self, bench: Bench) -> Image:
        """(H, W, 3) uint8, with everything where it is on a bench now."""
        self._robot.set(bench.robot.q)
        self._robot.set_drive(bench.robot.drive)
        return self._studio.picture(self._camera, bench.poses())

    def goal(self, bench: Bench) -> Image:
        """(H, W, 3) uint8, with every object at its goal, and the arm where it was when this was first asked for."""
        if self._goal is None:
            self._robot.set(bench.robot.q)
            gone = [AWAY] * (len(self._task.assets) - len(self._task.goal))
            self._goal = self._studio.picture(self._camera, [*self._task.goal, *gone])
        return self._goal

    def close(self) -> None:
        """Leave the simulator."""
        self._studio.close()
