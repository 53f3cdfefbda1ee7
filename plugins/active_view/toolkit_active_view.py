"""active_view: looks next from where the motions of the goal's objects are expected to become surest."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from toolkit.errors import ToolkitError
from toolkit.geometry import invert, lift, observation_vector, project
from toolkit.perception.database import Database
from toolkit.perception.pipeline import Pipeline
from toolkit.perception.refiners.comparing.rotations import yaw_rotations
from toolkit.registry import PluginConfig
from toolkit.types import Camera, Float, Frame, Mask, PoseEstimate

_CELL_PX = 8
"""Side of the cells in which it is decided what hides what."""

_THINNED = 2000
"""Points of an object that are projected, about."""


class ActiveViewConfig(PluginConfig):
    """Settings of `active_view`."""

    yaws: int = Field(default=72, ge=4, description="Number of turns about the vertical that an object may have made.")
    sure: float = Field(
        default=0.9,
        ge=0,
        le=1,
        description="Looking ends when the confidence of every object is at least this high, or when the budget is "
        "spent.",
    )
    budget: int = Field(default=8, ge=1, description="Largest number of views that are taken.")


DEFAULTS = ActiveViewConfig()


@dataclass(frozen=True, eq=False)
class Looked:
    """What was seen and made of it.

    Attributes:
        order: candidates in the order in which they were taken.
        frames: their frames.
        estimates: one per goal object, from all of them.
    """

    order: tuple[int, ...]
    frames: tuple[Frame, ...]
    estimates: tuple[PoseEstimate, ...]


def look_actively(
    pipeline: Pipeline,
    take: Callable[[int], Frame],
    goal: Frame,
    candidates: Sequence[Camera],
    first: int = 0,
    settings: ActiveViewConfig = DEFAULTS,
) -> Looked:
    """Take view after view, each chosen by `gains`, until every object is sure or the budget is spent.

    Args:
        pipeline: estimates from the views so far; its refiner must give confidences.
        take: takes the RGB-D frame of a candidate.
        goal: the goal image.
        candidates: cameras to choose from.
        first: the candidate that is taken first.
        settings: when to end, and what `gains` asks.

    Raises:
        ToolkitError: a stage refuses its input, or as `gains`.
    """
    order, frames = [first], [take(first)]
    while True:
        scene = pipeline.scene(pipeline.build_database(frames))
        estimates = tuple(scene.estimate(goal))
        left = [i for i in range(len(candidates)) if i not in order]
        sure = bool(estimates) and all(doubt(estimate) <= 1 - settings.sure for estimate in estimates)
        if sure or not left or len(order) >= settings.budget:
            return Looked(tuple(order), tuple(frames), estimates)
        expected = gains(scene.database, goal, estimates, [candidates[i] for i in left], settings)
        order.append(left[int(np.argmax(expected))])
        frames.append(take(order[-1]))


def gains(
    database: Database,
    goal: Frame,
    estimates: Sequence[PoseEstimate],
    candidates: Sequence[Camera],
    settings: ActiveViewConfig = DEFAULTS,
) -> Float:
    """What each candidate is expected to add to the certainty of the goal objects' motions.

    A motion becomes sure when the side that the goal image shows has been seen now. Which side that is depends on the
    turn asked for: for a turn R it is the one seen from R^T d, d being the direction from the goal object to the goal
    camera. With probability 1 - confidence the estimate is wrong, and then most likely because that side has not been
    seen: if it had been seen, it would have been found. So the doubt is spread over all turns, in proportion to how
    little of their side is known. A candidate gains what it would show of these sides beyond what is known, as far as
    nothing hides it.

    Args:
        database: of the frames so far.
        goal: the goal image.
        estimates: one per goal object, from these frames.
        candidates: C cameras.
        settings: `yaws`.

    Returns:
        (C,) float64, in objects that may become sure; at least 0.

    Raises:
        ToolkitError: an estimate has a motion but no confidence.
    """
    clouds = {int(k): _cloud(database, int(k)) for k in np.unique(database.instances)}
    turns = yaw_rotations(settings.yaws)
    total = np.zeros(len(candidates))
    for estimate in estimates:
        wanted = to_camera(goal, estimate) @ turns  # rows are R^T d
        seen = clouds.get(-1 if estimate.instance is None else estimate.instance)
        if seen is None:
            total += doubt(estimate) * _unseen(database, clouds, wanted, candidates)
            continue
        known = shown(wanted, database.observations[database.instance(int(estimate.instance or 0))])
        weights = _normalized(1 - known)
        others = [cloud for k, cloud in clouds.items() if k != estimate.instance]
        for number, camera in enumerate(candidates):
            new = shown(wanted, observation_vector(camera.T_world_camera, seen)[None]) - known
            gain = float(weights @ np.maximum(new, 0))
            total[number] += doubt(estimate) * gain * visible_share(camera, seen, others)
    return total


def doubt(estimate: PoseEstimate) -> float:
    """Probability 0..1 that an estimate is wrong; 1 where there is no motion.

    Raises:
        ToolkitError: there is a motion without a confidence.
    """
    if estimate.T_goal_current is None:
        return 1.0
    if estimate.confidence is None:
        raise ToolkitError("views are chosen by confidence, and this refiner gives none; use render_compare")
    return 1.0 - estimate.confidence


def to_camera(goal: Frame, estimate: PoseEstimate) -> Float:
    """(3,) unit vector from a goal object to the goal camera: against the ray through its mask's centre."""
    y, x = np.nonzero(estimate.segment.mask)
    camera = goal.camera
    on_ray = lift(camera.K, camera.T_world_camera, np.array([[x.mean(), y.mean()]]), np.ones(1))[0]
    ray = on_ray - camera.T_world_camera[:3, 3]
    return -ray / np.linalg.norm(ray)


