"""How likely a placement is right: that this is the instance, and that its segment is its own."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from toolkit.perception.explainers.searching.evidence import MOST_COST
from toolkit.perception.explainers.searching.jointly import Candidate, compose
from toolkit.types import Float

_WEIGHTS = np.array([4.0, 3.0, 1.0])
_BIAS = -3.0


def features(instance: int, chosen: Mapping[int, Candidate], background: Float) -> Float:
    """What a placement is judged by.

    Args:
        instance: the instance.
        chosen: all candidates of the explanation, by instance.
        background: (P,) cost of the image without any of them.

    Returns:
        (3,) how well it agrees with the pixels it shows in, how much better than the empty table, and which part of it
        nothing hides.
    """
    drawn = compose(chosen, background)
    own = np.flatnonzero(drawn.owner == instance)
    if not len(own):
        return np.zeros(3)
    agreement = 1 - float(drawn.cost[own].mean()) / MOST_COST
    gain = float((background[own] - drawn.cost[own]).mean()) / MOST_COST
    visible = len(own) / max(len(chosen[instance].rendering.pixels), 1)
    return np.array([agreement, gain, visible])


def trust(instance: int, chosen: Mapping[int, Candidate], options: Sequence[Candidate], background: Float) -> float:
    """Probability 0..1; arguments as `features`, with all candidates of the instance."""
    return float(1 / (1 + np.exp(-(features(instance, chosen, background) @ _WEIGHTS + _BIAS))))
