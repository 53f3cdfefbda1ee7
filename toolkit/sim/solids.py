"""Solid bodies in a PyBullet client of their own: what touches what, and what lies at a point."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from toolkit.sim.bullet import silence
from toolkit.sim.client import Client
from toolkit.sim.compound import add_compound
from toolkit.types import Float

_FAR_M = 0.1
"""Bodies further apart than this have no gap that is measured."""


class Solids:
    """Convex pieces that are placed exactly and never fall; close it after use.

    Args:
        hulls: by body, its convex meshes (OBJ or STL) in the body's own coordinates.
    """

    def __init__(self, hulls: Sequence[Sequence[Path]]) -> None:
        self.client = Client()
        with silence():
            self._bodies = [self._add(pieces) for pieces in hulls]

    def close(self) -> None:
        """Disconnect the client."""
        self.client.close()

    def _add(self, pieces: Sequence[Path]) -> int:
        return int(self.client.createMultiBody(0, add_compound(self.client, pieces)))

    def place(self, number: int, T_world_body: Float) -> None:
        """Put body `number` at a (4, 4) pose."""
        self.client.place(self._bodies[number], T_world_body)

    def touching(self, number: int, depth: float) -> list[int]:
        """Numbers of the bodies that body `number` cuts into by more than `depth` metres, ascending."""
        low, high = self.client.box(self._bodies[number])
        near = self.client.getOverlappingObjects(low.tolist(), high.tolist()) or ()
        others = sorted({self._bodies.index(body) for body, _ in near} - {number})
        return [other for other in others if self.gap(number, other) < -depth]

    def gap(self, a: int, b: int) -> float:
        """Distance of two bodies, metres; negative where they cut into each other, infinite beyond 10 cm."""
        found = self.client.closest(self._bodies[a], self._bodies[b], _FAR_M)
        return min((contact.distance for contact in found), default=np.inf)

    def top(self, number: int) -> float:
        """Largest z of a body's box, metres."""
        return float(self.client.box(self._bodies[number])[1][2])

    def under(self, points: Float) -> int | None:
        """The body that vertical rays through most of (N, 3) points meet first; None where they meet none."""
        return self.client.under(points, self._bodies)