def shown(sides: Float, views: Float) -> Float:
    """(S,) how well views from (V, 3) show the sides that face (S, 3), 0..1: the foreshortening in the best one."""
    return np.maximum(sides @ views.T, 0).max(axis=1, initial=0.0)


def visible_share(camera: Camera, own: Float, others: Sequence[Float]) -> float:
    """Share 0..1 of (N, 3) world points that are in a camera's picture and not hidden there by any of the others."""
    nearest = np.full((camera.height // _CELL_PX + 1, camera.width // _CELL_PX + 1), np.inf)
    for points in others:
        x, y, depth, inside = _cells(camera, points)
        np.minimum.at(nearest, (y[inside], x[inside]), depth[inside])
    x, y, depth, inside = _cells(camera, own)
    return float((depth[inside] < nearest[y[inside], x[inside]] + 1e-3).sum() / len(own))


def _cells(camera: Camera, points: Float) -> tuple[NDArray[np.int64], NDArray[np.int64], Float, Mask]:
    """Column, row and depth of every point, and whether it is in the picture."""
    pixels, depth = project(camera.K, invert(camera.T_world_camera), points)
    # Behind the camera there are no pixels.
    x, y = np.rint(np.nan_to_num(pixels, nan=-1.0)).astype(np.int64).T
    inside = np.asarray((x >= 0) & (x < camera.width) & (y >= 0) & (y < camera.height))
    return x // _CELL_PX, y // _CELL_PX, depth, inside


def _unseen(database: Database, clouds: dict[int, Float], wanted: Float, candidates: Sequence[Camera]) -> Float:
    """(C,) gain for an object that no frame is known to show: it is taken to stand in the middle of the others."""
    if not clouds:
        return np.zeros(len(candidates))
    middle = np.array([cloud.mean(axis=0) for cloud in clouds.values()]).mean(axis=0)[None]
    views = np.array([observation_vector(frame.camera.T_world_camera, middle) for frame in database.frames])
    known = shown(wanted, views)
    directions = [observation_vector(camera.T_world_camera, middle)[None] for camera in candidates]
    return np.array([_normalized(1 - known) @ np.maximum(shown(wanted, d) - known, 0) for d in directions])


def _cloud(database: Database, instance: int) -> Float:
    points = np.concatenate([database.regions[row].points for row in database.instance(instance)])
    return points[:: max(1, len(points) // _THINNED)].astype(np.float64)


def _normalized(weights: Float) -> Float:
    total = weights.sum()
    return weights / total if total > 1e-9 else np.full(len(weights), 1 / len(weights))
