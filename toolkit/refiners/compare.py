"""Render and compare: hypotheses from a yaw grid and from other routes, scored, refined and verified together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from toolkit.geometry import invert, make_transform
from toolkit.refiners.align import Source, align
from toolkit.refiners.cloud import Cloud
from toolkit.refiners.goal import GoalView
from toolkit.refiners.render import score_poses
from toolkit.types import Float

YAWS = 72
_PLACINGS = 4
_KEPT = 10
_PATCHES = 2
_ITERATIONS = 8
PLANAR = np.array([0, 0, 1, 1, 1, 0], np.float32)


@dataclass(frozen=True)
class Hypothesis:
    """A refined, verified motion.

    Attributes:
        T_goal_current: (4, 4).
        score: the verification score, higher is better.
        iou, correlation, color: its parts.
        information: (6, 6) inverse covariance of (turn, shift) about the object's centre.
    """

    T_goal_current: Float
    score: float
    iou: float
    correlation: float
    color: float
    photometric: float
    information: Float


def compare(cloud: Cloud, goal: GoalView, starts: Sequence[Float], free: Float = PLANAR) -> list[Hypothesis]:
    """Refine the best hypotheses and order them by their verification score, best first.

    Args:
        cloud: the object.
        goal: where it is sought.
        starts: (4, 4) motions found by other routes.
        free: (6,) which of (turn xyz, shift xyz) may change.
    """
    R, t = _yaw_grid(cloud, goal)
    given = [_planar(T, cloud.center) for T in starts]
    scores = _scored(cloud, goal, R, t)[0]
    kept = _distinct(scores, _KEPT - len(given))
    R = np.concatenate([*(g[0][None] for g in given), R[kept]])
    t = np.concatenate([*(g[1][None] for g in given), t[kept]])
    refined = align(
        jnp.asarray(R, jnp.float32),
        jnp.asarray(t, jnp.float32),
        _sources(cloud, goal, R, t),
        goal.image,
        jnp.asarray(free),
        _ITERATIONS,
    )
    R, t, information, photometric = jax.device_get(refined)
    R, t = _orthonormal(np.asarray(R, np.float64)), np.asarray(t, np.float64)
    total, iou, correlation, color = _scored(cloud, goal, R, t)
    score = total + photometric
    found = [
        Hypothesis(
            make_transform(R[i], t[i] - R[i] @ cloud.center),
            float(score[i]),
            float(iou[i]),
            float(correlation[i]),
            float(color[i]),
            float(photometric[i]),
            information[i],
        )
        for i in np.argsort(-score, kind="stable")
    ]
    return found


def _yaw_grid(cloud: Cloud, goal: GoalView) -> tuple[Float, Float]:
    """(Y, 3, 3) turns about the vertical and (Y, 3) places of the centre that put the model over the mask.

    Closed form and repeated: the offset between the boxes of the projected model and of the mask, taken back to the
    table's plane.
    """
    angles = 2 * np.pi * np.arange(YAWS) / YAWS
    cos, sin, zero = np.cos(angles), np.sin(angles), np.zeros(YAWS)
    R = np.stack(
        [np.stack([cos, -sin, zero], 1), np.stack([sin, cos, zero], 1), np.stack([zero, zero, zero + 1], 1)], axis=1
    )
    camera = goal.frame.camera
    T = invert(camera.T_world_camera)
    y, x = np.nonzero(goal.mask)
    low, high = np.array([x.min(), y.min()]), np.array([x.max(), y.max()])
    target = (low + high) / 2
    turned = cloud.points[:256].astype(np.float64) @ np.swapaxes(R, 1, 2)
    height = cloud.center[2]
    ray = camera.T_world_camera[:3, :3] @ np.linalg.inv(camera.K) @ np.array([*target, 1])
    eye = camera.T_world_camera[:3, 3]
    t = np.broadcast_to(eye + ray * (height - eye[2]) / ray[2], (YAWS, 3)).copy()
    focal = np.diagonal(camera.K)[:2]
    for _ in range(_PLACINGS):
        seen = (turned + t[:, None]) @ T[:3, :3].T + T[:3, 3]
        pixels = seen[..., :2] / seen[..., 2:] * focal + camera.K[:2, 2]
        offset = target - (pixels.min(axis=1) + pixels.max(axis=1)) / 2
        center = t @ T[:3, :3].T + T[:3, 3]
        z = center[:, 2]
        flat = center[:, :2] / z[:, None]
        derivative = np.zeros((YAWS, 2, 3))
        derivative[:, [0, 1], [0, 1]] = focal / z[:, None]
        derivative[:, :, 2] = -flat * focal / z[:, None]
        in_plane = (derivative @ T[:3, :3])[:, :, :2]
        t[:, :2] += np.linalg.solve(in_plane, offset[..., None])[..., 0]
    return R, t


def _planar(T: Float, center: Float) -> tuple[Float, Float]:
    """The turn about the vertical nearest to a motion's, and where it takes the centre, at its old height."""
    yaw = np.arctan2(T[1, 0] - T[0, 1], T[0, 0] + T[1, 1])
    cos, sin = np.cos(yaw), np.sin(yaw)
    R = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])
    place = T[:3, :3] @ center + T[:3, 3]
    return R, np.array([place[0], place[1], center[2]])


def _scored(cloud: Cloud, goal: GoalView, R: Float, t: Float) -> tuple[Float, Float, Float, Float]:
    T = invert(goal.frame.camera.T_world_camera)
    poses = np.zeros((len(R), 4, 4), np.float32)
    poses[:, :3, :3] = T[:3, :3] @ R
    poses[:, :3, 3] = t @ T[:3, :3].T + T[:3, 3]
    score = score_poses(
        jnp.asarray(cloud.points),
        jnp.asarray(cloud.colors),
        jnp.asarray(cloud.valid),
        jnp.asarray(goal.frame.camera.K, jnp.float32),
        jnp.asarray(poses),
        goal.grid,
    )
    total, iou, correlation, color = (np.asarray(part, np.float64) for part in jax.device_get(score))
    return total, iou, correlation, color


def _distinct(scores: Float, count: int) -> np.ndarray:
    """The best `count` of a ring of scores, local maxima first."""
    peak = (scores >= np.roll(scores, 1)) & (scores >= np.roll(scores, -1))
    order = np.lexsort((-scores, ~peak))
    return order[:count]


def _sources(cloud: Cloud, goal: GoalView, R: Float, t: Float) -> Source:
    """What every hypothesis is compared with: the patches seen from where the goal camera would then stand."""
    eye = goal.frame.camera.T_world_camera[:3, 3]
    points, values, weights = [], [], []
    for turn, place in zip(R, t, strict=True):
        direction = turn.T @ (eye - place)
        chosen = [cloud.patch(i) for i in cloud.nearest_patches(direction / np.linalg.norm(direction), _PATCHES)]
        points.append(np.concatenate([c[0] for c in chosen]))
        values.append(np.concatenate([c[1] for c in chosen], axis=1))
        weights.append(np.concatenate([c[2] for c in chosen]))
    shape = np.broadcast_to(cloud.points, (len(R), *cloud.points.shape))
    return Source(*(jnp.asarray(np.stack(a), jnp.float32) for a in (points, values, weights)), jnp.asarray(shape))


def _orthonormal(R: Float) -> Float:
    U, _, Vt = np.linalg.svd(R)
    return U @ Vt
