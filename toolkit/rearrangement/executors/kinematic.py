"""Objects moved rigidly, without an arm or forces, but never through each other: for studies at speed."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, closing

import numpy as np
from pydantic import Field
from scipy.spatial.transform import Rotation, Slerp
from typing_extensions import TypeVar

from toolkit.data.cameras import home_camera
from toolkit.data.layout import RestingObject, resting_poses
from toolkit.data.tabletop import Studio, TabletopScene
from toolkit.geometry import make_transform, transform_points
from toolkit.paths import cache_root
from toolkit.rearrangement.executors.handling.resting import settle
from toolkit.rearrangement.footprints import Footprint
from toolkit.rearrangement.moves import Outcome, PickPlace
from toolkit.rearrangement.stages import Executor
from toolkit.registry import Plugin, PluginConfig
from toolkit.sim.bullet import require_pybullet
from toolkit.sim.solids import Solids
from toolkit.types import Failure, Float, Frame, Image

_CLEAR_M = 0.05
"""Height of the transfer above the highest object."""

_GRASP_S = 1.0
_RAYS = 64


class KinematicConfig(PluginConfig):
    """Settings of `kinematic`."""

    gripper_width_m: float | None = Field(
        None, gt=0, description="Wider objects cannot be picked (0.085: Robotiq 2F-85); any width when left out."
    )
    speed_m_s: float = Field(0.25, gt=0, description="Speed of the hand, from which times follow.")
    step_m: float = Field(0.01, gt=0, description="Way between two collision checks.")
    touch_m: float = Field(0.001, ge=0, description="Objects that cut into each other deeper than this collide.")


KinematicConfigT = TypeVar("KinematicConfigT", bound=KinematicConfig, default=KinematicConfig, covariant=True)


class Kinematic(Plugin[KinematicConfigT], Executor):
    """Simulator without an arm: an object is lifted, carried over the others and lowered, checked all along the way."""

    stage = "executor"
    name = "kinematic"

    on_step: Callable[[], None] | None = None
    """Called at every step of a move, for films."""

    moves: int = 0
    """Moves begun so far."""

    def __init__(self, config: KinematicConfigT | None = None) -> None:
        super().__init__(config)
        self._opened = ExitStack()

    def check_ready(self) -> None:
        """Raise ToolkitError unless the simulator is installed."""
        require_pybullet()

    def begin(self, task: TabletopScene) -> Frame:
        """Put the benchmark scene's objects where they stand now, and return the goal image."""
        self.close()
        self.moves = 0
        self._table = task.table
        self._poses = list(task.current)
        self._rests: list[list[RestingObject]] = [resting_poses(asset) for asset in task.assets]
        self._home = home_camera(task.config.resolution)
        with ExitStack() as opened:
            self._solids = opened.enter_context(closing(Solids([asset.hulls for asset in task.assets])))
            for number, pose in enumerate(self._poses):
                self._solids.place(number, pose)
            self._studio = opened.enter_context(Studio(task, cache_root()))
            self._goal = self._studio.goal()
            self._opened = opened.pop_all()
        return self._goal

    def close(self) -> None:
        self._opened.close()

    def observe(self) -> list[Frame]:
        return self._studio.current(self._poses)

    def home(self) -> None:
        """Do nothing: there is no hand that could be in the way."""

    def state(self) -> Mapping[int, Float]:
        return dict(enumerate(self._poses))

    def snapshot(self) -> Image:
        return self._studio.picture(self._home, self._poses)

    def goal_snapshot(self) -> Image:
        return self.goal_picture()

    def goal_picture(self) -> Image:
        return self._goal.rgb

    def pick_place(self, request: PickPlace) -> Outcome:
        """Pick one object up and put it down elsewhere; one that would hit another goes back to where it was."""
        number = self._solids.under(_some(request.points))
        if number is None:
            return Outcome(Failure("executor", "there is no object where it was to be picked"))
        refusal = self._refuse(request)
        if refusal is not None:
            return Outcome(refusal, number)
        self.moves += 1
        start = self._poses[number]
        end = settle(request.T_place_pick @ start, self._rests[number])
        seconds = _GRASP_S
        for phase, way in self._phases(number, start, end):
            for pose in way:
                hit = self._move(number, pose)
                if hit:
                    self._move(number, start)
                    reason = f"{phase} object {number} would hit object {hit[0]}"
                    return Outcome(Failure("executor", reason), number, seconds)
            seconds += _length(way) / self.config.speed_m_s
        return Outcome(None, number, seconds)

    def _refuse(self, request: PickPlace) -> Failure | None:
        width = self.config.gripper_width_m
        footprint = Footprint.of(request.points)
        if width is not None and footprint.width > width:
            opens, wide = 100 * width, 100 * footprint.width
            return Failure("executor", f"the object is {wide:.1f} cm wide, the gripper opens {opens:.1f} cm")
        goal = transform_points(request.T_place_pick, request.points)
        if not self._table.holds(Footprint.of(goal).center):
            return Failure("executor", "the place lies beyond the table's edge")
        return None

    def _phases(self, number: int, start: Float, end: Float) -> Iterator[tuple[str, list[Float]]]:
        others = [self._solids.top(other) for other in range(len(self._poses)) if other != number]
        height = max(others, default=0.0) + _CLEAR_M
        up, down = _raised(start, height), _raised(end, height)
        yield "lifting", self._way(start, up)
        yield "carrying", self._way(up, down)
        yield "lowering", self._way(down, end)

    def _way(self, a: Float, b: Float) -> list[Float]:
        """Poses from `a` to `b` in steps of at most `step_m`, both included."""
        count = max(2, int(np.ceil(np.linalg.norm(b[:3, 3] - a[:3, 3]) / self.config.step_m)) + 1)
        parts = np.linspace(0, 1, count)
        turns = Slerp([0, 1], Rotation.from_matrix([a[:3, :3], b[:3, :3]]))(parts[1:-1]).as_matrix()
        between = [
            make_transform(R, (1 - part) * a[:3, 3] + part * b[:3, 3])
            for R, part in zip(turns, parts[1:-1], strict=True)
        ]
        return [a, *between, b]

    def _move(self, number: int, pose: Float) -> list[int]:
        """Put an object at a pose; returns what it cuts into there."""
        self._poses[number] = pose
        self._solids.place(number, pose)
        if self.on_step is not None:
            self.on_step()
        return self._solids.touching(number, self.config.touch_m)


def _raised(pose: Float, height: float) -> Float:
    raised = pose.copy()
    raised[2, 3] += height
    return raised


def _some(points: Float) -> Float:
    return points[:: max(1, len(points) // _RAYS)]


def _length(way: list[Float]) -> float:
    return float(np.linalg.norm(way[-1][:3, 3] - way[0][:3, 3]))
