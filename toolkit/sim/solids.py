"""Solid bodies in a PyBullet client of their own: what touches what, and what lies at a point."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from toolkit.sim.bullet import pybullet, silence
from toolkit.sim.compound import add_compound
from toolkit.types import Float

_RAY_TOP_M = 2.0
_RAY_BELOW_M = 0.003


class Solids:
    """Convex pieces that are placed exactly and never fall; close it after use.

    Args:
        hulls: by body, its convex meshes (OBJ or STL) in the body's own coordinates.
    """

    def __init__(self, hulls: Sequence[Sequence[Path]]) -> None:
        self.client: int = pybullet.connect(pybullet.DIRECT)
        with silence():
            self._bodies = [self._add(pieces) for pieces in hulls]

    def close(self) -> None:
        """Disconnect the client."""
        with silence():
            pybullet.disconnect(self.client)

    def _add(self, pieces: Sequence[Path]) -> int:
        shape = add_compound(self.client, pieces)
        return int(pybullet.createMultiBody(0, shape, physicsClientId=self.client))

    def place(self, number: int, T_world_body: Float) -> None:
        """Put body `number` at a (4, 4) pose."""
        quaternion = Rotation.from_matrix(T_world_body[:3, :3]).as_quat()
        pybullet.resetBasePositionAndOrientation(
            self._bodies[number], T_world_body[:3, 3].tolist(), quaternion.tolist(), physicsClientId=self.client
        )

    def touching(self, number: int, depth: float) -> list[int]:
        """Numbers of the bodies that body `number` cuts into by more than `depth` metres, ascending."""
        low, high = pybullet.getAABB(self._bodies[number], physicsClientId=self.client)
        near = pybullet.getOverlappingObjects(low, high, physicsClientId=self.client) or ()
        others = sorted({self._bodies.index(body) for body, _ in near} - {number})
        return [other for other in others if self.gap(number, other) < -depth]

    def gap(self, a: int, b: int) -> float:
        """Distance of two bodies, metres; negative where they cut into each other, infinite beyond 10 cm."""
        found = pybullet.getClosestPoints(self._bodies[a], self._bodies[b], 0.1, physicsClientId=self.client)
        return min((contact[8] for contact in found), default=np.inf)

    def top(self, number: int) -> float:
        """Largest z of a body's box, metres."""
        return float(pybullet.getAABB(self._bodies[number], physicsClientId=self.client)[1][2])

    def under(self, points: Float) -> int | None:
        """The body that vertical rays through most of (N, 3) points meet first; None where they meet none."""
        above = np.column_stack([points[:, :2], np.full(len(points), _RAY_TOP_M)])
        below = points - np.array([0, 0, _RAY_BELOW_M])
        hits = pybullet.rayTestBatch(above.tolist(), below.tolist(), physicsClientId=self.client)
        counts = Counter(self._bodies.index(hit[0]) for hit in hits if hit[0] in self._bodies)
        return min(counts, key=lambda number: (-counts[number], number), default=None)
