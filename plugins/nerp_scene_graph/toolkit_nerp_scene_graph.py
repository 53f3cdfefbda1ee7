"""nerp_scene_graph: goal objects and instances, paired as the nodes of two graphs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any
from weakref import WeakKeyDictionary

import cv2
import numpy as np
from pydantic import Field
from scipy.special import logsumexp

from toolkit.errors import ToolkitError
from toolkit.geometry import invert, lift, project
from toolkit.perception.crops import crop_region
from toolkit.perception.fusion import FusedModel, Models, RefineTask
from toolkit.perception.refiners.comparing.rotations import yaw_rotations
from toolkit.registry import Plugin, PluginConfig
from toolkit.stages import DESCRIPTORS, REFINERS, Refiner
from toolkit.types import Failure, Float, Frame, Image, Mask, Refined, Segment

_BEST_VIEWS = 3
"""A node looks like another as much as its three most similar views do."""

_CALIPERS = 8
"""Directions across the picture in which silhouettes are measured."""

_OUTLINE = 400
"""Directions in which a cloud's outermost points are kept: no silhouette needs others."""

_SWEEPS = 50


class NerpSceneGraphConfig(PluginConfig):
    """Settings of `nerp_scene_graph`."""

    base: str = Field(default="render_compare", description="The refiner that finds the motions.")
    base_settings: dict[str, Any] = Field(default_factory=dict[str, Any], description="Settings of `base`.")
    descriptor: str = Field(default="color_hist", description="The descriptor that describes how a node looks.")
    rounds: int = Field(
        default=4, ge=0, description="Number of rounds of messages along the edges; with 0, only the nodes count."
    )
    edges: float = Field(default=1.0, ge=0, description="Weight of the edges relative to the nodes.")
    yaws: int = Field(
        default=36,
        ge=4,
        description="Number of turns about the vertical in which the silhouette of an instance is measured.",
    )
    silhouette: float = Field(
        default=0.1, gt=0, description="Standard deviation of the widths of silhouettes, as a share of the width."
    )
    color: float = Field(default=8.0, gt=0, description="Standard deviation of mean colours, in CIE Lab.")
    temperature: float = Field(
        default=0.05,
        gt=0,
        description="Temperature of the assignment: with a small one the best pair takes all, with a large one "
        "beliefs stay spread.",
    )


DEFAULTS = NerpSceneGraphConfig()


@dataclass(frozen=True, eq=False)
class Pairs:
    """What is known of every pair of a goal object and an instance: Q goal objects, K instances.

    Attributes:
        likeness: (Q, K) 0..1, how alike the two look.
        fit: (Q, K) least root mean square log ratio of their silhouettes' widths, over all yaws.
        change: (Q, K, 4) what the instance would have changed by: log size, and mean L, a, b.
    """

    likeness: Float
    fit: Float
    change: Float


_Beliefs = dict[tuple[tuple[int, int], ...], Float]
"""Signatures of all goal objects -> what was made of them, so that asking for every pair costs one matching."""


class NerpSceneGraph(Plugin[NerpSceneGraphConfig], Refiner):
    """Tells which goal object is which instance by matching two graphs, in the manner of NeRP (Qureshi et al. 2021).

    It answers `verify`, which `assignment: global` asks; motions are the base refiner's.
    """

    stage = "refiner"
    name = "nerp_scene_graph"

    def __init__(self, config: NerpSceneGraphConfig | None = None) -> None:
        super().__init__(config)
        if self.config.base == self.name:
            raise ToolkitError(f"refiner '{self.name}' needs another one as its base")
        self._base: Any = REFINERS.create(self.config.base, self.config.base_settings)
        self._descriptor: Any = DESCRIPTORS.create(self.config.descriptor)
        self._known: WeakKeyDictionary[Models, WeakKeyDictionary[Frame, _Beliefs]] = WeakKeyDictionary()

    def check_ready(self) -> None:
        """Base and descriptor must be ready."""
        self._base.check_ready()
        self._descriptor.check_ready()

    def digests(self) -> dict[str, str]:
        """The weights of base and descriptor."""
        return {**self._base.digests(), **self._descriptor.digests()}

    def refine(self, task: RefineTask) -> Refined | Failure | None:
        """The base's answer."""
        return self._base.refine(task)

    def verify(self, task: RefineTask) -> float | None:
        """Return the belief 0..1 that the instance is the goal object; None where the instance has no model."""
        models, model = task.models.all(), task.models.get(task.instance)
        if isinstance(model, Failure):
            return None
        segments = sorted((task.segment, *task.others), key=_signature)
        known = self._known.setdefault(task.models, WeakKeyDictionary()).setdefault(task.goal, {})
        key = tuple(map(_signature, segments))
        if key not in known:
            known[key] = match(self.pairs(task.goal, segments, models), self.config)
        column = next(i for i, other in enumerate(models) if other is model)
        return float(known[key][segments.index(task.segment), column])

    def pairs(self, goal: Frame, segments: Sequence[Segment], models: Sequence[FusedModel]) -> Pairs:
        """Compare every goal object with every model."""
        fit, size = compare_silhouettes(goal, segments, models, self.config.yaws)
        before = np.array([mean_lab(model.colors) for model in models])
        after = np.array([mean_lab(goal.rgb[segment.mask]) for segment in segments])
        change = np.concatenate([size[..., None], after[:, None] - before[None]], axis=-1)
        queries = self._describe([(goal.rgb, segment.mask) for segment in segments])
        views = [self._describe([(patch.rgb, patch.mask) for patch in model.patches]) for model in models]
        likeness = [np.sort(queries @ rows.T, axis=1)[:, -_BEST_VIEWS:].mean(axis=1) for rows in views]
        return Pairs(np.stack(likeness, axis=1), fit, change)

    def _describe(self, seen: Sequence[tuple[Image, Mask]]) -> Float:
        size = self._descriptor.crop_size
        return self._descriptor.describe([crop_region(rgb, Segment(mask), size) for rgb, mask in seen])


