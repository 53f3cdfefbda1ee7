"""An arm and what is around it in RoboPlan (Pinocchio and Coal): contacts and paths, in C++."""

from __future__ import annotations

import tempfile
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from functools import lru_cache
from itertools import combinations
from pathlib import Path

import numpy as np
import trimesh
import yaml
from numpy.typing import NDArray
from roboplan.core import (
    JointConfiguration,
    JointPath,
    Mesh,
    OcTree,
    PathShortcutter,
    PathShortcuttingOptions,
    PinocchioSceneDescription,
    Scene,
    hasCollisionsAlongPath,
    loadJointLimitsConfig,
    loadUrdfSceneDescriptionFromXml,
)
from roboplan.rrt import RRT, RRTOptions
from roboplan.toppra import PathParameterizerTOPPRA, SplineFittingMode, TOPPRAOptions

from toolkit.errors import ToolkitError
from toolkit.geometry import invert
from toolkit.sim.bullet import silence
from toolkit.types import ArmWorld, Cubes, Float, Shape

_GROUP = "arm"
_ROOT = "universe"
_TURN = 2 * np.pi
_SAMPLE_S = 0.02
"""Way in time between two points of a timed path."""

_GREY = np.array([0.5, 0.5, 0.5, 1.0])


class ArmScene:
    """One arm among things, which can be placed anew and exchanged.

    Args:
        world: the arm and the things.
        lower: (J,) smallest angles of the arm's joints, radians.
        upper: (J,) largest angles.

    Raises:
        ToolkitError: RoboPlan cannot read the robot's description.
    """

    def __init__(self, world: ArmWorld, lower: Float, upper: Float) -> None:
        self._robot = _robot(world, lower, upper)
        self._arm = list(world.arm)
        self._scene = Scene(_GROUP, _description(_with_limits(world, lower, upper)))
        self._scene.addGroup(_GROUP, self._arm)
        self._shapes: dict[str, Shape | Cubes] = {}
        self._shaped: dict[str, bool] = {}
        self._fixed_to = _fixed_links(world.urdf)
        self._off: set[tuple[str, str]] = set()
        self.arrange(world)

    def shows(self, world: ArmWorld, lower: Float, upper: Float) -> bool:
        """Say whether a world has the same arm, so that `arrange` is enough."""
        return self._robot == _robot(world, lower, upper)

    def arrange(self, world: ArmWorld) -> None:
        """Put the things, and the joints that do not move, where they are in a world of the same arm."""
        self._exchange({solid.name: solid.shape for solid in world.solids})
        T_base_world = invert(world.T_world_base)
        for solid in world.solids:
            self._scene.updateGeometryPlacement(solid.name, _ROOT, _array(T_base_world @ solid.pose))
        self._switch_pairs(world)  # while nothing is held: to RoboPlan, a link's pairs are also those of what it holds
        for solid in world.solids:
            if solid.held_by is not None:
                self._hang(solid.name, solid.held_by, solid.pose)
        full = self._scene.getCurrentJointPositions()
        full[self._scene.getJointPositionIndices(list(world.others))] = list(world.others.values())
        self._scene.setJointPositions(full)

    def _exchange(self, shapes: Mapping[str, Shape | Cubes]) -> None:
        """Take out the things that are gone or look different now, and bring in those that are new.

        What was brought in after a thing that is taken out is brought in anew: RoboPlan 0.7 takes it for another then,
        and does not see what touches it.
        """
        names = list(self._shapes)
        kept = next((i for i, name in enumerate(names) if shapes.get(name) is not self._shapes[name]), len(names))
        for name in reversed(names[kept:]):
            self._scene.removeGeometry(name)
            del self._shapes[name]
            self._off = {pair for pair in self._off if name not in pair}
        for name in shapes.keys() - self._shapes.keys():
            self._shaped.pop(name, None)
        for name, shape in shapes.items():
            if name in self._shapes:
                continue
            if isinstance(shape, Cubes):
                self._scene.addOcTreeGeometry(name, _ROOT, _octree(shape), np.eye(4), _GREY)
            else:
                self._scene.addMeshGeometry(name, _ROOT, _mesh(shape), np.eye(4), _GREY)
            self._shapes[name] = shape

    def _hang(self, name: str, link: str, T_link_solid: Float) -> None:
        """Let a link carry a thing.

        RoboPlan 0.7 takes the pose for one in the frame of the joint above a link, whatever fixed joints lie between.
        """
        moved = link
        while moved in self._fixed_to:
            moved = self._fixed_to[moved]
        T_moved_link = self._scene.forwardKinematics(self._scene.getCurrentJointPositions(), link, moved)
        self._scene.updateGeometryPlacement(name, moved, _array(T_moved_link @ T_link_solid))

    def _switch_pairs(self, world: ArmWorld) -> None:
        """Look for contacts of all pairs but those that may touch, and those of two things that lie still."""
        still = sorted(solid.name for solid in world.solids if solid.held_by is None)
        allowed = {(min(a, b), max(a, b)) for a, b in world.allowed if self._has_shape(a) and self._has_shape(b)}
        off = allowed.union(combinations(still, 2))
        for pairs, look in ((self._off - off, True), (off - self._off, False)):
            if pairs:  # each call builds the scene's lists anew
                self._scene.setCollisions(sorted(pairs), look)
        self._off = off

    def _has_shape(self, name: str) -> bool:
        """Say whether a link or solid has a shape: RoboPlan knows no pairs of those without."""
        if name not in self._shaped:
            self._shaped[name] = bool(self._scene.getCollisionGeometryIDs(name))
        return self._shaped[name]

    def free(self, q: Float) -> bool:
        """Say whether arm and load touch nothing at (J,) joint angles."""
        return not self._scene.hasCollisions(self._full(q))

    def straight(self, start: Float, goal: Float, step: float) -> bool:
        """Say whether the straight line between two (J,) poses is free, at points at most `step` radians apart."""
        return not hasCollisionsAlongPath(self._scene, self._full(start), self._full(goal), step, True)

    def _full(self, q: Float) -> NDArray[np.float64]:
        """Angles of all joints: (J,) of the arm's, the others as arranged."""
        return self._scene.toFullJointPositions(_GROUP, _array(q))

    def search(self, start: Float, goal: Float, seed: int, *, reach: float, step: float, nodes: int) -> Float | None:
        """RRT-Connect from one free (J,) pose to another (Kuffner, LaValle, ICRA 2000).

        Args:
            start: where the arm is.
            goal: where it is to be.
            seed: the same one gives the same path.
            reach: longest branch of the trees, radians over all joints.
            step: way between two checks, radians over all joints.
            nodes: most poses in both trees.

        Returns:
            (N, J) a path that is free between its points too; None where the trees have not met.
        """
        options = RRTOptions(_GROUP, nodes, reach, step, rrt_connect=True)
        planner = RRT(self._scene, options)
        planner.setRngSeed(seed)
        try:
            path = planner.plan(self._pose(start), self._pose(goal))
        except RuntimeError:
            return None  # both ends are free, so that only the number of nodes can end a search
        return np.array(path.positions)

    def _pose(self, q: Float) -> JointConfiguration:
        return JointConfiguration(self._arm, _array(q))

    def limit(self, speed: float, acceleration: float) -> None:
        """Set what `timed` keeps to: rad/s and rad/s^2, the same of every joint of the arm."""
        limits = {name: {"max_velocity": [speed], "max_acceleration": [acceleration]} for name in self._arm}
        with tempfile.TemporaryDirectory(prefix="toolkit-") as folder:  # RoboPlan 0.7 takes them from a file only
            file = Path(folder) / "limits.yaml"
            file.write_text(yaml.safe_dump({"joint_limits": limits}))
            self._scene.importJointLimitsFromConfig(loadJointLimitsConfig(file))

    def timed(self, path: Float, part: float, *, blend: float) -> tuple[Float, Float, Float]:
        """A path as fast as the limits allow, from rest to rest (Pham, Pham, T-RO 2018).

        Args:
            path: (N, J), straight between its points, no two of which in a row are the same.
            part: of the limits that is used, at most 1.
            blend: its corners are cut by so much at most, radians over all joints, where nothing is touched on that.

        Returns:
            (T,) seconds, (T, J) radians and (T, J) radians per second.
        """
        given = JointPath()
        given.joint_names, given.positions = self._arm, list(path)
        options = TOPPRAOptions(
            dt=_SAMPLE_S,
            mode=SplineFittingMode.LinearBlend,
            velocity_scale=part,
            acceleration_scale=part,
            max_blend_deviation=blend,
        )
        timed = PathParameterizerTOPPRA(self._scene, _GROUP).generate(given, options)
        return np.array(timed.times), np.array(timed.positions), np.array(timed.velocities)

    def shortened(self, path: Float, seed: int, *, step: float, tries: int) -> Float:
        """An (M, J) path with the ends of `path` (N, J): straight lines in place of detours, where they are free."""
        given = JointPath()
        given.joint_names, given.positions = self._arm, list(path)
        options = PathShortcuttingOptions(_GROUP, step, tries, seed)
        return np.array(PathShortcutter(self._scene, options).shortcut(given).positions)


