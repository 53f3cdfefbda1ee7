"""The fused, coloured 3D model of one object instance: what several views together say about it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import cv2
import numpy as np
from scipy.spatial import ConvexHull, KDTree, QhullError

from toolkit.errors import ToolkitError
from toolkit.geometry import cubes, group_means, transform_points
from toolkit.perception.database import Database
from toolkit.perception.tabletop.table import find_table
from toolkit.types import Failure, Float, Frame, Image, Mask, Region, Segment

_VOXEL_M = 0.002
_DEPTH_STEP_M = 0.01
"""Neighbouring pixels further apart in depth than this see two surfaces, and the pixels between mix them."""

_CONTACT_M = 0.003
_LEVEL, _MOST_RIM = 0.9, 0.2
"""Points this low and beside the object whose normal is this upright are the table; a larger share is a flat object."""

_NEIGHBOURS = 6
_LONELY_M = 0.008
"""A point whose 6th neighbour is further away than this is an outlier."""

MIN_POINTS = 10


@dataclass(frozen=True, eq=False)
class Patch:
    """What one frame saw of the object.

    Attributes:
        rgb: (H, W, 3) uint8, the whole frame.
        mask: (H, W) bool, the object in it.
        pixels: (M, 2) int32 (x, y) of its reliable pixels.
        points: (M, 3) float32 world points of those pixels, metres.
        observation: (3,) unit vector from the object to the camera (Eq. obs_pose).
    """

    rgb: Image
    mask: Mask
    pixels: np.ndarray
    points: Float
    observation: Float


@dataclass(frozen=True, eq=False)
class FusedModel:
    """An object as all current frames together show it, in the world of the current scene.

    Attributes:
        points: (N, 3) float32, metres; one per voxel.
        colors: (N, 3) float32 RGB, 0..255, mean over the views that saw the voxel.
        seen_by: (N, V) bool, which of the patches saw the voxel.
        patches: V, one per frame that saw the object.
        score: 0..1, mean of the segmenter's own confidence in its segments.
    """

    points: Float
    colors: Float
    seen_by: Mask
    patches: tuple[Patch, ...]
    score: float = 1.0

    @cached_property
    def center(self) -> Float:
        """(3,) float64 middle of the points' axis-aligned box."""
        return np.asarray((self.points.min(axis=0) + self.points.max(axis=0)) / 2, np.float64)

    @cached_property
    def normals(self) -> Float:
        """(N, 3) float32 unit normals, towards the cameras that saw the point."""
        return self.normals_at(np.arange(len(self.points)))

    def normals_at(self, rows: np.ndarray) -> Float:
        """(len(rows), 3) float32 unit normals of some of the points: where their neighbourhood spreads least."""
        views = np.array([patch.observation for patch in self.patches], np.float32)
        outward = self.seen_by[rows].astype(np.float32) @ views
        if len(self.points) <= _NEIGHBOURS or not len(rows):
            return outward / np.maximum(np.linalg.norm(outward, axis=1, keepdims=True), 1e-9)
        _, near = KDTree(self.points).query(self.points[rows], min(2 * _NEIGHBOURS, len(self.points)))
        around = self.points[near]
        around = around - around.mean(axis=1, keepdims=True)
        normals = np.linalg.eigh(np.swapaxes(around, 1, 2) @ around)[1][..., 0]
        facing = (normals * outward).sum(axis=1, keepdims=True)
        return np.where(facing < 0, -normals, normals).astype(np.float32)


