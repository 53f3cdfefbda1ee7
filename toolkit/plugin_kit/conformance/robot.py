"""What a robot's folder must be right about, measured on its own description."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from itertools import product

import numpy as np

from toolkit.geometry import invert, transform_points
from toolkit.plugin_kit.conformance.kit import Outcome, require, run_check
from toolkit.sim.bullet import require_pybullet
from toolkit.sim.clearance import Clearance
from toolkit.sim.client import Client
from toolkit.sim.roboplan import require_roboplan
from toolkit.sim.robot import Robot
from toolkit.sim.robots import RobotModel
from toolkit.sim.urdf import require_parts

_OFF_M = 0.005
"""A gripper may open this much more or less than its robot.yaml says, and leave this much when closed."""

_FIELD_DEG = (69.0, 42.0)
"""A D435i's colour image, across and down."""

_RAYS = (9, 7)
_FAR_M = 3.0
_SEEN = 0.5
_HELD_M = (0.02, 0.01, 0.04)
"""Between the fingers, to both sides of its middle and below the tips: where a small object is held."""


def check_robot(model: RobotModel) -> list[Outcome]:
    """Run every check over a robot; one that fails does not keep the others from being run.

    Raises:
        ToolkitError: its files do not belong together: see `require_parts`; or there is no PyBullet or no RoboPlan to
            measure with.
    """
    require_pybullet()
    require_roboplan()
    require_parts(model)
    return [run_check(check, model) for check in CHECKS]


def it_stands_within_its_limits_at_home(model: RobotModel) -> str:
    """Every angle of `home` lies within its joint's limits."""
    with closing(Client()) as client:
        chain = Robot(client, model, np.eye(4)).chain
    for name, low, angle, high in zip(model.arm, chain.lower, model.home, chain.upper, strict=True):
        require(
            low <= angle <= high, f"`home` puts {name} at {angle:.2f} rad, and it goes from {low:.2f} to {high:.2f}"
        )
    return f"{len(model.arm)} joints"


def it_touches_nothing_at_home(model: RobotModel) -> None:
    """Neither itself nor the table it stands on."""
    from toolkit.sim.arm_scene import ArmScene

    with closing(Client()) as client:
        robot = Robot(client, model, np.eye(4))
    world = Clearance(robot, 0.0).world()
    (table,) = world.solids
    off_the_table = replace(world, allowed=world.allowed.union((table.name, link) for link in robot.names.values()))
    for around, hit in ((off_the_table, "itself"), (world, table.name)):
        scene = ArmScene(around, robot.chain.lower, robot.chain.upper)
        require(scene.free(np.array(model.home)), f"at `home` the arm touches {hit}")


def its_gripper_opens_and_closes(model: RobotModel) -> str:
    """The fingertips are `stroke_m` apart when it is open, and meet when it is closed."""
    with closing(Client()) as client:
        opened, closed = Robot(client, model, np.eye(4)).openings
    stroke = model.gripper.stroke_m
    require(
        abs(opened - stroke) <= _OFF_M,
        f"its fingertips are {100 * opened:.1f} cm apart along `closes` when it is open, but `stroke_m` says "
        f"{100 * stroke:.1f} cm",
    )
    require(closed <= _OFF_M, f"its fingertips are still {100 * closed:.1f} cm apart when it is closed")
    return f"{100 * opened:.1f} cm"


def its_camera_sees_the_table(model: RobotModel) -> str:
    """At home, most of a D435i's picture shows the table and not the robot."""
    with closing(Client()) as client:
        table = client.add_plane()
        robot = Robot(client, model, np.eye(4))
        T_world_camera = robot.T_world_camera()
        eye = T_world_camera[:3, 3]
        tangents = (
            np.tan(np.radians(side) / 2) * np.linspace(-1, 1, n) for side, n in zip(_FIELD_DEG, _RAYS, strict=True)
        )
        ends = [eye + _FAR_M * T_world_camera[:3, :3] @ [x, y, 1.0] for x, y in product(*tangents)]
        hits = [hit[0] for hit in client.rayTestBatch([eye.tolist()] * len(ends), np.array(ends).tolist())]
    shares = [hits.count(body) / len(hits) for body in (table, robot.body)]
    require(
        shares[0] >= _SEEN,
        f"at `home`, {shares[0]:.0%} of its camera's picture show the table and {shares[1]:.0%} the robot; "
        "z is the way the camera looks, y down in its picture: see `camera`",
    )
    return f"{shares[0]:.0%} table, {shares[1]:.0%} robot"


def its_camera_sees_what_it_holds(model: RobotModel) -> str:
    """Past the opened fingers, it sees most of where a small object is held; else nothing is seen after a lift."""
    (x, y, z), grid = _HELD_M, np.linspace(0, 1, 5)
    with closing(Client()) as client:
        robot = Robot(client, model, np.eye(4))
        T_world_camera = robot.T_world_camera()
        T_world_tips = robot.T_world_hand() @ robot.T_hand_tips(model.gripper.stroke_m)
        held = np.array(list(product((2 * grid - 1) * x, (2 * grid - 1) * y, grid * z)))
        points = transform_points(T_world_tips, held)
        hits = client.rayTestBatch([T_world_camera[:3, 3].tolist()] * len(points), points.tolist())
    across, down, away = transform_points(invert(T_world_camera), points).T
    wide, high = np.tan(np.radians(_FIELD_DEG) / 2)
    inside = (away > 0) & (np.abs(across) < wide * away) & (np.abs(down) < high * away)
    share = float((inside & np.array([hit[0] < 0 for hit in hits])).mean())
    require(
        share >= _SEEN,
        f"its camera sees {share:.0%} of where an object is held; let it look between the fingertips: see `camera`",
    )
    return f"{share:.0%}"


CHECKS: tuple[Callable[[RobotModel], str | None], ...] = (
    it_stands_within_its_limits_at_home,
    it_touches_nothing_at_home,
    its_gripper_opens_and_closes,
    its_camera_sees_the_table,
    its_camera_sees_what_it_holds,
)
