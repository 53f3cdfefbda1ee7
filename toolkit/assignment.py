"""Which database instance each goal object is, decided together: no instance answers for two objects."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from toolkit.types import Float

_BEST_VIEWS = 3
"""An instance is as similar as its three most similar regions: one alone may be a chance, all would count its back."""


def assign_instances(similarity: Float, instances: NDArray[np.int64]) -> NDArray[np.int64]:
    """Pair goal objects with instances at the greatest total similarity (Hungarian method, SciPy).

    Args:
        similarity: (Q, R) of goal objects to database regions.
        instances: (R,) instance of every region, 0..K-1.

    Returns:
        (Q,) instances; -1 for the goal objects left over when there are more of them than instances.
    """
    count = int(instances.max()) + 1
    scores = [np.sort(similarity[:, instances == k], axis=1)[:, -_BEST_VIEWS:].mean(axis=1) for k in range(count)]
    rows, columns = linear_sum_assignment(np.stack(scores, axis=1), maximize=True)
    assigned = np.full(len(similarity), -1, np.int64)
    assigned[rows] = columns
    return assigned


def restrict(ranking: NDArray[np.int64], instances: NDArray[np.int64], instance: int) -> NDArray[np.int64]:
    """The part of a ranking of regions that belongs to one instance; all of it for -1."""
    return ranking if instance < 0 else ranking[instances[ranking] == instance]
