"""Pose errors, plain and symmetry-aware, and which segment answers for which object."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial.transform import Rotation

from toolkit.geometry import invert, make_transform, rotation_angle, transform_points
from toolkit.types import Float, Mask, ObjectModel, Placed, Segment, TrueObject

MAX_ROTATION_DEG = 5.0
MAX_TRANSLATION_CM = 2.0
"""The paper's thresholds (Sec. Experiments, Task completion)."""

_ROUND_OFF = 1e-9
"""Errors below this many degrees or centimetres are rounding of a matrix product: truth must score exactly zero."""


@dataclass(frozen=True)
class PoseError:
    """Errors of one estimate; `_sym`: at the symmetry of the model that brings the rotation error to its minimum."""

    rotation_error_deg: float
    translation_error_cm: float
    rotation_error_deg_sym: float
    translation_error_cm_sym: float

    @property
    def success(self) -> bool:
        """Within 5 deg and 2 cm, symmetries not considered."""
        return _within(self.rotation_error_deg, self.translation_error_cm)

    @property
    def success_sym(self) -> bool:
        """Within 5 deg and 2 cm of a motion that looks the same."""
        return _within(self.rotation_error_deg_sym, self.translation_error_cm_sym)


def pose_error(T_goal_current: Float, truth: TrueObject) -> PoseError:
    """Errors of a motion (4, 4) in world coordinates.

    The translation error is the distance between the two places of the centre of the model's axis-aligned box.
    """
    plain = _errors(T_goal_current, truth, np.eye(4))
    symmetric = [
        _errors(T_goal_current, truth, S)
        for discrete in [np.eye(4), *truth.model.discrete_symmetries]
        for S in [discrete, *_best_continuous(T_goal_current, truth, discrete)]
    ]
    return PoseError(*plain, *min(symmetric))


def counterparts(
    motions: Mapping[int, Float],
    truth: Mapping[int, TrueObject],
    only_current: Mapping[int, Placed] | None = None,
    only_goal: Mapping[int, Placed] | None = None,
) -> dict[int, TrueObject | None]:
    """What every goal object is scored against.

    Objects of the same model are interchangeable: each may go to any of their goal places, as long as every place gets
    one of them. Of all such pairings, the one under which most motions are right is taken; every other object is scored
    against itself.

    Args:
        motions: (4, 4) estimated motions by instance id of the goal object; objects without one are left out.
        truth: true objects in both scenes by instance id.
        only_current: objects that are not in the goal, by instance id.
        only_goal: objects that are not in the current scene, by instance id.

    Returns:
        by instance id of the goal object; None where nothing in the current scene is that object, so that no motion is
        right.
    """
    goals = {i: Placed(t.model, t.T_world_goal) for i, t in truth.items()} | dict(only_goal or {})
    sources = {i: Placed(t.model, t.T_world_current) for i, t in truth.items()} | dict(only_current or {})
    paired: dict[int, TrueObject | None] = {}
    for kind in dict.fromkeys(goal.model.object_id for goal in goals.values()):
        ids = [i for i, goal in goals.items() if goal.model.object_id == kind]
        there = [i for i, source in sources.items() if source.model.object_id == kind]
        if len(ids) == 1 and there in ([], ids):
            paired[ids[0]] = truth.get(ids[0])
            continue
        options = [[_moved(goals[i], sources[j], i) for j in there] for i in ids]
        costs = [
            [_cost(motions.get(i), option, stays=i == j) for option, j in zip(row, there, strict=True)]
            + [_cost(motions.get(i), None, stays=i not in truth)] * max(0, len(ids) - len(there))
            for i, row in zip(ids, options, strict=True)
        ]
        rows, columns = linear_sum_assignment(costs)
        paired |= {ids[r]: options[r][c] if c < len(there) else None for r, c in zip(rows, columns, strict=True)}
    return paired


def _moved(goal: Placed, source: Placed, instance_id: int) -> TrueObject:
    return TrueObject(goal.model, source.T_world_model, goal.T_world_model, instance_id)


def _cost(motion: Float | None, truth: TrueObject | None, *, stays: bool) -> float:
    """Nothing for what is right, 1 for what is wrong; among equals, less for what stays and for what is nearer."""
    if truth is None:
        return (0.0 if motion is None else 1.0) + (0.0 if stays else 1e-3)
    if motion is None:
        return 1.0 if stays else 1.001
    error = pose_error(motion, truth)
    return (0.0 if error.success_sym else 1.0) + 1e-3 * error.translation_error_cm_sym / (
        1 + error.translation_error_cm_sym
    )


def _errors(T_goal_current: Float, truth: TrueObject, S: Float) -> tuple[float, float]:
    """Rotation (deg) and translation (cm) error against the true goal pose turned by model symmetry S."""
    T_true = truth.T_world_goal @ S @ invert(truth.T_world_current)
    angle = np.degrees(rotation_angle(T_goal_current[:3, :3] @ T_true[:3, :3].T))
    center = transform_points(truth.T_world_current, truth.model.center)
    distance = 100 * np.linalg.norm(transform_points(T_goal_current, center) - transform_points(T_true, center))
    return _clean(float(angle)), _clean(float(distance))


def _best_continuous(T_goal_current: Float, truth: TrueObject, discrete: Float) -> list[Float]:
    """For every continuous axis the model symmetry nearest to the estimate, composed with a discrete one.

    The rotation about an axis a that comes nearest to R is the twist of R's swing-twist decomposition about a.
    """
    symmetries: list[Float] = []
    for axis_point in truth.model.continuous_axes:
        axis, point = axis_point[:3], axis_point[3:]
        wanted = invert(discrete) @ invert(truth.T_world_goal) @ T_goal_current @ truth.T_world_current
        x, y, z, w = Rotation.from_matrix(wanted[:3, :3]).as_quat()
        twist = 2 * np.arctan2(np.dot([x, y, z], axis), w)
        R = Rotation.from_rotvec(twist * axis).as_matrix()
        symmetries.append(discrete @ make_transform(R, point - R @ point))
    return symmetries


def _clean(value: float) -> float:
    return 0.0 if value < _ROUND_OFF else value


def _within(rotation_deg: float, translation_cm: float) -> bool:
    return rotation_deg <= MAX_ROTATION_DEG and translation_cm <= MAX_TRANSLATION_CM


def symmetry_of(model: ObjectModel) -> Literal["none", "discrete", "continuous"]:
    """The strongest kind of symmetry a model has."""
    if len(model.continuous_axes):
        return "continuous"
    return "discrete" if len(model.discrete_symmetries) else "none"


def assign_goal_objects(
    segments: Sequence[Segment], true_masks: Mapping[int, Mask], min_iou: float = 0.5
) -> dict[int, int]:
    """Which segment answers for which true object: the pairing of largest total IoU, pairs under `min_iou` left out.

    Returns:
        instance id -> position in `segments`.
    """
    ids = sorted(true_masks)
    iou = np.array([[_iou(true_masks[i], segment.mask) for segment in segments] for i in ids])
    iou = iou.reshape(len(ids), len(segments))
    if iou.size == 0:
        return {}
    rows, columns = linear_sum_assignment(-np.where(iou >= min_iou, iou, 0))
    return {ids[r]: int(c) for r, c in zip(rows, columns, strict=True) if iou[r, c] >= min_iou}


def _iou(a: Mask, b: Mask) -> float:
    union = int((a | b).sum())
    return int((a & b).sum()) / union if union else 0.0
