"""The order in which candidates are tried, with those close to a rejected one skipped."""

from __future__ import annotations

from collections.abc import Callable

from toolkit.perception.stages import Traversal
from toolkit.types import Float

Distance = Callable[[Float, Float], Float]


class PrunedTraversal(Traversal):
    """Candidates in a given order; a rejection deletes the waiting ones that look from a similar direction.

    Args:
        order: database rows, best first.
        same_object: says of two rows whether they are of one instance; only those prune each other.
        observations: (R, 3) observation vectors of all database rows.
        distance: angle between observation vectors, radians.
        prune: rows closer than this to a rejected one are deleted, radians; 0 deletes none.
    """

    def __init__(
        self,
        order: list[int],
        same_object: Callable[[int, int], bool],
        observations: Float,
        distance: Distance,
        prune: float,
    ) -> None:
        self._waiting = order
        self._same_object = same_object
        self._observations = observations
        self._distance = distance
        self._prune = prune

    def next(self, n: int) -> list[int]:
        """Return and remove up to n waiting rows."""
        taken, self._waiting = self._waiting[:n], self._waiting[n:]
        return taken

    def reject(self, region: int) -> None:
        """Delete waiting rows of the same object seen from about where `region` was seen."""
        if not self._waiting or self._prune == 0:
            return
        angles = self._distance(self._observations[self._waiting], self._observations[region])
        self._waiting = [
            row
            for row, angle in zip(self._waiting, angles, strict=True)
            if angle >= self._prune or not self._same_object(row, region)
        ]
