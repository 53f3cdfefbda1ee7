"""view_completion: what no view has shown of an object is guessed by symmetry, then rendered and compared."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Literal
from weakref import WeakKeyDictionary, proxy

import cv2
import numpy as np
from pydantic import Field
from scipy.spatial import KDTree

from toolkit.geometry import invert, make_transform, project, transform_points
from toolkit.perception.fusion import FusedModel, Models, Patch, RefineTask, united
from toolkit.perception.refiners.render_compare import RenderCompare, RenderCompareConfig
from toolkit.types import Failure, Float, Frame, Refined

Kind = Literal["revolution", "half_turn", "mirror"]

_TURNS = 8
"""Copies of an object of revolution, all around."""


class ViewCompletionConfig(RenderCompareConfig):
    """Settings of `view_completion`, besides those of `render_compare`."""

    tried: tuple[Kind, ...] = Field(
        ("revolution", "half_turn"), description="Kinds of symmetry that are tried; a mirror turns writing round."
    )
    least: float = Field(
        0.97, gt=0, le=1, description="Share of a copy's points that no view may contradict, or the copy is not added."
    )
    tolerance_m: float = Field(0.008, gt=0, description="Depth by which a point may lie before what was measured.")
    new_m: float = Field(0.004, gt=0, description="Points of a copy nearer than this to measured ones add nothing.")


class ViewCompletion(RenderCompare):
    """`render_compare` on models that are completed by mirror planes, a half turn, or revolution.

    After the argument of OneViewAll (2026) that one view is enough where shapes are symmetric. The axis is the vertical
    through the middle of the footprint, which a camera above the table sees most of. A symmetry is believed where its
    copy of what was seen contradicts no view: it stays within the object's mask or behind other things, and before
    nothing that was measured. Colours are copied too, which is a guess.
    """

    name = "view_completion"
    Config = ViewCompletionConfig

    def __init__(self, config: ViewCompletionConfig | None = None) -> None:
        super().__init__(config)
        self._completed: WeakKeyDictionary[Models, Completed] = WeakKeyDictionary()

    def refine(self, task: RefineTask) -> Refined | Failure:
        return super().refine(self._with_completed(task))

    def verify(self, task: RefineTask) -> float | None:
        return super().verify(self._with_completed(task))

    def _with_completed(self, task: RefineTask) -> RefineTask:
        if task.models not in self._completed:
            self._completed[task.models] = Completed(proxy(task.models), self.config)
        return replace(task, models=self._completed[task.models])


class Completed(Models):
    """The completed models of a scene, made when first asked for.

    Args:
        measured: the models that are completed; not kept alive.
        config: how.
    """

    def __init__(self, measured: Models, config: ViewCompletionConfig) -> None:
        self._measured, self._config = measured, config
        self._known: dict[int, FusedModel | Failure] = {}

    def get(self, instance: int) -> FusedModel | Failure:
        if instance not in self._known:
            model = self._measured.get(instance)
            known = isinstance(model, FusedModel)
            self._known[instance] = complete(model, self._measured.frames, self._config) if known else model
        return self._known[instance]

    def table_height(self, xy: Float) -> float | None:
        return self._measured.table_height(xy)

    @property
    def frames(self) -> tuple[Frame, ...]:
        return self._measured.frames

    def usable(self) -> dict[int, FusedModel]:
        return self._measured.usable()

    def all(self) -> list[FusedModel]:
        """The models as they were measured: light is estimated from what was seen."""
        return self._measured.all()


def complete(model: FusedModel, frames: Sequence[Frame], config: ViewCompletionConfig) -> FusedModel:
    """A model with the copies of it that the believed symmetries give.

    Args:
        model: in a world whose z is up.
        frames: the current frames; those that the patches are of are looked up in them.
        config: what is believed.
    """
    copies: list[FusedModel] = []
    known = model.points
    for kind, group in symmetries(model.points):
        if kind not in config.tried:
            continue
        moved = [_moved(model, T) for T in group]
        if min(plausible(copy.points, model.patches, frames, config.tolerance_m) for copy in moved) < config.least:
            continue
        for copy in moved:
            new = KDTree(known).query(copy.points)[0] > config.new_m
            if not new.any():
                continue
            copies.append(replace(copy, points=copy.points[new], colors=copy.colors[new], seen_by=copy.seen_by[new]))
            known = np.concatenate([known, copy.points[new]])
    return united([model, *copies]) if copies else model


def symmetries(points: Float) -> Iterator[tuple[Kind, list[Float]]]:
    """Groups of (4, 4) isometries about a vertical axis of (N, 3) points: revolution, half turn, two mirrors."""
    middle, (width, depth), angle = cv2.minAreaRect(points[:, :2].astype(np.float32))
    center = np.array([*middle, 0.0])
    if min(width, depth) > 0.9 * max(width, depth):
        yield "revolution", [_about(center, _turn(2 * np.pi * k / _TURNS)) for k in range(1, _TURNS)]
    yield "half_turn", [_about(center, _turn(np.pi))]
    for way in (np.deg2rad(angle), np.deg2rad(angle) + np.pi / 2):
        normal = np.array([np.cos(way), np.sin(way), 0.0])
        yield "mirror", [_about(center, np.eye(3) - 2 * np.outer(normal, normal))]


def plausible(points: Float, patches: Sequence[Patch], frames: Sequence[Frame], tolerance_m: float) -> float:
    """The least share, over all views, of (N, 3) points that a view does not contradict.

    It contradicts a point that would be seen before what was measured at its pixel, or beside the object's mask with
    nothing before it.
    """
    least = 1.0
    for patch in patches:
        frame = next(frame for frame in frames if frame.rgb is patch.rgb)
        assert frame.depth is not None
        pixels, depth = project(frame.camera.K, invert(frame.camera.T_world_camera), points)
        height, width = frame.depth.shape
        seen = np.isfinite(pixels).all(axis=1)
        x, y = np.rint(pixels[seen]).astype(int).T
        inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
        x, y, depth = x[inside], y[inside], depth[seen][inside]
        measured = frame.depth[y, x]
        near = cv2.dilate(patch.mask.astype(np.uint8), np.ones((5, 5), np.uint8))[y, x] > 0
        before = (measured > 0) & (depth < measured - tolerance_m)
        if len(depth):
            least = min(least, 1 - float(np.mean(before | (~near & (depth < measured + tolerance_m)))))
    return least


def _moved(model: FusedModel, T: Float) -> FusedModel:
    """A model as an isometry moves it; a reflection shows its pictures mirrored."""
    patches = tuple(
        replace(p, points=_at(T, p.points), observation=(T[:3, :3] @ p.observation).astype(p.observation.dtype))
        for p in model.patches
    )
    return replace(model, points=_at(T, model.points), patches=patches)


def _at(T: Float, points: Float) -> Float:
    return transform_points(T, points).astype(np.float32)


def _turn(angle: float) -> Float:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _about(center: Float, R: Float) -> Float:
    return make_transform(R, center - R @ center)
