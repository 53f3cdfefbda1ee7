"""The room a parallel gripper takes up, as boxes in its own frame."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from toolkit.geometry import invert, transform_points
from toolkit.types import Float, Gripper

Box = tuple[Float, Float]
"""(3,) smallest and (3,) largest corner."""


def boxes_of(gripper: Gripper, opening: float) -> list[Box]:
    """Everything of a gripper that can collide, at an opening: both fingers and the palm."""
    return [*_fingers(gripper, opening), _palm(gripper)]


def _fingers(gripper: Gripper, opening: float) -> Iterator[Box]:
    thickness, width, length = gripper.finger_m
    inner, outer = opening / 2, opening / 2 + thickness
    for low, high in ((inner, outer), (-outer, -inner)):
        yield np.array([low, -width / 2, -length]), np.array([high, width / 2, 0.0])


def _palm(gripper: Gripper) -> Box:
    x, y, z = gripper.palm_m
    back = -gripper.finger_m[2]
    return np.array([-x / 2, -y / 2, back - z]), np.array([x / 2, y / 2, back])


def points_in_boxes(points: Float, T_world_gripper: Float, boxes: list[Box], retreat: float = 0.0) -> int:
    """How many (N, 3) world points lie in boxes of the gripper's frame, drawn out backwards by `retreat` metres."""
    x, y, z = transform_points(invert(T_world_gripper), points).T.copy()
    inside = np.zeros(len(points), bool)
    for low, high in boxes:
        across = (x >= low[0]) & (x <= high[0]) & (y >= low[1]) & (y <= high[1])
        inside |= across & (z >= low[2] - retreat) & (z <= high[2])
    return int(inside.sum())


def lowest(T_world_gripper: Float, boxes: list[Box]) -> float:
    """Smallest z of the boxes' corners, world coordinates, metres."""
    up, height = T_world_gripper[2, :3], T_world_gripper[2, 3]
    return float(height + min(np.minimum(up * low, up * high).sum() for low, high in boxes))
