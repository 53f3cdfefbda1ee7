"""How likely a placement is right: that it is one whole object, this instance, and that it stands there."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from toolkit.geometry import is_same_motion
from toolkit.perception.explainers.searching.evidence import MOST_COST
from toolkit.perception.explainers.searching.jointly import Candidate, Composition, change, compose
from toolkit.perception.fusion import FusedModel
from toolkit.perception.tabletop.joining import kinship
from toolkit.perception.tabletop.table import Table
from toolkit.types import Float

_WEIGHTS = {
    "agreement": 1.66,
    "visible": 1.1,
    "height": 1.44,
    "alone": 1.15,
    "lead": 3.04,
    "size": 2.56,
    "still": -0.21,
    "whole": 3.88,
    "views": 1.81,
}
_BIAS = -10.93
"""Logistic regression on procedural objects (experiments/benchmarks/trust.py), wrong answers counted eight times."""

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
) -> dict[str, float]:
    """What a placement is judged by, each from 0 (bad) to 1.

    Args:
        instance: the instance placed.
        chosen: all candidates of the explanation, by instance.
        options: all candidates of this instance.
        models: of all instances.
        background: (P,) cost of the image without any of them.
        table: the table.

    Returns:
        By name: `agreement` with the pixels it shows in; `visible`, the part of it that nothing hides; `height` above
        the table; `alone`, how little it looks like a part of something larger; `lead` over its next best place, or
        over being absent; `size`; `still`, 1 where it was not moved; `whole`, the segmenter's confidence in its
        segments; `views`, the part of the frames that saw it.
    """
    model, own = models[instance], chosen[instance]
    drawn = compose(chosen, background)
    pixels = np.flatnonzero(drawn.owner == instance)
    count = max(len(pixels), 1)
    T = table.T_world_table
    heights = (model.points - T[:3, 3]) @ T[:3, 2]
    others = [other for i, other in models.items() if i != instance]
    return {
        "agreement": 1 - float(drawn.cost[pixels].sum()) / count / MOST_COST,
        "visible": len(pixels) / max(len(own.rendering.pixels), 1),
        "height": min(float(np.percentile(heights, 95)) / _TALL_M, 1.0),
        "alone": 1 - max((kinship(model, other) for other in others), default=0.0),
        "lead": _lead(instance, chosen, options, background, model) / count / MOST_COST,
        "size": min(len(pixels) / _LARGE_PX, 1.0),
        "still": float(not own.moved),
        "whole": model.score,
        "views": float(len(model.patches) / max(len(table.frames), 1)),
    }


def trust(judged: Mapping[str, float]) -> float:
    """Probability 0..1 that it is a whole object, times that of being right, from what `judge` returns."""
    evidence = sum(weight * judged[name] for name, weight in _WEIGHTS.items()) + _BIAS
    return judged["whole"] * float(1 / (1 + np.exp(-evidence)))


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
    elsewhere = [
        change(drawn, c)
        for c in options
        if not is_same_motion(c.T_goal_current, own.T_goal_current, model.center, _ELSEWHERE_RAD, _ELSEWHERE_M)
    ]
    return min([0.0, *elsewhere]) - change(drawn, own)
