"""Every region is a candidate: the method the paper argues against, kept to measure what retrieval saves."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from toolkit.perception.retrieval.candidates.distance import geodesic_distance
from toolkit.perception.retrieval.candidates.traversal import PrunedTraversal
from toolkit.perception.stages import Retriever
from toolkit.registry import Plugin
from toolkit.types import Float


class BruteForce(Plugin, Retriever):
    """All regions of all instances in database order; similarity and rejections are ignored (Sec. Method A)."""

    stage = "retriever"
    name = "brute_force"

    def start(self, ranking: NDArray[np.int64], instances: NDArray[np.int64], observations: Float) -> PrunedTraversal:
        """Return the traversal of the whole database."""
        return PrunedTraversal(sorted(ranking.tolist()), lambda _a, _b: False, observations, geodesic_distance, 0.0)
