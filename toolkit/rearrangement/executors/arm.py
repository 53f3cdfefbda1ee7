"""A simulated arm with gravity, friction and contacts: grasps hold or slip, and what it touches is written down."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import ExitStack, closing, suppress
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
from pydantic import Field

from toolkit.data.tabletop import Studio, TabletopScene
from toolkit.geometry import invert, rotation_angle, rotation_z, transform_points
from toolkit.paths import cache_root
from toolkit.rearrangement.drivers import DriverError
from toolkit.rearrangement.executors.drivers.simulated import Simulated
from toolkit.rearrangement.executors.handling.film_set import FilmSet
from toolkit.rearrangement.executors.handling.looking import Look
from toolkit.rearrangement.executors.handling.mover import Eye, Mover
from toolkit.rearrangement.executors.handling.planning import ArmPlanner, ArmSettings, Tools
from toolkit.rearrangement.executors.handling.reach import Reach
from toolkit.rearrangement.executors.handling.regrasp import steps_of
from toolkit.rearrangement.footprints import Footprint
from toolkit.rearrangement.moves import Outcome, PickPlace
from toolkit.rearrangement.plans import Way
from toolkit.rearrangement.stages import Executor
from toolkit.registry import Plugin
from toolkit.sim.bench import Bench, Touch
from toolkit.types import Failure, Float, Frame, Image

_RAYS = 64
_SETTLE_S, _REST_S = 0.5, 0.5
_AT_HOME_RAD = 0.01
_STEPS_A_CALL = 16
"""Steps of the simulation between two calls of `on_step`."""


class ArmConfig(ArmSettings):
    """Settings of `arm`."""

    base_m: float = Field(0.52, gt=0, description="Distance of the robot's base from the table's centre.")
    off_m: float = Field(
        0.02, gt=0, description="An object that ends further than this from where it was to be put has slipped."
    )
    off_deg: float = Field(
        10.0, gt=0, description="An object that ends turned by more than this from how it was to be put has slipped."
    )
    look: Literal["seen", "measured"] = Field(
        "seen",
        description="How it learns how an object lies in the hand and where it came to stand: `seen` by its camera, or "
        "`measured` in the simulator, as no robot can.",
    )


class Arm(Plugin[ArmConfig], Executor):
    """Picks and places with a simulated Gen3 or Panda; it looks through the predefined views.

    Planning knows the seen points and nothing else: what nobody saw below or behind them counts as full. What becomes
    of a plan is physics. With the camera in the hand it looks how an object that was lifted lies there, and where one
    that was let go came to stand.
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
        self.tools.check_ready()

    def digests(self) -> dict[str, str]:
        """Return digests of the weights of the grasper and of the motion planner, by name."""
        return self.tools.digests()

    @cached_property
    def tools(self) -> Tools:
        """What it plans with."""
        return Tools(self.config)

    def begin(self, task: TabletopScene) -> Frame:
        """Build the benchmark's scene in the simulator, with the arm at its home, and return the goal image."""
        self.check_ready()
        self.close()
        self._task = task
        self.moves = self._steps = 0
        model, base = self.tools.model, base_pose(self.config)
        bodies = [(asset.hulls, asset.mass_kg) for asset in task.assets]
        with ExitStack() as opened:
            self._bench = opened.enter_context(closing(Bench(model, base, bodies, task.current)))
            self._planner = ArmPlanner(self.tools, self._bench.robot)
            self._studio = opened.enter_context(Studio(task, cache_root()))
            self._goal = self._studio.goal()
            self._driver = Simulated(self._bench, self._shoot)
            self._mover = Mover(self._driver, self.tools.limits, model.gripper.stroke_m)
            self._film_set: FilmSet | None = None
            self._bench.on_step = self._stepped
            self._bench.wait(_SETTLE_S, "settling", None)
            self._opened = opened.pop_all()
        return self._goal

    def _shoot(self, T_world_camera: Float) -> Frame:
        """What the arm's camera sees from a pose."""
        return self._filming().frame(T_world_camera, self._bench)

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
        if np.abs(self._q - np.array(self.tools.model.home)).max() < _AT_HOME_RAD:
            return
        with suppress(DriverError):
            self._back_off(None)
            way = self._planner.to_home(self._q, self.moves)
            if not isinstance(way, Failure):
                self._mover.follow(way, "going home", touching=False)

    @property
    def _q(self) -> Float:
        return self._driver.state().positions

    def snapshot(self) -> Image:
        """(H, W, 3) picture of table and arm from beside the table, for films."""
        return self._filming().picture(self._bench)

    def goal_snapshot(self) -> Image:
        return self._filming().goal(self._bench)

    def _filming(self) -> FilmSet:
        if self._film_set is None:
            film_set = FilmSet(self._task, self.tools.model, base_pose(self.config))
            self._film_set = self._opened.enter_context(closing(film_set))
        return self._film_set

    def goal_picture(self) -> Image:
        return self._goal.rgb

    def pick_place(self, request: PickPlace) -> Outcome:
        start = self._bench.seconds
        number = self._bench.under(request.points[:: max(1, len(request.points) // _RAYS)])
        if number is None:
            return Outcome(Failure("executor", "there is no object where it was to be picked"))
        touches, begun = len(self.touches), self.moves
        failure, moved = self._carry_out(number, request)
        seconds, picks = self._bench.seconds - start, self.moves - begun
        return Outcome(failure, number, seconds, moved, len(self.touches) > touches, picks)

    def _carry_out(self, number: int, request: PickPlace) -> tuple[Failure | None, Float | None]:
        """What went wrong, and the (4, 4) motion that the object has had, where it is known."""
        self.moves += 1
        if not self._task.table.holds(Footprint.of(transform_points(request.T_place_pick, request.points)).center):
            return Failure("executor", "the place lies beyond the table's edge"), None
        self._planner.see(request)
        with suppress(DriverError):
            self._back_off(number)
        steps = steps_of(self._planner, request, self._q, self.moves)
        if isinstance(steps, Failure):
            return steps, None
        failure, moved = self._move(number, replace(request, T_place_pick=steps[0].T_place_pick), steps[0].way)
        if failure is not None or len(steps) == 1:
            return failure, moved
        aside = steps[0].T_place_pick if moved is None else moved
        onward = request.after(aside)
        self.moves += 1
        way = self._planner.plan(onward, self._q, self.moves)  # from where it has come to stand
        failure, moved = (way, None) if isinstance(way, Failure) else self._move(number, onward, way)
        if moved is None:
            return failure, aside if failure is not None else None
        return failure, moved @ aside

    def _move(self, number: int, request: PickPlace, way: Way) -> tuple[Failure | None, Float | None]:
        """Take an object along a way; what went wrong, and the motion that it has had, where it is known."""
        wanted = request.T_place_pick
        eye = self._eye(number, request, self._planner.reach(self.moves))
        try:
            failure = self._mover.carry_out(way, eye)
        except DriverError as error:  # in a simulator nothing is lost by going on
            return Failure("executor", str(error)), None
        self._bench.wait(_REST_S, "resting", number)
        expected = wanted if failure is None else np.eye(4)
        moved = eye.placed(expected)
        stands = expected if isinstance(moved, Failure) else moved
        self._planner.see(request.after(stands))
        if isinstance(moved, Failure):
            return failure, None
        return failure or self._slipped(request.points.mean(axis=0), moved, wanted), moved

    def _eye(self, number: int, request: PickPlace, reach: Reach) -> Eye:
        if self.config.look == "measured":
            return _Measured(self._bench, number, reach, request.T_place_pick)
        return Look(self._driver, self._bench.robot, request, reach)

    def _back_off(self, number: int | None) -> None:
        """Leave what came to lean on the arm, which may be object `number`: no path starts in a contact."""
        self._driver.handled = number
        self._planner.clearance.arrange(self._bench.robot.drive)
        way = self._planner.reach(self.moves).way_out(self._q)
        if way.seconds > 0:
            self._mover.follow(way, "backing off")

    def _slipped(self, middle: Float, moved: Float, wanted: Float) -> Failure | None:
        """Say how far off its place an object lies whose (3,) middle was moved by other than the (4, 4) wanted."""
        shift = float(np.linalg.norm(transform_points(moved, middle) - transform_points(wanted, middle)))
        turn = float(np.degrees(rotation_angle(moved[:3, :3] @ wanted[:3, :3].T)))
        if shift <= self.config.off_m and turn <= self.config.off_deg:
            return None
        return Failure("executor", f"the object slipped: it lies {100 * shift:.1f} cm and {turn:.0f} deg off its place")

    def _stepped(self) -> None:
        self._steps += 1
        if self.on_step is not None and self._steps % _STEPS_A_CALL == 0:
            self.on_step()


@dataclass
class _Measured(Eye):
    """Knows, as nothing but a simulator can, how an object lies in the hand and where it came to stand."""

    bench: Bench
    number: int
    reach: Reach
    wanted: Float

    def __post_init__(self) -> None:
        self._T_object_seen = invert(self.bench.pose(self.number))

    def expected(self) -> Float:
        return self.in_hand(np.eye(4))

    def in_hand(self, expected: Float) -> Float:
        return invert(self.bench.robot.T_world_hand()) @ self.placed(expected)

    def adapted(self, way: Way, in_hand: Float) -> Way | Failure:
        return self.reach.adapted(way, in_hand, self.wanted)

    def placed(self, expected: Float) -> Float:
        return self.bench.pose(self.number) @ self._T_object_seen


def base_pose(config: ArmConfig) -> Float:
    """(4, 4) where the robot stands: at the edge below the home view, facing the table's middle."""
    base = rotation_z(np.pi / 2)
    base[:3, 3] = [0, -config.base_m, 0]
    return base