def match(pairs: Pairs, settings: NerpSceneGraphConfig = DEFAULTS) -> Float:
    """Beliefs that goal objects are instances, by graduated assignment (Gold and Rangarajan, PAMI 1996).

    A node's own evidence is how alike the pair looks and how well its silhouettes fit. An edge compares the relation of
    two goal objects, their relative size and contrast, with that of two instances: both are alike where the two pairs
    have changed by the same. So a change that is common to all, such as one of light or scale, counts against none.

    Returns:
        (Q, K) in 0..1; no row and no column sums to more than 1.
    """
    nodes = 0.5 * (pairs.likeness + np.exp(-0.5 * (pairs.fit / settings.silhouette) ** 2))
    scale = np.array([settings.silhouette, *[settings.color] * 3])
    apart = (pairs.change[:, :, None, None] - pairs.change[None, None]) / scale
    edges = np.exp(-0.5 * (apart**2).mean(axis=-1))
    q, k = map(np.arange, nodes.shape)
    edges[q, :, q] = edges[:, k, :, k] = 0  # nothing has an edge to itself
    beliefs = softassign(nodes / settings.temperature)
    for _ in range(settings.rounds):
        messages = np.einsum("iajb,jb->ia", edges, beliefs) / max(1, len(nodes) - 1)
        beliefs = softassign((nodes + settings.edges * messages) / settings.temperature)
    return beliefs


def softassign(scores: Float) -> Float:
    """(Q, K) beliefs from (Q, K) scores: exp, then rows and columns normalised in turn (Sinkhorn).

    The smaller side is filled up by nodes that are like none, so that of the larger one some stay free.
    """
    q, k = scores.shape
    n = max(q, k)
    logits = np.full((n, n), scores.min())
    logits[:q, :k] = scores
    for _ in range(_SWEEPS):
        logits = logits - logsumexp(logits, axis=0, keepdims=True)
        logits = logits - logsumexp(logits, axis=1, keepdims=True)
    return np.exp(logits)[:q, :k]


def compare_silhouettes(
    goal: Frame, segments: Sequence[Segment], models: Sequence[FusedModel], yaws: int
) -> tuple[Float, Float]:
    """How the goal's silhouettes differ from those that the models would have in their places.

    The goal image has no depth: a model is put where the ray through the middle of the mask is as high as the model's
    middle is now, since objects stay on the table, in every yaw. Widths are compared in 8 directions.

    Returns:
        (Q, K) least root mean square log ratio of the widths over the yaws, infinite where there is no such place, and
        (Q, K) the mean log ratio there, 0 where there is none.
    """
    wanted = [np.log(_widths(np.argwhere(segment.mask)[:, ::-1].astype(np.float64)) + 1) for segment in segments]
    fit, size = np.zeros((2, len(segments), len(models)))
    for column, model in enumerate(models):
        turned = (_outermost(model.points) - model.center) @ np.swapaxes(yaw_rotations(yaws), 1, 2)
        for row, segment in enumerate(segments):
            place = _place(goal, segment, model.center[2])
            points = (turned + place).reshape(-1, 3)
            pixels, _ = project(goal.camera.K, invert(goal.camera.T_world_camera), points)
            ratios = wanted[row] - np.log(_widths(pixels.reshape(yaws, -1, 2)) + 1)
            errors = np.nan_to_num(np.sqrt((ratios**2).mean(axis=-1)), nan=np.inf)
            best = errors.argmin()
            fit[row, column], size[row, column] = errors[best], np.nan_to_num(ratios[best].mean())
    return fit, size


def mean_lab(colors: Float | Image) -> Float:
    """(3,) mean CIE Lab of (N, 3) RGB, 0..255."""
    rgb = np.asarray(colors, np.float32)[None] / 255
    return np.asarray(cv2.cvtColor(rgb, cv2.COLOR_RGB2LAB), np.float64)[0].mean(axis=0)


def _place(goal: Frame, segment: Segment, height: float) -> Float:
    """(3,) point on the ray through the middle of the mask's box at world z `height`; NaN where it is not in view."""
    x0, y0, x1, y1 = segment.bbox_xyxy
    eye = goal.camera.T_world_camera[:3, 3]
    middle = np.array([[(x0 + x1) / 2, (y0 + y1) / 2]])
    ray = lift(goal.camera.K, goal.camera.T_world_camera, middle, np.ones(1))[0] - eye
    t = (height - eye[2]) / ray[2] if abs(ray[2]) > 1e-9 else -1.0
    return eye + t * ray if t > 0 else np.full(3, np.nan)


def _widths(pixels: Float) -> Float:
    """(..., 8) extents of (..., N, 2) pixels in as many directions."""
    angles = np.pi * np.arange(_CALIPERS) / _CALIPERS
    along = pixels @ np.stack([np.cos(angles), np.sin(angles)])
    return along.max(axis=-2) - along.min(axis=-2)


def _outermost(points: Float) -> Float:
    """The points of (N, 3) that are furthest in one of many directions."""
    rng = np.random.default_rng(0)
    directions = rng.normal(size=(3, _OUTLINE)).astype(np.float32)
    return points[np.unique((points @ directions).argmax(axis=0))].astype(np.float64)


def _signature(segment: Segment) -> tuple[int, int]:
    """First pixel and area: they tell disjoint segments apart, and order them."""
    return int(segment.mask.argmax()), int(segment.mask.sum())
