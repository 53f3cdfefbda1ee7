"""From a move that is asked for to an arm's way, against what was seen: the same for simulation, plan and robot."""

from __future__ import annotations

from functools import partial
from typing import Annotated

import numpy as np
from pydantic import BeforeValidator, Field

from toolkit.rearrangement.executors.handling.reach import Reach
from toolkit.rearrangement.executors.handling.timing import Timer
from toolkit.rearrangement.footprints import Footprint
from toolkit.rearrangement.moves import Grasp, GraspRequest, PickPlace
from toolkit.rearrangement.plans import Way
from toolkit.rearrangement.stages import GRASPERS, MOTION_PLANNERS, Grasper, MotionPlanner
from toolkit.rearrangement.trajectories import Limits, Trajectory
from toolkit.registry import Plugin, PluginConfig, StageChoice
from toolkit.sim.bullet import require_pybullet
from toolkit.sim.clearance import Clearance
from toolkit.sim.roboplan import require_roboplan
from toolkit.sim.robot import Robot
from toolkit.sim.robots import RobotModel, find_robot
from toolkit.sim.urdf import require_parts
from toolkit.types import Failure, Float


class ArmSettings(PluginConfig):
    """What an arm is, and how it plans."""

    robot: str = Field(
        "gen3", description="`gen3` (Kinova Gen3 with Robotiq 2F-85), `panda`, or the folder of a robot."
    )
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


class Tools:
    """What an arm plans with, made ready once for any number of tasks.

    Args:
        settings: which robot, which grasps, which paths.

    Raises:
        ToolkitError: there is no such robot.
    """

    def __init__(self, settings: ArmSettings) -> None:
        self.settings = settings
        self.model: RobotModel = find_robot(settings.robot)
        self.grasper: Grasper = GRASPERS.create(settings.grasp.name, settings.grasp.settings)
        self.planner: MotionPlanner = MOTION_PLANNERS.create(settings.motion.name, settings.motion.settings)

    @property
    def limits(self) -> Limits:
        """What the robot is not to exceed."""
        file = self.model.file
        return Limits(speed=file.speed, acceleration=file.acceleration, effort=file.gripper.force)

    def check_ready(self) -> None:
        """Raise ToolkitError unless PyBullet, RoboPlan, the robot's description and both stages can be had."""
        require_pybullet()
        require_roboplan()
        require_parts(self.model)
        for part in self._parts:
            part.check_ready()

    def digests(self) -> dict[str, str]:
        """Digests of the weights of the grasper and of the motion planner, by name."""
        return {name: sha256 for part in self._parts for name, sha256 in part.digests().items()}

    @property
    def _parts(self) -> list[Plugin]:
        return [part for part in (self.grasper, self.planner) if isinstance(part, Plugin)]


class ArmPlanner:
    """Plans the moves of one arm in one place. It knows seen points and nothing else.

    Args:
        tools: what it plans with.
        robot: the arm where it stands; its description is read, and it is not moved.

    Raises:
        ToolkitError: RoboPlan cannot read the robot's description.
    """

    def __init__(self, tools: Tools, robot: Robot) -> None:
        settings = self._settings = tools.settings
        self._tools = tools
        self.clearance = Clearance(robot, settings.margin_m)
        self._timer = Timer(self.clearance, tools.limits, settings.joint_speed, settings.line_speed)

    def see(self, request: PickPlace) -> None:
        """Take what a move is told of for what is there now."""
        self.clearance.see(request.points, request.others, request.empty)

    def grasps(self, request: PickPlace, seed: int) -> list[Grasp] | Failure:
        """Where to take hold, best first; what was seen is arranged for the ways that follow."""
        gripper = self._tools.model.gripper
        asked = GraspRequest.of(request, gripper, self._settings.approach_m)
        grasps = self._tools.grasper.grasp(asked, seed)
        self.see(request)
        wide, opens = Footprint.of(request.points).width, gripper.stroke_m
        if isinstance(grasps, Failure) and wide > opens:
            reason = f"the object is {100 * wide:.1f} cm wide, the gripper opens {100 * opens:.1f} cm"
            return Failure("executor", reason)
        return grasps

    def plan(self, request: PickPlace, q: Float, seed: int) -> Way | Failure:
        """The way of one move, from (J,) joint angles."""
        grasps = self.grasps(request, seed)
        return grasps if isinstance(grasps, Failure) else self.reach(seed).plan(q, grasps, request.T_place_pick)

    def to_home(self, q: Float, seed: int) -> Trajectory | Failure:
        """A free path home from (J,) joint angles, among what was seen, with the fingers as they were arranged."""
        arranged = partial(self.clearance.arrange, self.clearance.drive)
        return self.reach(seed).free_path(q, np.array(self._tools.model.home), arranged)

    def reach(self, seed: int) -> Reach:
        """Ways among what is arranged."""
        return Reach(self.clearance, self._tools.planner, self._timer, self._settings.approach_m, seed)
