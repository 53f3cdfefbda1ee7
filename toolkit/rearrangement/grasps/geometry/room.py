"""Grasps on two contacts, and which of them leave room for the gripper: here, where it lets go, and on the ways."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np
from pydantic import Field

from toolkit.geometry import make_transform
from toolkit.rearrangement.grasps.geometry.gripper import boxes_of, lowest, points_in_boxes
from toolkit.rearrangement.moves import Grasp, GraspRequest
from toolkit.rearrangement.surfaces import thin_out
from toolkit.registry import PluginConfig
from toolkit.types import Failure, Float, Gripper

_SPACING_M = 0.003
_OTHERS_SPACING_M = 0.005
_FEWEST_POINTS = 10
_STRAY_POINTS = 1
"""Points of the object that may lie inside a finger: noise. A finger that cuts off a corner meets two or more."""

_SOME = 10
"""Most grasps without room show that on every tenth point."""

_LEVEL = np.sin(np.radians(10))
"""A closing direction this near to level is made level: that is where a finger finds room above the table."""

_LEVER_M = 0.02
"""A grasp this far from the object's middle is worth 1 / e of one through it: what hangs to one side turns."""

_ALIKE_M, _ALIKE_RAD = 0.01, np.radians(20)
"""Where one grasp cannot be reached, one as near to it as this can seldom be."""


class RoomConfig(PluginConfig):
    """What every grasper that checks for room is told."""

    spare_m: float = Field(0.005, ge=0, description="Room on each side of the object when the open gripper comes.")
    least_spare_m: float = Field(
        0.002, ge=0, description="The same where the object fills the gripper; one that leaves less does not fit."
    )
    depth_m: float = Field(0.01, ge=0, description="How far the fingertips reach beyond the contacts.")
    tries: int = Field(4000, ge=1, description="Grasps checked for room at most, best first.")
    table_z_m: float = Field(0.0, description="Height of the table.")
    table_gap_m: float = Field(0.003, ge=0, description="Least height of the gripper above it.")
    keep: int = Field(40, ge=1, description="Grasps returned at most.")

    def widest_m(self, gripper: Gripper) -> float:
        """Longest distance of two contacts, metres."""
        return gripper.stroke_m - 2 * min(self.spare_m, self.least_spare_m)

    def spare(self, width: float, gripper: Gripper) -> float:
        """Room on each side, metres, that a gripper opens to around contacts `width` metres apart."""
        return min(self.spare_m, (gripper.stroke_m - width) / 2)


NO_ROOM = Failure("grasp", "every grasp would touch the table, the object's other parts or another object")


def evenly_seen(request: GraspRequest) -> GraspRequest | Failure:
    """The request with its points spread evenly; a Failure where too few of the object were seen."""
    points = np.asarray(request.points, np.float64)
    points = thin_out(points, _SPACING_M) if len(points) else points
    if len(points) < _FEWEST_POINTS:
        return Failure("grasp", f"only {len(points)} points of the object were seen")
    others = thin_out(request.others, _OTHERS_SPACING_M) if len(request.others) else request.others
    return replace(request, points=points, others=others)


def closing_direction(a: Float, b: Float) -> Float:
    """(3,) unit vector from one contact to the other, made level where it nearly is."""
    x = (b - a) / np.linalg.norm(b - a)
    return np.array([x[0], x[1], 0.0]) / np.hypot(x[0], x[1]) if abs(x[2]) < _LEVEL else x


def cross(a: Float, b: Float) -> Float:
    """(3,) cross product of two (3,) vectors: NumPy's own takes ten times as long for one pair."""
    (a0, a1, a2), (b0, b1, b2) = a.tolist(), b.tolist()
    return np.array([a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0])


def balance(a: Float, b: Float, center: Float) -> float:
    """0..1: how little of an object with its middle at `center` (3,) hangs to one side of a grasp on two contacts."""
    lever = float(np.linalg.norm(cross(center - (a + b) / 2, closing_direction(a, b))))
    return float(np.exp(-lever / _LEVER_M))


def grasps_on(
    a: Float, b: Float, approach: Float, score: float, gripper: Gripper, config: RoomConfig
) -> Iterator[Grasp]:
    """Grasps on two contacts within `widest_m`, along `approach` as nearly as the closing direction lets them."""
    x = closing_direction(a, b)
    z = approach - (approach @ x) * x
    z /= np.linalg.norm(z)
    R = np.stack([x, cross(z, x), z], axis=1)
    width = float(np.linalg.norm(b - a))
    spare = config.spare(width, gripper)
    # Flat objects leave no room below: their contacts are taken with the very tips.
    for depth, worth in ((config.depth_m, 1.0), (0.3 * config.depth_m, 0.5)):
        yield Grasp(make_transform(R, (a + b) / 2 + depth * z), width + 2 * spare, spare, worth * score)


def first_with_room(candidates: Iterable[Grasp], request: GraspRequest, config: RoomConfig) -> list[Grasp]:
    """Up to `keep` candidates that touch nothing and differ from each other, best first; `tries` are checked at most.

    `request` is evenly seen.
    """
    some = replace(request, points=request.points[::_SOME], others=request.others[::_SOME])
    found: list[Grasp] = []
    taken = np.zeros((0, 4, 4))
    tried = 0
    for candidate in sorted(candidates, key=lambda grasp: -grasp.score):
        if _any_alike(taken, candidate.T_world_gripper):
            continue
        tried += 1
        if _has_room(candidate, some, config) and _has_room(candidate, request, config):
            found.append(candidate)
            taken = np.concatenate([taken, candidate.T_world_gripper[None]])
        if len(found) == config.keep or tried == config.tries:
            break
    return found


def _any_alike(taken: Float, T: Float) -> bool:
    """Say whether any of (K, 4, 4) grasps is nearly the same as a (4, 4) one."""
    near = ((taken[:, :3, 3] - T[:3, 3]) ** 2).sum(axis=1) < _ALIKE_M**2
    cosines = ((taken[near, :3, :3] * T[:3, :3]).sum(axis=(1, 2)) - 1) / 2
    return bool((cosines > np.cos(_ALIKE_RAD)).any())


def _has_room(grasp: Grasp, request: GraspRequest, config: RoomConfig) -> bool:
    """Here and where it lets go: above the table, nothing between the fingers' outsides, a free way in and out."""
    boxes = boxes_of(request.gripper, grasp.opening)
    places = grasp.T_world_gripper, grasp.placed(request.T_place_pick)
    if any(lowest(T, boxes) < config.table_z_m + config.table_gap_m for T in places):
        return False
    if points_in_boxes(request.points, grasp.T_world_gripper, boxes, request.approach_m) > _STRAY_POINTS:
        return False
    return not any(points_in_boxes(request.others, T, boxes, request.approach_m) for T in places)
