"""How likely a placement is right: that it is one whole object, this instance, and that it stands there."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from toolkit.geometry import invert, project
from toolkit.perception.explainers.searching.evidence import MOST_COST
from toolkit.perception.explainers.searching.jointly import Candidate, Composition, change, compose
from toolkit.perception.fusion import FusedModel
from toolkit.perception.tabletop.joining import are_close, kinship
from toolkit.perception.tabletop.table import Table
from toolkit.types import Camera, Float, Mask

_WEIGHTS = {
    "agreement": 4.0,
    "gain": 3.0,
    "visible": 1.0,
    "inside": 1.0,
    "height": 1.0,
    "alone": 1.0,
    "apart": 1.0,
    "lead": 1.0,
    "size": 0.0,
    "still": 0.5,
    "whole": 1.0,
    "framed": 1.0,
    "views": 0.5,
}
_BIAS = -6.0

_TALL_M = 0.03
_LARGE_PX = 5000.0
_ELSEWHERE_M, _ELSEWHERE_RAD = 0.02, 0.2
"""A candidate this far from the chosen one is another answer."""


def judge(
    instance: int,
    chosen: Mapping[int, Candidate],
    options: Sequence[Candidate],
    models: Mapping[int, FusedModel],
    background: Float,
    table: Table,
    camera: Camera,
) -> dict[str, float]:
    """What a placement is judged by, each from 0 (bad) to 1.

    Args:
        instance: the instance placed.
        chosen: all candidates of the explanation, by instance.
        options: all candidates of this instance.
        models: of all instances.
        background: (H, W) cost of the image without any of them.
        table: the table.
        camera: the goal image's.

    Returns:
        By name: `agreement` with the pixels it shows in; `gain` over the empty table there; `visible`, the part of it
        that nothing hides, and `inside`, the part that lies in the image; `height` above the table; `alone`, how little
        it looks like a part of something larger; `apart`, the part of its outline that borders on no object which is
        close to it in space; `lead` over its next best place, or over being absent; `size`;
        `still`, 1 where it was not moved; `whole`, the segmenter's confidence in its segments; `framed`, the part of
        the frames that saw it where no border of the image cuts it; `views`, the part of the frames that saw it.
    """
    model, own = models[instance], chosen[instance]
    empty = background.ravel()
    drawn = compose(chosen, empty)
    pixels = np.flatnonzero(drawn.owner == instance)
    count = max(len(pixels), 1)
    T = table.T_world_table
    heights = (model.points - T[:3, 3]) @ T[:3, 2]
    others = [other for i, other in models.items() if i != instance]
    return {
        "agreement": 1 - float(drawn.cost[pixels].sum()) / count / MOST_COST,
        "gain": float((empty[pixels] - drawn.cost[pixels]).sum()) / count / MOST_COST,
        "visible": len(pixels) / max(len(own.rendering.pixels), 1),
        "inside": _inside(model, own.T_goal_current, camera),
        "height": min(float(np.percentile(heights, 95)) / _TALL_M, 1.0),
        "alone": 1 - max((kinship(model, other) for other in others), default=0.0),
        "apart": _apart(instance, drawn.owner.reshape(background.shape), models),
        "lead": _lead(instance, chosen, options, empty, model) / count / MOST_COST,
        "size": min(len(pixels) / _LARGE_PX, 1.0),
        "still": float(not own.moved),
        "whole": model.score,
        "framed": float(np.mean([not _is_cut(patch.mask) for patch in model.patches])),
        "views": float(len(model.patches) / max(len(table.frames), 1)),
    }


def trust(judged: Mapping[str, float]) -> float:
    """Probability 0..1, by logistic regression (experiments/benchmarks/trust.py) on what `judge` returns."""
    return float(1 / (1 + np.exp(-(sum(_WEIGHTS[name] * value for name, value in judged.items()) + _BIAS))))


def _inside(model: FusedModel, T_goal_current: Float, camera: Camera) -> float:
    """Share of the model that lies in the image."""
    pixels, _ = project(camera.K, invert(camera.T_world_camera) @ T_goal_current, model.points.astype(np.float64))
    size = np.array([camera.width, camera.height])
    return float(((pixels >= 0) & (pixels <= size - 1)).all(axis=1).mean())


def _apart(instance: int, owner: NDArray[np.int64], models: Mapping[int, FusedModel]) -> float:
    """Share of an object's outline in (H, W) owners along which no object is seen that it touches."""
    own = (owner == instance).astype(np.uint8)
    around = owner[(cv2.dilate(own, np.ones((3, 3), np.uint8)) > 0) & (own == 0)]
    if not len(around):
        return 1.0
    touching = [
        i for i in np.unique(around[around >= 0]).tolist() if are_close(models[i].points, models[instance].points)
    ]
    return 1 - float(np.isin(around, touching).mean())


def _is_cut(mask: Mask) -> bool:
    """Whether an object reaches the border of an image."""
    return bool(mask[[0, -1]].any() or mask[:, [0, -1]].any())


def _lead(
    instance: int,
    chosen: Mapping[int, Candidate],
    options: Sequence[Candidate],
    background: Float,
    model: FusedModel,
) -> float:
    """By how much the explanation would cost more without it, or with it elsewhere."""
    drawn: Composition = compose({i: c for i, c in chosen.items() if i != instance}, background)
    own = chosen[instance]
    elsewhere = [change(drawn, c) for c in options if _is_elsewhere(c, own, model)]
    return min([0.0, *elsewhere]) - change(drawn, own)


def _is_elsewhere(candidate: Candidate, own: Candidate, model: FusedModel) -> bool:
    between = invert(own.T_goal_current) @ candidate.T_goal_current
    shift = float(np.linalg.norm(between[:3, :3] @ model.center + between[:3, 3] - model.center))
    turn = float(np.arccos(((np.trace(between[:3, :3]) - 1) / 2).clip(-1, 1)))
    return shift > _ELSEWHERE_M or turn > _ELSEWHERE_RAD
