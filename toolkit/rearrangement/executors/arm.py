"""A simulated arm with gravity, friction and contacts: grasps hold or slip, and what it touches is written down."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Literal

import numpy as np
from pydantic import Field

from toolkit.data.table import HALF_SIDE_M
from toolkit.data.tabletop import Studio, TabletopScene, filming_camera
from toolkit.geometry import invert, rotation_angle, rotation_z, transform_points
from toolkit.paths import cache_root
from toolkit.rearrangement.executors.handling.reach import Reach, Way
from toolkit.rearrangement.footprints import Footprint
from toolkit.rearrangement.moves import Outcome, PickPlace
from toolkit.rearrangement.stages import GRASPERS, MOTION, Executor
from toolkit.registry import Plugin, PluginConfig
from toolkit.sim.bench import STEP_S, Bench, Touch
from toolkit.sim.bullet import require_pybullet
from toolkit.sim.clearance import Clearance
from toolkit.sim.robot import Robot
from toolkit.sim.robots import ROBOTS
from toolkit.types import Failure, Float, Frame, Image

_RAYS = 64
_SETTLE_S, _GRIP_S, _RELEASE_S, _REST_S = 0.5, 0.8, 0.5, 0.5
_RAMP_S = 0.2
_GIVES_M, _GIVES_DEG = 0.02, 10.0
"""What moves further than this in the gripper while it is lifted is put back, before it is lost."""

_SQUEEZE = 0.25
"""How far beyond the contact the fingers are driven, as a part of their whole way."""


class ArmConfig(PluginConfig):
    """Settings of `arm`."""

    robot: Literal["gen3", "panda"] = Field("gen3", description="Kinova Gen3 with Robotiq 2F-85, or Franka Panda.")
    base_m: float = Field(0.52, gt=0, description="Distance of the robot's base from the table's centre.")
    grasp: str = Field("antipodal", description="Finds where to take hold: a name of the stage `grasp`.")
    motion: str = Field("ompl", description="Searches free motions: a name of the stage `motion`.")
    motion_s: float = Field(5.0, gt=0, description="Longest search for one motion, of processor time.")
    joint_speed: float = Field(0.8, gt=0, description="Of the fastest joint in free motion, rad/s.")
    line_speed: float = Field(0.25, gt=0, description="Of the fastest joint near objects, rad/s.")
    approach_m: float = Field(0.08, gt=0, description="Straight way to a grasp, and back from a place.")
    off_m: float = Field(0.02, gt=0, description="An object put further off than this has slipped, ...")
    off_deg: float = Field(10.0, gt=0, description="... and so has one that is turned by more than this.")


class Arm(Plugin[ArmConfig], Executor):
    """Picks and places with a simulated Gen3 or Panda; it looks through the predefined views.

    Planning knows where things are and what they are shaped like, as the simulator does; grasps come from the seen
    points alone, and what becomes of them is physics.
    """

    stage = "executor"
    name = "arm"

    on_step: Callable[[], None] | None = None
    """Called at every step of a motion, for films."""

    def check_ready(self) -> None:
        """See Plugin: the simulator, the robot's description, the motion planner and the grasper can be had."""
        require_pybullet()
        ROBOTS[self.config.robot].urdf()
        MOTION.get(self.config.motion)(None).check_ready()
        GRASPERS.get(self.config.grasp)(None).check_ready()

    def begin(self, task: TabletopScene) -> Frame:
        """See Executor; the task is a scene of the tabletop benchmark."""
        self.check_ready()
        self._task = task
        self._model = ROBOTS[self.config.robot]
        hulls = [asset.hulls for asset in task.assets]
        self._base = base_pose(self.config)
        self._bench = Bench(
            self._model, self._base, [(asset.hulls, asset.mass_kg) for asset in task.assets], task.current
        )
        self._bench.on_step = self._stepped
        self._scene = Clearance(self._model, self._base, hulls)
        self._motion = MOTION.create(self.config.motion, {"time_s": self.config.motion_s})
        sizes = ("stroke_m", "palm_m", "finger_length_m")
        gripper = {size: getattr(self._model, size) for size in sizes}
        self._grasper = GRASPERS.create(self.config.grasp, {"gripper": gripper, "approach_m": self.config.approach_m})
        self._studio = Studio(task, cache_root())
        self._stage: tuple[Studio, Robot] | None = None
        self._moves = self._steps = 0
        self._goal = self._studio.goal()
        self._bench.wait(_SETTLE_S, "settling", None)
        return self._goal

    @property
    def touches(self) -> list[Touch]:
        """Every contact so far that was not meant to be: arm or load against anything but the object and its place."""
        return self._bench.touches

    def close(self) -> None:
        """See Executor."""
        self._bench.close()
        self._scene.close()
        self._studio.close()
        if self._stage is not None:
            self._stage[0].close()

    def observe(self) -> list[Frame]:
        """See Executor: the wrist camera's pictures, in which the arm behind it is not seen."""
        return self._studio.current(self._bench.poses())

    def state(self) -> Mapping[int, Float]:
        """See Executor."""
        return dict(enumerate(self._bench.poses()))

    def home(self) -> None:
        """See Executor; where no motion leads there, it stays."""
        home = np.array(self._model.home)
        if np.abs(self._bench.target - home).max() < 1e-6:
            return
        self._back_off(None)
        self._scene.arrange(self._bench.poses(), self._bench.robot.drive)
        path = self._reach().motion(self._bench.target, home)
        if not isinstance(path, Failure):
            self._follow(path, self.config.joint_speed, "going home", None)

    def snapshot(self) -> Image:
        """(H, W, 3) picture of table and arm from beside the table, for films."""
        if self._stage is None:
            studio = Studio(self._task, cache_root())
            self._stage = studio, Robot(studio.client, self._model, self._base, pictures=True)
        studio, robot = self._stage
        robot.set(self._bench.robot.q)
        robot.set_drive(self._bench.robot.drive)
        return studio.picture(filming_camera(self._task.config), self._bench.poses())

    def goal_picture(self) -> Image:
        """See Filmable."""
        return self._goal.rgb

    def pick_place(self, request: PickPlace) -> Outcome:
        """See Executor."""
        start = self._bench.seconds
        points = request.points[:: max(1, len(request.points) // _RAYS)]
        number = self._bench.under(points)
        if number is None:
            return Outcome(Failure("executor", "there is no object where it was to be picked"))
        self._moves += 1
        failure = self._carry_out(number, request)
        return Outcome(failure, number, self._bench.seconds - start)

    def _carry_out(self, number: int, request: PickPlace) -> Failure | None:
        goal = transform_points(request.T_place_pick, request.points)
        if np.abs(Footprint.of(goal).center).max() > HALF_SIDE_M:
            return Failure("executor", "the place lies beyond the table's edge")
        grasps = self._grasper.grasp(request, self._moves)
        if isinstance(grasps, Failure):
            wide = Footprint.of(request.points).width
            if wide <= self._model.stroke_m:
                return grasps
            opens = 100 * self._model.stroke_m
            return Failure("executor", f"the object is {100 * wide:.1f} cm wide, the gripper opens {opens:.1f} cm")
        self._back_off(number)
        poses = self._bench.poses()
        way = self._reach().plan(self._bench.target, number, poses, grasps, request.T_place_pick)
        return way if isinstance(way, Failure) else self._execute(way, number, request.T_place_pick @ poses[number])

    def _back_off(self, number: int | None) -> None:
        """Leave what came to lean on the arm: no motion starts in a contact."""
        self._scene.arrange(self._bench.poses(), self._bench.robot.drive)
        path = self._reach().way_out(self._bench.target)
        if len(path) > 1:
            self._follow(path, self.config.line_speed, "backing off", number)

    def _reach(self) -> Reach:
        return Reach(self._scene, self._motion, self.config.approach_m, self._moves)

    def _execute(self, way: Way, number: int, wanted: Float) -> Failure | None:
        """Carry a way out; afterwards, say what became of the object."""
        bench, fast, slow = self._bench, self.config.joint_speed, self.config.line_speed
        bench.grip = bench.robot.drive_for(way.opening)
        self._follow(way.to_grasp, fast, "going to the grasp", None)
        self._follow(way.approach, slow, "approaching", number)
        self._close(number)
        in_hand = self._in_hand(number)
        self._follow(way.lift, slow, "lifting", number)
        if lost := self._lost(number, in_hand):
            self._put_back(way, number)
            return Failure("executor", f"the object {lost} the gripper while it was lifted")
        way = self._reach().adapted(way, number, bench.poses(), self._in_hand(number), wanted)
        self._follow(way.transfer, fast, "carrying", number)
        if not bench.held(number):
            self._let_go(way, way.lower[0], number)
            return Failure("executor", "the object slipped out of the gripper while it was carried")
        self._follow(way.lower, slow, "lowering", number, until=lambda: bench.on_table(number))
        bench.wait(0.1, "lowering", number)
        self._let_go(way, bench.target, number)
        self._follow(np.concatenate([bench.target[None], way.retreat[1:]]), slow, "retreating", number)
        bench.wait(_REST_S, "resting", number)
        return self._off(bench.pose(number), wanted)

    def _close(self, number: int) -> None:
        """Close until the fingers stop, then press."""
        bench = self._bench
        opened, closed = self._model.drive
        pace = (closed - opened) * STEP_S / _GRIP_S
        while not bench.held(number) and abs(bench.grip - closed) > abs(pace):
            bench.grip += pace
            bench.wait(STEP_S, "grasping", number)
        bench.grip = bench.robot.drive + _SQUEEZE * (closed - opened)
        bench.wait(0.3, "grasping", number)

    def _put_back(self, way: Way, number: int) -> None:
        """Set down what was lifted, where it came from."""
        bench = self._bench
        self._follow(way.lift[::-1], self.config.line_speed, "putting back", number, lambda: bench.on_table(number))
        self._let_go(way, bench.target, number)
        back = np.concatenate([bench.target[None], way.approach[::-1]])
        self._follow(back, self.config.line_speed, "retreating", number)

    def _let_go(self, way: Way, q: Float, number: int) -> None:
        """Open as far as there is room for; what has turned and sticks between the fingers, as far as it takes."""
        self._open(self._bench.robot.drive_for(way.opening), q, number)
        if self._bench.held(number):
            self._open(self._model.drive[0], q, number)

    def _open(self, drive: float, q: Float, number: int) -> None:
        start = self._bench.grip
        for part in np.linspace(0, 1, round(_RELEASE_S / STEP_S)):
            self._bench.grip = (1 - part) * start + part * drive
            self._bench.step(q, np.zeros(len(q)), "releasing", number)

    def _lost(self, number: int, in_hand: Float) -> str | None:
        """What has become of the hold on an object, which was at a (4, 4) pose in the hand; None if nothing."""
        now = self._in_hand(number)
        if not self._bench.held(number) or np.linalg.norm(now[:3, 3] - in_hand[:3, 3]) > _GIVES_M:
            return "slipped in"
        turned = np.degrees(rotation_angle(now[:3, :3] @ in_hand[:3, :3].T))
        return "turned in" if turned > _GIVES_DEG else None

    def _in_hand(self, number: int) -> Float:
        """(4, 4) an object's pose in the hand's frame."""
        return invert(self._bench.robot.T_world_hand()) @ self._bench.pose(number)

    def _off(self, pose: Float, wanted: Float) -> Failure | None:
        shift = float(np.linalg.norm(pose[:3, 3] - wanted[:3, 3]))
        turn = float(np.degrees(rotation_angle(pose[:3, :3] @ wanted[:3, :3].T)))
        if shift <= self.config.off_m and turn <= self.config.off_deg:
            return None
        return Failure("executor", f"the object slipped: it lies {100 * shift:.1f} cm and {turn:.0f} deg off its place")

    def _follow(
        self,
        path: Float,
        speed: float,
        phase: str,
        allowed: int | None,
        until: Callable[[], bool] | None = None,
    ) -> None:
        """Drive along an (N, J) path, the fastest joint at `speed` rad/s, with a soft start and end."""
        way = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(path, axis=0)).max(axis=1))])
        keep = np.concatenate([[True], np.diff(way) > 1e-9])
        path, way = path[keep], way[keep]
        seconds = way[-1] / speed + _RAMP_S
        count = max(2, round(seconds / STEP_S))
        times = np.linspace(0, seconds, count + 1)[1:]
        ramped = _ramp(times) - _ramp(times - (seconds - _RAMP_S))
        along = way[-1] * ramped / ramped[-1] if way[-1] > 0 else np.zeros(count)
        targets = np.stack([np.interp(along, way, column) for column in path.T], axis=1)
        velocities = np.gradient(targets, STEP_S, axis=0)
        for q, velocity in zip(targets, velocities, strict=True):
            self._bench.step(q, velocity, phase, allowed)
            if until is not None and until():
                break

    def _stepped(self) -> None:
        self._steps += 1
        if self.on_step is not None and self._steps % 16 == 0:
            self.on_step()


def base_pose(config: ArmConfig) -> Float:
    """(4, 4) where the robot stands: at the edge below the home view, facing the table's middle."""
    base = rotation_z(np.pi / 2)
    base[:3, 3] = [0, -config.base_m, 0]
    return base


def _ramp(t: Float) -> Float:
    """Way at unit speed, reached evenly over the ramp's time."""
    t = np.maximum(t, 0)
    return np.where(t < _RAMP_S, t * t / (2 * _RAMP_S), t - _RAMP_S / 2)
