"""From the hand's pose to joint angles: IK solutions by their nearness, and straight lines of the hand."""

from __future__ import annotations

import numpy as np

from toolkit.geometry import make_transform
from toolkit.sim.kinematics import Chain
from toolkit.types import Float

_RANDOM_STARTS = 11
_ALIKE_RAD = 0.05
_STEP_M = 0.01
_JUMP_RAD = 0.4
"""A joint that turns further than this in one step along a line has changed over to another solution."""


class Inverse:
    """Inverse kinematics of one arm; it does not know what the arm touches.

    Args:
        chain: the arm.
        seed: of the starts that solutions are looked for from.
    """

    def __init__(self, chain: Chain, seed: int) -> None:
        self._chain = chain
        rng = np.random.default_rng(seed)
        low, high = np.maximum(chain.lower, -np.pi), np.minimum(chain.upper, np.pi)
        self._starts = rng.uniform(low, high, (_RANDOM_STARTS, len(low)))

    def solve(self, hand: Float, near: Float) -> list[Float]:
        """(J,) solutions for a (4, 4) pose of the hand, the nearest to `near` first.

        Of joints without limits, the turn nearest to it.
        """
        chain = self._chain
        found = chain.solve(hand, np.concatenate([near[None], near + 0.3 * (self._starts - near), self._starts]))
        endless = chain.upper >= 2 * np.pi
        turned = near + (found - near + np.pi) % (2 * np.pi) - np.pi
        found = np.where(endless & (np.abs(turned) <= chain.upper), turned, found)
        order = np.argsort(np.abs(found - near).max(axis=1), kind="stable")
        unlike: list[Float] = []
        for q in found[order]:
            if all(np.abs(q - other).max() > _ALIKE_RAD for other in unlike):
                unlike.append(q)
        return unlike

    def line(self, q: Float, by: Float, least_m: float | None = None) -> Float | None:
        """(N, J) joint angles along a straight line (3,) of the hand from where it is at `q`.

        None where it gets stuck, unless it has come `least_m` by then: the part up to there.
        """
        start = self._chain.end(q)
        count = steps(float(np.linalg.norm(by)))
        path = [q]
        for part in np.linspace(0, 1, count + 1)[1:]:
            found = self._chain.solve(shifted(start, part * by), path[-1][None])
            if not len(found) or np.abs(found[0] - path[-1]).max() > _JUMP_RAD:
                break
            path.append(found[0])
        enough = count if least_m is None else steps(least_m)
        return np.array(path) if len(path) > enough else None


def steps(length_m: float) -> int:
    """Steps in which a line of this length is walked."""
    return max(1, int(np.ceil(length_m / _STEP_M - 1e-9)))


def shifted(T: Float, by: Float) -> Float:
    """A (4, 4) pose moved by (3,), without turning."""
    return make_transform(T[:3, :3], T[:3, 3] + by)