def _robot(world: ArmWorld, lower: Float, upper: Float) -> tuple[object, ...]:
    """What a scene is built of."""
    return world.urdf, world.arm, lower.tobytes(), upper.tobytes()


def _description(urdf: str) -> PinocchioSceneDescription:
    try:
        with silence():
            return loadUrdfSceneDescriptionFromXml(urdf)
    except (RuntimeError, ValueError) as error:
        raise ToolkitError(f"RoboPlan cannot read the robot's description: {error}") from error


def _with_limits(world: ArmWorld, lower: Float, upper: Float) -> str:
    """The description with the arm's limits in it, and every joint on its own.

    Joints that turn without end would be planned for on a circle, where a path may end a turn away from its goal.
    """
    root = ET.fromstring(world.urdf)
    limits = dict(zip(world.arm, zip(lower.tolist(), upper.tolist(), strict=True), strict=True))
    for joint in root.findall("joint"):
        for mimic in joint.findall("mimic"):
            joint.remove(mimic)
        endless = joint.get("type") == "continuous"
        ends = limits.get(joint.get("name", ""), (-_TURN, _TURN) if endless else None)
        if endless:
            joint.set("type", "revolute")
        if ends is not None:
            limit = joint.find("limit")
            limit = ET.SubElement(joint, "limit", effort="0", velocity="1") if limit is None else limit
            limit.set("lower", repr(ends[0]))
            limit.set("upper", repr(ends[1]))
    return ET.tostring(root, encoding="unicode")


