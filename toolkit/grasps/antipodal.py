"""Two-finger grasps from the fused point cloud alone: force closure, width, and room for the gripper."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from pydantic import Field

from toolkit.geometry import make_transform, rotation_angle
from toolkit.grasps.gripper import Gripper, lowest, points_in_boxes
from toolkit.grasps.surface import Contacts, antipodal_pairs, normals, thin_out, wall_pairs
from toolkit.moves import Grasp, PickPlace
from toolkit.registry import Plugin, PluginConfig
from toolkit.types import Failure, Float

_SPACING_M = 0.003
_OTHERS_SPACING_M = 0.005
_STRAY_POINTS = 3
"""Points that may lie inside a finger: noise, and the contact itself."""

_FEWEST_POINTS = 10
_LEVER_M = 0.02
"""A grasp this far from the object's middle is worth 1 / e of one through it: what hangs to one side turns."""

_ALIKE_M, _ALIKE_RAD = 0.01, np.radians(20)
"""Where one grasp cannot be reached, one as near to it as this can seldom be."""

_LEVEL = np.sin(np.radians(10))
"""A closing direction this near to level is made level: that is where a finger finds room above the table."""

_NO_ROOM = "every grasp would touch the table, other parts of the object or another object"


class AntipodalConfig(PluginConfig):
    """Settings of `antipodal`."""

    gripper: Gripper = Field(Gripper(), description="Measures; by default about a Robotiq 2F-85's.")
    friction: float = Field(0.4, gt=0, description="Coefficient of friction between finger and object.")
    contacts: int = Field(300, ge=1, description="Surface points tried as a first contact.")
    spare_m: float = Field(0.005, ge=0, description="Room on each side of the object when the open gripper comes.")
    depth_m: float = Field(0.01, ge=0, description="How far the fingertips reach beyond the contacts.")
    tries: int = Field(600, ge=1, description="Grasps checked for room at most, best first.")
    approach_m: float = Field(0.08, ge=0, description="Way along which the gripper comes and goes.")
    table_z_m: float = Field(0.0, description="Height of the table.")
    table_gap_m: float = Field(0.003, ge=0, description="Least height of the gripper above it.")
    keep: int = Field(20, ge=1, description="Grasps returned at most.")


class Antipodal(Plugin):
    """Opposite surface points in force closure; approaches from above first; clear of table and neighbours."""

    stage = "grasp"
    name = "antipodal"
    Config = AntipodalConfig
    config: AntipodalConfig  # pyright: ignore[reportIncompatibleVariableOverride]

    def grasp(self, request: PickPlace, seed: int) -> list[Grasp] | Failure:
        """See Grasper."""
        c = self.config
        points = np.asarray(request.points, np.float64)
        surface = thin_out(points, _SPACING_M) if len(points) else points
        if len(surface) < _FEWEST_POINTS:
            return Failure("grasp", f"only {len(surface)} points of the object were seen")
        others = thin_out(request.others, _OTHERS_SPACING_M) if len(request.others) else request.others
        request = replace(request, others=others)
        widest = c.gripper.stroke_m - 2 * c.spare_m
        rng = np.random.default_rng(seed)
        across = normals(surface)
        pairs = antipodal_pairs(surface, across, widest, c.friction, c.contacts, rng)
        found = self._first_with_room(pairs, surface, request)
        if not found:
            found = self._first_with_room(wall_pairs(surface, across, c.contacts, rng), surface, request)
        if not found and not len(pairs):
            return Failure("grasp", f"no two opposite surfaces lie within {100 * widest:.1f} cm of each other")
        return found or Failure(
            "grasp", "every grasp would touch the table, the object's other parts or another object"
        )

    def _first_with_room(self, pairs: Contacts, surface: Float, request: PickPlace) -> list[Grasp]:
        found: list[Grasp] = []
        candidates = sorted(self._candidates(pairs, surface.mean(axis=0)), key=lambda grasp: -grasp.score)
        tried = 0
        for candidate in candidates:
            if any(_alike(candidate, other) for other in found):
                continue
            tried += 1
            if self._has_room(candidate, surface, request):
                found.append(candidate)
            if len(found) == self.config.keep or tried == self.config.tries:
                break
        return found

    def _candidates(self, pairs: Contacts, center: Float) -> Iterator[Grasp]:
        """Grasps on every pair, approaching as steeply as the pair allows and in two directions beside that."""
        c = self.config
        for a, b, alignment in zip(pairs.first, pairs.second, pairs.alignment, strict=True):
            width = float(np.linalg.norm(b - a))
            x = (b - a) / width
            if abs(x[2]) < _LEVEL:
                x = np.array([x[0], x[1], 0.0]) / np.hypot(x[0], x[1])
            steepest = np.array([0.0, 0.0, -1.0]) - x * -x[2]
            if np.linalg.norm(steepest) < 0.3:  # one contact above the other: no finger fits below
                continue
            steepest /= np.linalg.norm(steepest)
            for tilt in np.radians([0, 35, -35, 75, -75]):
                z = np.cos(tilt) * steepest + np.sin(tilt) * np.cross(x, steepest)
                R = np.stack([x, np.cross(z, x), z], axis=1)
                lever = float(np.linalg.norm(np.cross(center - (a + b) / 2, x)))
                score = float(alignment) * float(np.exp(-lever / _LEVER_M)) * (0.5 - 0.5 * float(z[2]))
                # Flat objects leave no room below: their contacts are taken with the very tips.
                for depth, worth in ((c.depth_m, 1.0), (0.3 * c.depth_m, 0.5)):
                    tips = make_transform(R, (a + b) / 2 + depth * z)
                    yield Grasp(tips, width + 2 * c.spare_m, worth * score)

    def _has_room(self, grasp: Grasp, surface: Float, request: PickPlace) -> bool:
        """Here and where it lets go: above the table, nothing between the fingers' outsides, a free way in and out."""
        c = self.config
        boxes = c.gripper.boxes(grasp.opening)
        for T in (grasp.T_world_gripper, grasp.placed(request.T_place_pick)):
            if lowest(T, boxes) < c.table_z_m + c.table_gap_m:
                return False
            if points_in_boxes(request.others, T, boxes, c.approach_m) > 0:
                return False
        return points_in_boxes(surface, grasp.T_world_gripper, boxes, c.approach_m) <= _STRAY_POINTS


def _alike(a: Grasp, b: Grasp) -> bool:
    one, other = a.T_world_gripper, b.T_world_gripper
    apart = float(np.linalg.norm(one[:3, 3] - other[:3, 3]))
    return apart < _ALIKE_M and float(rotation_angle(one[:3, :3] @ other[:3, :3].T)) < _ALIKE_RAD