def fuse(database: Database, instance: int) -> FusedModel | Failure:
    """Join the regions of one instance: depth edges, outliers and the table dropped, duplicates merged on a voxel grid.

    Returns:
        The model, or a Failure where fewer than MIN_POINTS voxels are left.
    """
    patches = tuple(_patch(database.frame_of(row), database.regions[row]) for row in database.instance(instance))
    points = np.concatenate([patch.points for patch in patches])
    if len(points) < MIN_POINTS:
        return Failure("refiner", f"instance {instance} has only {len(points)} reliable points")
    colors = np.concatenate([patch.rgb[patch.pixels[:, 1], patch.pixels[:, 0]] for patch in patches])
    views = np.repeat(np.arange(len(patches)), [len(patch.points) for patch in patches])
    voxels = cubes(points - points.min(axis=0), _VOXEL_M)
    _, inverse, counts = np.unique(voxels, return_inverse=True, return_counts=True)
    merged, tints = (group_means(values, inverse, counts).astype(np.float32) for values in (points, colors))
    seen_by = np.zeros((len(counts), len(patches)), bool)
    seen_by[inverse, views] = True
    kept = _not_lonely(merged)
    if kept.sum() < MIN_POINTS:
        return Failure("refiner", f"instance {instance} has only {int(kept.sum())} points that are no outliers")
    score = float(np.mean([database.regions[row].segment.score for row in database.instance(instance)]))
    return _off_the_table(FusedModel(merged[kept], tints[kept], seen_by[kept], patches, score))


def united(models: Sequence[FusedModel]) -> FusedModel:
    """Several models as one object."""
    counts = [len(model.patches) for model in models]
    seen_by = [
        np.pad(model.seen_by, ((0, 0), (sum(counts[:k]), sum(counts[k + 1 :])))) for k, model in enumerate(models)
    ]
    return FusedModel(
        np.concatenate([model.points for model in models]),
        np.concatenate([model.colors for model in models]),
        np.concatenate(seen_by),
        tuple(patch for model in models for patch in model.patches),
        min(model.score for model in models),
    )


class Models:
    """The fused models of a database, made when first asked for."""

    def __init__(self, database: Database, known: Mapping[int, FusedModel | Failure] | None = None) -> None:
        self._database = database
        self._known = dict(known or {})

    def joined(self, database: Database, groups: Sequence[Sequence[int]]) -> Models:
        """Those of the same database with the instances of each group joined; models of all others are these."""
        changed = {instance for group in groups for instance in group}
        return Models(database, {i: model for i, model in self._known.items() if i not in changed})

    def get(self, instance: int) -> FusedModel | Failure:
        """The model of one instance, or why there is none."""
        if instance not in self._known:
            self._known[instance] = fuse(self._database, instance)
        return self._known[instance]

    def table_height(self, xy: Float) -> float | None:
        """World z of the table at (2,) world x and y, metres; None where the depth of no frame shows one."""
        if self._table is None:
            return None
        up, on_table = self._table[:3, 2], self._table[:3, 3]
        return float(on_table[2] - up[:2] @ (xy - on_table[:2]) / up[2])

    @cached_property
    def _table(self) -> Float | None:
        try:
            return find_table(self._database.frames).T_world_table
        except ToolkitError:
            return None

    @property
    def frames(self) -> tuple[Frame, ...]:
        """The current frames."""
        return self._database.frames

    def usable(self) -> dict[int, FusedModel]:
        """The models of all instances that have one, by instance."""
        found = {int(instance): self.get(int(instance)) for instance in np.unique(self._database.instances)}
        return {instance: model for instance, model in found.items() if isinstance(model, FusedModel)}

    def all(self) -> list[FusedModel]:
        """The models of all instances that have one."""
        found = (self.get(int(instance)) for instance in np.unique(self._database.instances))
        return [model for model in found if isinstance(model, FusedModel)]


Clouds = dict[int, tuple[Float, Float]]
"""By instance, (N, 3) float32 world points of it in metres, and their (N, 3) float32 RGB colours, 0..255."""


def clouds(database: Database, models: Models) -> Clouds:
    """The points of every instance, fused, or as they were measured where fusion leaves too few.

    Args:
        database: in the user's world.
        models: those of `database.level`.
    """
    return {instance: _cloud(database, models, instance) for instance in np.unique(database.instances).tolist()}


