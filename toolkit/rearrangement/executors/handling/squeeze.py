"""What fingers that close do to an object that still stands on the table."""

from __future__ import annotations

import numpy as np

from toolkit.geometry import make_transform, rotation_z
from toolkit.rearrangement.moves import Grasp
from toolkit.types import Float, Gripper

_STEP = np.radians(1.0)
_MOST_STEPS = 20
_LESS_M = 1e-4
"""A turn by a step that brings the fingers nearer to each other by less than this is not made: friction."""


def squeezed(points: Float, grasp: Grasp, gripper: Gripper) -> list[Float]:
    """(4, 4) motions of an object while parallel fingers close on it.

    Parallel jaws turn what is between them the way on which they come nearer to each other (Goldberg, "Orienting
    polygonal parts without sensors", Algorithmica 1993), here about the vertical through the grasp; and the one that
    comes first pushes the object until the other is there, either way.

    Args:
        points: (N, 3) seen points of it, world coordinates.
        grasp: where they close.
        gripper: whose fingers they are.
    """
    x, center = grasp.T_world_gripper[:3, 0], grasp.T_world_gripper[:3, 3]
    turn = _turn(_between(points, grasp, gripper))
    motions: list[Float] = []
    for part in (0.0, 0.5, 1.0):
        R = rotation_z(part * turn)[:3, :3]
        motions += [make_transform(R, center - R @ center + push * x) for push in (-grasp.spare, grasp.spare)]
    return motions


def _between(points: Float, grasp: Grasp, gripper: Gripper) -> Float:
    """(M, 2) points between the fingers, seen from above: along the level part of the closing direction, and across."""
    along = grasp.T_world_gripper[:2, 0]
    along = along / max(float(np.linalg.norm(along)), 1e-9)
    own = (points - grasp.T_world_gripper[:3, 3]) @ grasp.T_world_gripper[:3, :3]
    _, width, length = gripper.finger_m
    low, high = np.array([-grasp.opening / 2, -width / 2, -length]), np.array([grasp.opening / 2, width / 2, 0.0])
    held = points[((own >= low) & (own <= high)).all(axis=1), :2] - grasp.T_world_gripper[:2, 3]
    return np.stack([held @ along, held @ [-along[1], along[0]]], axis=1)


def _turn(held: Float) -> float:
    """Angle, radians, by which jaws that close along the first axis of (M, 2) points turn them."""
    if not len(held):
        return 0.0
    widths = {steps: _width(held, steps * _STEP) for steps in (-1, 0, 1)}
    way = min(widths, key=lambda steps: widths[steps])
    steps = 0
    while abs(steps) < _MOST_STEPS and _width(held, steps * _STEP) - _width(held, (steps + way) * _STEP) > _LESS_M:
        steps += way
    return steps * _STEP


def _width(held: Float, angle: float) -> float:
    return float(np.ptp(held @ [np.cos(angle), -np.sin(angle)]))
