"""Render and compare: hypotheses from a yaw grid and from other routes, scored, refined and verified together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import jax
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from toolkit.geometry import invert, is_same_motion, make_transform
from toolkit.perception.jax_geometry import on_device
from toolkit.perception.refiners.comparing.align import Freedom, Source, align
from toolkit.perception.refiners.comparing.cloud import Cloud
from toolkit.perception.refiners.comparing.goal import GoalView
from toolkit.perception.refiners.comparing.render import BATCH, Score, score_poses
from toolkit.types import Float

_PLACINGS = 4
_MIDDLE = np.array([[0.5, 0.5]])
_BORDERS = np.array([[x, y] for x in (0, 0.5, 1) for y in (0, 0.5, 1) if (x, y) != (0.5, 0.5)])
_SHIFTED = 24
"""Most likely turns that are also placed with other points of the boxes meeting."""
_PLACED_POINTS = 256
_DISTINCT_RAD, _DISTINCT_M = np.radians(8), 0.01
"""Refined hypotheses closer than this are one."""

PLANAR = np.array([0, 0, 1, 1, 1, 0], np.float32)
FREE = np.ones(6, np.float32)


@dataclass(frozen=True)
class Search:
    """How hypotheses are made and refined.

    Attributes:
        rotations: (B, 3, 3) turns that are tried; none to refine the given starts only.
        free: (6,) which of (turn xyz, shift xyz) the refinement may change, 1 or 0.
        rests: whether the lowest point stays on the table.
        kept: hypotheses that are refined, starts included.
        patches: views every hypothesis is compared with.
        iterations: Gauss-Newton steps per level.
    """

    rotations: Float
    free: Float
    rests: bool
    kept: int
    patches: int
    iterations: int


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """A refined motion and how well it agrees with the goal image.

    Attributes:
        T_goal_current: (4, 4).
        iou: overlap of silhouettes.
        known: share of the overlap that shows a side that some view has seen; only there the following count.
        correlation: of locally centred colours, rendered against seen.
        color: mean difference of colours.
        photometric: correlation of normalised intensities with the views it was refined on.
        spill_px: how far the model lies beside the object, where it does so most.
        information: (6, 6) inverse covariance of (turn, shift) about the object's centre.
    """

    T_goal_current: Float
    iou: float
    known: float
    correlation: float
    color: float
    photometric: float
    spill_px: float
    information: Float

    @property
    def score(self) -> float:
        """The verification score, common to all routes; higher is better."""
        return self.iou + self.known * (self.correlation - self.color + self.photometric)


def compare(cloud: Cloud, goal: GoalView, starts: Sequence[Float], search: Search) -> list[Hypothesis]:
    """Refine the best hypotheses and order them by their verification score, best first.

    Args:
        cloud: the object.
        goal: where it is sought.
        starts: (4, 4) motions found by other routes; kept beside the hypotheses, whatever their first score.
        search: how hypotheses are made and refined.
    """
    turns, places = _first_guesses(cloud, goal, starts, search)
    refined = align(
        on_device(turns),
        on_device(places),
        _sources(cloud, goal, turns, places, search.patches),
        goal.image,
        Freedom(*map(on_device, (search.free, search.rests, cloud.table))),
        search.iterations,
    )
    parts = [np.asarray(part, np.float64) for part in jax.device_get(refined)]
    finite = np.isfinite(parts[0]).all(axis=(1, 2)) & np.isfinite(parts[1]).all(axis=1)
    turns, places, information, photometric, spill = (part[finite] for part in parts)
    if not len(turns):
        return []
    turns = _orthonormal(turns)
    agreement = _agreement(cloud, goal, turns, places)
    found = [
        Hypothesis(
            make_transform(R, t - R @ cloud.center),
            iou=float(agreement.iou[i]),
            known=float(agreement.known[i]),
            correlation=float(agreement.correlation[i]),
            color=float(agreement.color[i]),
            photometric=float(photometric[i]),
            spill_px=float(spill[i]),
            information=information[i],
        )
        for i, (R, t) in enumerate(zip(turns, places, strict=True))
    ]
    return _distinct(sorted(found, key=lambda h: -h.score), cloud.center)


def _first_guesses(cloud: Cloud, goal: GoalView, starts: Sequence[Float], search: Search) -> tuple[Float, Float]:
    """(B, 3, 3) turns and (B, 3) places of the centre that are worth refining."""
    given = [_start(T, cloud.center, search.free) for T in starts]
    turns = np.array([turn for turn, _ in given]).reshape(-1, 3, 3)
    places = np.array([place for _, place in given]).reshape(-1, 3)
    if not len(search.rotations):
        return turns, places
    rotations, on_table, total = _tried(cloud, goal, search.rotations)
    rows = _peaks(total, rotations, search.kept - len(given))
    return np.concatenate([turns, rotations[rows]]), np.concatenate([places, on_table[rows]])


def best_agreement(cloud: Cloud, goal: GoalView, search: Search) -> float | None:
    """The best first score of all hypotheses, unrefined; None where the search has none."""
    return float(_tried(cloud, goal, search.rotations)[2].max()) if len(search.rotations) else None


def _tried(cloud: Cloud, goal: GoalView, R: Float) -> tuple[Float, Float, Float]:
    """(H, 3, 3) turns, (H, 3) places on the table and (H,) scores of the hypotheses that (B, 3, 3) turns give."""
    (places,) = _placed(cloud, goal, R, _MIDDLE)
    total = np.asarray(_agreement(cloud, goal, R, places).total)
    if not goal.cut_off:
        return R, places, total
    # Of an object that is partly covered, the box says where some of its sides are, but not which.
    likely = R[np.argsort(-total, kind="stable")[:_SHIFTED]]
    turns = np.tile(likely, (len(_BORDERS), 1, 1))
    shifted = _placed(cloud, goal, likely, _BORDERS).reshape(-1, 3)
    totals = np.asarray(_agreement(cloud, goal, turns, shifted).total)
    return np.concatenate([R, turns]), np.concatenate([places, shifted]), np.concatenate([total, totals])


def _placed(cloud: Cloud, goal: GoalView, R: Float, anchors: Float) -> Float:
    """(A, B, 3) places of the centre that put the model, turned by (B, 3, 3) R, on the table and over the mask.

    Closed form and repeated: the offset between the boxes of the projected model and of the mask, taken back to the
    table's plane. The model's lowest point stays as high as it is now. The (A, 2) `anchors` say which points of the two
    boxes shall meet: 0 their left or upper sides, 1 their right or lower ones.
    """
    camera = goal.frame.camera
    T = invert(camera.T_world_camera)
    y, x = np.nonzero(goal.mask)
    targets = (1 - anchors) * [x.min(), y.min()] + anchors * [x.max(), y.max()]
    some = cloud.points[:: len(cloud.points) // _PLACED_POINTS].astype(np.float64)
    turned = some @ np.swapaxes(T[:3, :3] @ R, 1, 2)
    # One array per coordinate, so that boxes are taken along what lies together.
    flat, deep = np.moveaxis(turned[..., :2], 2, 1).copy(), turned[:, None, :, 2].copy()
    heights = cloud.table - (cloud.points @ R[:, 2].T).min(axis=0)
    pixels = np.column_stack([targets, np.ones(len(targets))])
    rays = pixels @ (camera.T_world_camera[:3, :3] @ np.linalg.inv(camera.K)).T
    eye = camera.T_world_camera[:3, 3]
    t = eye + rays[:, None] * ((heights - eye[2]) / rays[:, 2:])[..., None]
    focal = np.diagonal(camera.K)[:2]
    for target, anchor, place in zip(targets, anchors, t, strict=True):
        for _ in range(_PLACINGS):
            center = place @ T[:3, :3].T + T[:3, 3]
            seen = (flat + center[:, :2, None]) / (deep + center[:, None, 2:])
            low, high = (edge * focal + camera.K[:2, 2] for edge in (seen.min(axis=2), seen.max(axis=2)))
            offset = target - (1 - anchor) * low - anchor * high
            derivative = np.zeros((len(R), 2, 3))
            derivative[:, [0, 1], [0, 1]] = focal / center[:, 2:]
            derivative[:, :, 2] = -center[:, :2] / center[:, 2:] ** 2 * focal
            in_plane = (derivative @ T[:3, :3])[:, :, :2]
            place[:, :2] += np.linalg.solve(in_plane, offset[..., None])[..., 0]
    return t


def _start(T: Float, center: Float, free: Float) -> tuple[Float, Float]:
    """A motion as (3, 3) turn and (3,) place of the centre; under the planar prior the nearest planar one."""
    place = T[:3, :3] @ center + T[:3, 3]
    if free[0]:
        return T[:3, :3], place
    yaw = np.arctan2(T[1, 0] - T[0, 1], T[0, 0] + T[1, 1])
    return Rotation.from_euler("z", yaw).as_matrix(), np.array([place[0], place[1], center[2]])


def _agreement(cloud: Cloud, goal: GoalView, R: Float, t: Float) -> Score:
    """Agreement of (B, 3, 3), (B, 3) poses of the centred model with the goal; NumPy arrays (B,)."""
    T = invert(goal.frame.camera.T_world_camera)
    padded = len(R) + -len(R) % BATCH
    poses = np.zeros((padded, 4, 4), np.float32)
    poses[: len(R), :3, :3] = T[:3, :3] @ R
    poses[: len(R), :3, 3] = t @ T[:3, :3].T + T[:3, 3]
    shade = np.zeros((padded, len(cloud.points)), np.float32)
    shade[: len(R)] = cloud.shade(R)
    K = on_device(goal.frame.camera.K)
    arrays = jax.device_put((cloud.points, cloud.normals, cloud.colors, cloud.valid, cloud.seen, K))
    batches = [jax.device_put((poses[i : i + BATCH], shade[i : i + BATCH])) for i in range(0, padded, BATCH)]
    scores = jax.device_get([score_poses(*arrays, *batch, goal.grid) for batch in batches])
    return jax.tree.map(lambda *parts: np.concatenate(parts)[: len(R)], *scores)


def _peaks(scores: Float, R: Float, count: int) -> NDArray[np.int64]:
    """The best `count` of the hypotheses, those first that no better one is close to."""
    order = np.argsort(-scores, kind="stable")[: 6 * count]
    gap = np.arccos(((np.einsum("aij,bij->ab", R[order], R[order]) - 1) / 2).clip(-1, 1))
    near_better = np.tril(gap < 2 * _DISTINCT_RAD, -1).any(axis=1)
    return order[np.argsort(near_better, kind="stable")[:count]]


def _distinct(hypotheses: list[Hypothesis], center: Float) -> list[Hypothesis]:
    """Without those that came out where a better one did."""
    kept: list[Hypothesis] = []
    for h in hypotheses:
        T = h.T_goal_current
        if not any(is_same_motion(T, k.T_goal_current, center, _DISTINCT_RAD, _DISTINCT_M) for k in kept):
            kept.append(h)
    return kept


def _sources(cloud: Cloud, goal: GoalView, R: Float, t: Float, patches: int) -> Source:
    """What every hypothesis is compared with: the patches seen from where the goal camera would then stand."""
    eye = goal.frame.camera.T_world_camera[:3, 3]
    points, values, weights = [], [], []
    for turn, place in zip(R, t, strict=True):
        direction = turn.T @ (eye - place)
        direction /= np.linalg.norm(direction)
        chosen = [cloud.patch(i, turn, direction) for i in cloud.nearest_patches(direction, patches)]
        points.append(np.concatenate([c[0] for c in chosen]))
        values.append(np.concatenate([c[1] for c in chosen], axis=1))
        weights.append(np.concatenate([c[2] for c in chosen]))
    shape = np.broadcast_to(cloud.points, (len(R), *cloud.points.shape))
    return Source(*map(on_device, (np.stack(points), np.stack(values), np.stack(weights), shape)))


def _orthonormal(R: Float) -> Float:
    U, _, Vt = np.linalg.svd(R)
    return U @ Vt