@dataclass(frozen=True, eq=False)
class Start:
    """A motion found by another route.

    Attributes:
        T_goal_current: (4, 4) in world coordinates, metres.
        covariance: (6, 6) of (turn, shift of `center`), rad^2 and m^2, or None where that is not known.
        center: (3,) point of the current world that the covariance is about.
        independent: whether it was found without drawing the object's model, so that a refiner that draws it and comes
            to the same motion has found it twice.
    """

    T_goal_current: Float
    covariance: Float | None = None
    center: Float = field(default_factory=lambda: np.zeros(3))
    independent: bool = True


@dataclass(frozen=True, eq=False)
class RefineTask:
    """One goal object and the instance it is taken for.

    Attributes:
        goal: the goal image.
        segment: the object in it.
        others: the other objects in it, which may hide parts of this one.
        instance: the database instance.
        models: where its fused model is to be had, if it is needed.
        starts: motions found by other routes, best first.
    """

    goal: Frame
    segment: Segment
    others: tuple[Segment, ...]
    instance: int
    models: Models
    starts: tuple[Start, ...] = ()

    @classmethod
    def of(
        cls,
        goal: Frame,
        segments: Sequence[Segment],
        number: int,
        instance: int,
        models: Models,
        starts: tuple[Start, ...] = (),
    ) -> RefineTask:
        """The task of object `number` of those that the goal image shows."""
        others = (*segments[:number], *segments[number + 1 :])
        return cls(goal, segments[number], others, instance, models, starts)


def _cloud(database: Database, models: Models, instance: int) -> tuple[Float, Float]:
    model = models.get(instance)
    if isinstance(model, FusedModel):
        return transform_points(database.T_world_level, model.points).astype(np.float32), model.colors
    rows = database.instance(instance)
    pixels = [(database.frame_of(row).rgb, database.regions[row].pixels) for row in rows]
    colors = np.concatenate([rgb[xy[:, 1], xy[:, 0]] for rgb, xy in pixels])
    return np.concatenate([database.regions[row].points for row in rows]), colors.astype(np.float32)


def _patch(frame: Frame, region: Region) -> Patch:
    assert frame.depth is not None
    kernel = np.ones((3, 3), np.uint8)
    depth = frame.depth
    step = cv2.dilate(depth, kernel) - cv2.erode(depth, kernel)
    inner = cv2.erode(region.segment.mask.astype(np.uint8), kernel) > 0
    good = (inner & (step < _DEPTH_STEP_M) & (depth > 0))[region.pixels[:, 1], region.pixels[:, 0]]
    if good.sum() < MIN_POINTS:
        # Thin things have no inside.
        good = np.ones(len(region.pixels), bool)
    return Patch(
        frame.rgb, region.segment.mask, region.pixels[good], region.points[good].astype(np.float32), region.observation
    )


def _off_the_table(model: FusedModel) -> FusedModel:
    """Without the rim of table that masks bleed onto: level points as low as any, beside all that is higher."""
    xy, height = model.points[:, :2], model.points[:, 2] - model.points[:, 2].min()
    low = np.flatnonzero(height < _CONTACT_M)
    if not 0 < len(low) < len(height) - MIN_POINTS:
        return model
    try:
        sides = ConvexHull(xy[height >= _CONTACT_M]).equations
    except QhullError:
        return model
    beside = low[(xy[low] @ sides[:, :2].T + sides[:, 2] > 0).any(axis=1)]
    rim = beside[model.normals_at(beside)[:, 2] > _LEVEL]
    if not 0 < len(rim) <= _MOST_RIM * len(height):
        return model
    kept = np.ones(len(height), bool)
    kept[rim] = False
    return replace(model, points=model.points[kept], colors=model.colors[kept], seen_by=model.seen_by[kept])


def _not_lonely(points: Float) -> Mask:
    if len(points) <= _NEIGHBOURS:
        return np.ones(len(points), bool)
    distances, _ = KDTree(points).query(points, _NEIGHBOURS + 1)
    return np.asarray(distances[:, -1] < _LONELY_M)
