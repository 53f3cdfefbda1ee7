"""The room a parallel gripper takes up, as boxes in its own frame."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from pydantic import Field

from toolkit.geometry import invert, transform_points
from toolkit.registry import PluginConfig
from toolkit.types import Float

Box = tuple[Float, Float]
"""(3,) smallest and (3,) largest corner."""


class Gripper(PluginConfig):
    """Measures of a parallel gripper. Its origin lies between the fingertips, x closes, z approaches."""

    stroke_m: float = Field(default=0.085, gt=0, description="Widest opening.")
    finger_length_m: float = Field(default=0.045, gt=0, description="From fingertip to palm, along z.")
    finger_thickness_m: float = Field(default=0.014, gt=0, description="Of one finger, along x.")
    finger_width_m: float = Field(default=0.022, gt=0, description="Of one finger, along y.")
    palm_m: tuple[float, float, float] = Field(
        default=(0.14, 0.075, 0.10), description="Box behind the fingers: x, y, z."
    )

    def fingers(self, opening: float) -> Iterator[Box]:
        """Both fingers at an opening."""
        inner, outer = opening / 2, opening / 2 + self.finger_thickness_m
        half = self.finger_width_m / 2
        for low, high in ((inner, outer), (-outer, -inner)):
            yield np.array([low, -half, -self.finger_length_m]), np.array([high, half, 0.0])

    def palm(self) -> Box:
        """What carries the fingers."""
        x, y, z = self.palm_m
        back = -self.finger_length_m
        return np.array([-x / 2, -y / 2, back - z]), np.array([x / 2, y / 2, back])

    def boxes(self, opening: float) -> list[Box]:
        """Everything that can collide, at an opening."""
        return [*self.fingers(opening), self.palm()]


def points_in_boxes(points: Float, T_world_gripper: Float, boxes: list[Box], retreat: float = 0.0) -> int:
    """How many (N, 3) world points lie in boxes of the gripper's frame, drawn out backwards by `retreat` metres."""
    own = transform_points(invert(T_world_gripper), points)
    inside = np.zeros(len(points), bool)
    for low, high in boxes:
        inside |= ((own >= low - np.array([0, 0, retreat])) & (own <= high)).all(axis=1)
    return int(inside.sum())


def lowest(T_world_gripper: Float, boxes: list[Box]) -> float:
    """Smallest z of the boxes' corners, world coordinates, metres."""
    corners = [[pick[i][axis] for axis, i in enumerate(index)] for pick in boxes for index in np.ndindex(2, 2, 2)]
    return float(transform_points(T_world_gripper, np.array(corners))[:, 2].min())
