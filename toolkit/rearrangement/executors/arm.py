"""A simulated arm with gravity, friction and contacts: grasps hold or slip, and what it touches is written down."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import ExitStack, closing
from functools import cached_property, partial
from typing import Annotated

import numpy as np
from pydantic import BeforeValidator, Field

from toolkit.data.tabletop import Studio, TabletopScene
from toolkit.geometry import invert, rotation_angle, rotation_z, transform_points
from toolkit.paths import cache_root
from toolkit.rearrangement.executors.handling.film_set import FilmSet
from toolkit.rearrangement.executors.handling.mover import Mover
from toolkit.rearrangement.executors.handling.reach import Reach
from toolkit.rearrangement.footprints import Footprint
from toolkit.rearrangement.moves import GraspRequest, Outcome, PickPlace
from toolkit.rearrangement.stages import GRASPERS, MOTION_PLANNERS, Executor, Grasper, MotionPlanner
from toolkit.registry import Plugin, PluginConfig, StageChoice
from toolkit.sim.bench import Bench, Touch
from toolkit.sim.bullet import require_pybullet
from toolkit.sim.clearance import Clearance
from toolkit.sim.roboplan import require_roboplan
from toolkit.sim.robots import RobotModel, find_robot
from toolkit.sim.urdf import require_parts
from toolkit.types import Failure, Float, Frame, Image

_RAYS = 64
_SETTLE_S = 0.5
_STEPS_A_CALL = 16
"""Steps of the simulation between two calls of `on_step`."""


class ArmConfig(PluginConfig):
    """Settings of `arm`."""

    robot: str = Field(
        "gen3", description="`gen3` (Kinova Gen3 with Robotiq 2F-85), `panda`, or the folder of a robot."
    )
    base_m: float = Field(0.52, gt=0, description="Distance of the robot's base from the table's centre.")
    grasp: Annotated[StageChoice, BeforeValidator(partial(GRASPERS.choose, default="antipodal"))] = Field(
        "antipodal", validate_default=True, description="Finds where to take hold: a choice of the stage `grasp`."
    )
    motion: Annotated[StageChoice, BeforeValidator(partial(MOTION_PLANNERS.choose, default="roboplan"))] = Field(
        "roboplan", validate_default=True, description="Searches free paths: a choice of the stage `motion`."
    )
    joint_speed: float = Field(0.8, gt=0, description="Speed of the fastest joint in free motion, rad/s.")
    line_speed: float = Field(0.25, gt=0, description="Speed of the fastest joint near objects, rad/s.")
    approach_m: float = Field(
        0.08, gt=0, description="Length of the straight way to a grasp, and of the way back from a place."
    )
    margin_m: float = Field(
        0.002, ge=0, description="Everything that the arm must not touch is this much larger than it was seen."
    )
    off_m: float = Field(
        0.02, gt=0, description="An object that ends further than this from where it was to be put has slipped."
    )
    off_deg: float = Field(
        10.0, gt=0, description="An object that ends turned by more than this from how it was to be put has slipped."
    )


class Arm(Plugin[ArmConfig], Executor):
    """Picks and places with a simulated Gen3 or Panda; it looks through the predefined views.

    Planning knows the seen points and nothing else: what nobody saw below or behind them counts as full. What becomes
    of a plan is physics. Of an object that was lifted, it measures how it lies in the hand, and of one that was let go,
    where that left it.
    """

    stage = "executor"
    name = "arm"

    on_step: Callable[[], None] | None = None
    """Called at every few steps of a move, for films."""

    moves: int = 0
    """Moves begun so far."""

    def __init__(self, config: ArmConfig | None = None) -> None:
        super().__init__(config)
        self._opened = ExitStack()

    def check_ready(self) -> None:
        """Raise ToolkitError unless simulator, RoboPlan, the robot's description and both chosen stages can be had."""
        require_pybullet()
        require_roboplan()
        require_parts(self._model)
        for part in self._parts:
            part.check_ready()

    def digests(self) -> dict[str, str]:
        """Return digests of the weights of the grasper and of the motion planner, by name."""
        return {name: sha256 for part in self._parts for name, sha256 in part.digests().items()}

    @property
    def _parts(self) -> list[Plugin]:
        return [part for part in (self._grasper, self._planner) if isinstance(part, Plugin)]

    @cached_property
    def _grasper(self) -> Grasper:
        return GRASPERS.create(self.config.grasp.name, self.config.grasp.settings)

    @cached_property
    def _planner(self) -> MotionPlanner:
        return MOTION_PLANNERS.create(self.config.motion.name, self.config.motion.settings)

    @cached_property
    def _model(self) -> RobotModel:
        return find_robot(self.config.robot)

    def begin(self, task: TabletopScene) -> Frame:
        """Build the benchmark's scene in the simulator, with the arm at its home, and return the goal image."""
        self.check_ready()
        self.close()
        self._task = task
        self.moves = self._steps = 0
        base = base_pose(self.config)
        bodies = [(asset.hulls, asset.mass_kg) for asset in task.assets]
        with ExitStack() as opened:
            self._bench = opened.enter_context(closing(Bench(self._model, base, bodies, task.current)))
            self._clearance = Clearance(self._bench.robot, self.config.margin_m)
            self._studio = opened.enter_context(Studio(task, cache_root()))
            self._goal = self._studio.goal()
            fast, slow = (
                min(speed, self._model.file.speed) for speed in (self.config.joint_speed, self.config.line_speed)
            )
            self._mover = Mover(self._bench, fast, slow)
            self._film_set: FilmSet | None = None
            self._bench.on_step = self._stepped
            self._bench.wait(_SETTLE_S, "settling", None)
            self._opened = opened.pop_all()
        return self._goal

    @property
    def touches(self) -> list[Touch]:
        """Every contact so far that was not meant to be: arm or load against anything but the object and its place."""
        return self._bench.touches

    def close(self) -> None:
        self._opened.close()

    def observe(self) -> list[Frame]:
        """Return the wrist camera's frames from the predefined views; the arm, which is behind it, is in none."""
        return self._studio.current(self._bench.poses())

    def state(self) -> Mapping[int, Float]:
        return dict(enumerate(self._bench.poses()))

    def home(self) -> None:
        """Move the arm to its home, out of the cameras' sight; where no path leads there, it stays."""
        home = np.array(self._model.home)
        if np.abs(self._bench.target - home).max() < 1e-6:
            return
        reach = self._reach()
        self._back_off(reach, None)
        path = reach.free_path(self._bench.target, home)
        if not isinstance(path, Failure):
            self._mover.go_home(path)

    def snapshot(self) -> Image:
        """(H, W, 3) picture of table and arm from beside the table, for films."""
        return self._filming().picture(self._bench)

    def goal_snapshot(self) -> Image:
        return self._filming().goal(self._bench)

    def _filming(self) -> FilmSet:
        if self._film_set is None:
            film_set = FilmSet(self._task, self._model, base_pose(self.config))
            self._film_set = self._opened.enter_context(closing(film_set))
        return self._film_set

    def goal_picture(self) -> Image:
        return self._goal.rgb

    def pick_place(self, request: PickPlace) -> Outcome:
        start = self._bench.seconds
        number = self._bench.under(request.points[:: max(1, len(request.points) // _RAYS)])
        if number is None:
            return Outcome(Failure("executor", "there is no object where it was to be picked"))
        self.moves += 1
        before = self._bench.pose(number)
        failure = self._carry_out(number, request)
        moved = self._bench.pose(number) @ invert(before)
        return Outcome(failure, number, self._bench.seconds - start, moved if self._bench.seconds > start else None)

    def _carry_out(self, number: int, request: PickPlace) -> Failure | None:
        goal = transform_points(request.T_place_pick, request.points)
        if not self._task.table.holds(Footprint.of(goal).center):
            return Failure("executor", "the place lies beyond the table's edge")
        asked = GraspRequest.of(request, self._model.gripper, self.config.approach_m)
        grasps = self._grasper.grasp(asked, self.moves)
        if isinstance(grasps, Failure):
            wide, opens = Footprint.of(request.points).width, self._model.gripper.stroke_m
            if wide <= opens:
                return grasps
            reason = f"the object is {100 * wide:.1f} cm wide, the gripper opens {100 * opens:.1f} cm"
            return Failure("executor", reason)
        self._clearance.see(request.points, request.others)
        reach = self._reach()
        self._back_off(reach, number)
        before = self._bench.pose(number)
        way = reach.plan(self._bench.target, grasps, request.T_place_pick)
        if isinstance(way, Failure):
            return way
        failure = self._mover.carry_out(way, number, request.T_place_pick, reach)
        moved = self._bench.pose(number) @ invert(before)
        self._clearance.see(transform_points(moved, request.points), request.others)
        return failure or self._slipped(self._bench.pose(number), request.T_place_pick @ before)

    def _back_off(self, reach: Reach, number: int | None) -> None:
        """Leave what came to lean on the arm: no path starts in a contact."""
        self._clearance.arrange(self._bench.robot.drive)
        self._mover.back_off(reach.way_out(self._bench.target), number)

    def _reach(self) -> Reach:
        return Reach(self._clearance, self._planner, self.config.approach_m, self.moves)

    def _slipped(self, pose: Float, wanted: Float) -> Failure | None:
        shift = float(np.linalg.norm(pose[:3, 3] - wanted[:3, 3]))
        turn = float(np.degrees(rotation_angle(pose[:3, :3] @ wanted[:3, :3].T)))
        if shift <= self.config.off_m and turn <= self.config.off_deg:
            return None
        return Failure("executor", f"the object slipped: it lies {100 * shift:.1f} cm and {turn:.0f} deg off its place")

    def _stepped(self) -> None:
        self._steps += 1
        if self.on_step is not None and self._steps % _STEPS_A_CALL == 0:
            self.on_step()


def base_pose(config: ArmConfig) -> Float:
    """(4, 4) where the robot stands: at the edge below the home view, facing the table's middle."""
    base = rotation_z(np.pi / 2)
    base[:3, 3] = [0, -config.base_m, 0]
    return base