def _fixed_links(urdf: str) -> dict[str, str]:
    """Link -> the one that it is fixed to."""
    fixed = ET.fromstring(urdf).findall("joint[@type='fixed']")
    ends = ((joint.find("child"), joint.find("parent")) for joint in fixed)
    return {a.get("link", ""): b.get("link", "") for a, b in ends if a is not None and b is not None}


def _array(values: Float) -> NDArray[np.float64]:
    return np.asarray(values, np.float64)


@lru_cache(maxsize=1)  # the table's
def _mesh(shape: Shape) -> Mesh:
    hulls = [trimesh.Trimesh(piece).convex_hull for piece in shape.pieces]
    with tempfile.TemporaryDirectory(prefix="toolkit-") as folder:
        file = Path(folder) / "shape.stl"
        trimesh.util.concatenate(hulls).export(file)
        return Mesh(file)


@lru_cache(maxsize=8)  # those of one move: near and far, they are brought in again and again
def _octree(cubes: Cubes) -> OcTree:
    """RoboPlan takes a box as its middle, its size, how sure it is to be full, and from where on it counts as full."""
    boxes = np.column_stack([cubes.centers, np.tile([cubes.side, 1.0, 0.5], (len(cubes.cells), 1))])
    return OcTree(list(boxes), cubes.side)
