"""Which database instance each goal object is, decided together: no instance answers for two objects."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from toolkit.errors import ToolkitError
from toolkit.perception.database import Database
from toolkit.perception.regions import true_owner
from toolkit.types import Float, Frame, Mask, Segment

_BEST_VIEWS = 3
"""An instance is as similar as its three most similar regions: one may be similar by chance, all include the back."""

_CONTENDER = 0.15
"""Instances less similar than the best by more than this are not looked at more closely."""

_UNSEEN = 1.0
"""Verification score of a pair that is not verified because it has no rival: about the score of right pairs."""


def instance_similarity(similarity: Float, instances: NDArray[np.int64]) -> Float:
    """(Q, K) similarity of goal objects to instances, from (Q, R) similarity to regions and their (R,) instances."""
    count = int(instances.max()) + 1
    best = [np.sort(similarity[:, instances == k], axis=1)[:, -_BEST_VIEWS:].mean(axis=1) for k in range(count)]
    return np.stack(best, axis=1)


def contenders(scores: Float) -> Mask:
    """(Q, K) bool, the instances that descriptors alone cannot tell apart; no row has just one of them."""
    close = scores >= scores.max(axis=1, keepdims=True) - _CONTENDER
    return close & (close.sum(axis=1, keepdims=True) > 1)


def assign_instances(scores: Float, verified: Float) -> NDArray[np.int64]:
    """Pair goal objects with instances at the greatest total score (Hungarian method, SciPy).

    Args:
        scores: (Q, K) similarity by descriptors.
        verified: (Q, K) agreement of the instance's model with the goal object, NaN where that was not looked at; all
            NaN leaves it to the descriptors.

    Returns:
        (Q,) instances; -1 for the goal objects left over when there are more of them than instances.
    """
    unseen = np.isnan(verified)
    # A pair without a rival was not looked at; it must not lose against one that was.
    alone = unseen.all(axis=1, keepdims=True) & ~unseen.all() & (scores == scores.max(axis=1, keepdims=True))
    rows, columns = linear_sum_assignment(scores + np.where(alone, _UNSEEN, np.nan_to_num(verified)), maximize=True)
    assigned = np.full(len(scores), -1, np.int64)
    assigned[rows] = columns
    return assigned


def restrict(ranking: NDArray[np.int64], instances: NDArray[np.int64], instance: int) -> NDArray[np.int64]:
    """The part of a ranking of regions that belongs to one instance; all of it for -1."""
    return ranking if instance < 0 else ranking[instances[ranking] == instance]


def true_instances(database: Database, goal: Frame, segments: Sequence[Segment]) -> NDArray[np.int64]:
    """The instance that shows each goal object most often, by the true masks of all images.

    Returns:
        (Q,) instances; -1 for a segment on no object, or on one that no region shows.

    Raises:
        ToolkitError: the goal image or a frame has no true masks.
    """
    shown: dict[int, Counter[int]] = {}
    for row, region in enumerate(database.regions):
        owner = _owner(database.frame_of(row), region.segment.mask)
        shown.setdefault(owner, Counter())[int(database.instances[row])] += 1
    owners = [_owner(goal, segment.mask) for segment in segments]
    found = [shown[owner].most_common(1)[0][0] if owner >= 0 and owner in shown else -1 for owner in owners]
    return np.array(found, np.int64)


def _owner(frame: Frame, mask: Mask) -> int:
    if frame.true_masks is None:
        raise ToolkitError(f"assignment truth needs true masks (mask_visib/), and frame {frame.index} has none")
    return true_owner(frame.true_masks, mask)
