"""Pairs of points of a cloud that two fingers can squeeze."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from toolkit.types import Float

_LINE_M = 0.004
"""Points this near to the line through a contact lie on it."""

_WALL_M = 0.004
"""Thickness taken for walls that are seen from one side only, or too thin to tell their sides apart."""

_BATCH = 32


@dataclass(frozen=True, eq=False)
class Contacts:
    """Pairs of opposite contacts.

    Attributes:
        first: (C, 3) world points.
        second: (C, 3) world points.
        alignment: (C,) cosine of the larger angle between the line of a pair and its two normals.
    """

    first: Float
    second: Float
    alignment: Float

    def __len__(self) -> int:
        return len(self.alignment)


def wall_pairs(points: Float, directions: Float, count: int, rng: np.random.Generator) -> Contacts:
    """Drawn points taken for thin walls, as of bowls and mugs, with a finger on each side.

    Whether there is a way in on both sides is for a collision check to say.
    """
    chosen = rng.permutation(len(points))[:count]
    half = _WALL_M / 2 * directions[chosen]
    return Contacts(points[chosen] - half, points[chosen] + half, np.ones(len(chosen)))


def last_on_lines(points: Float, starts: Float, along: Float) -> tuple[Float, NDArray[np.int64]]:
    """The last of (N, 3) points on each line from (B, 3) starts along (B, 3) unit vectors.

    Returns:
        (B,) distances along the lines, -inf where none lies on it, and (B,) indices.
    """
    offsets = points[None] - starts[:, None]
    t = np.einsum("bni,bi->bn", offsets, along)
    aside = np.linalg.norm(offsets - t[..., None] * along[:, None], axis=2)
    t[(aside >= _LINE_M) | (t <= _LINE_M)] = -np.inf
    last = t.argmax(axis=1)
    return t[np.arange(len(starts)), last], last


def span(points: Float, contact: Float, line: Float, widest: float) -> tuple[Float, Float]:
    """Two opposite contacts: the given one and the last of (N, 3) points on a line through it.

    Both ways are tried, for the longer that is no more than `widest`. Where there is none it is taken for a thin wall,
    with a finger on each side.
    """
    lengths, last = last_on_lines(points, np.stack([contact, contact]), np.stack([line, -line]))
    lengths[lengths > widest] = -np.inf
    way = int(lengths.argmax())
    if lengths[way] > 2 * _LINE_M:
        return contact, points[last[way]]
    return contact - _WALL_M / 2 * line, contact + _WALL_M / 2 * line


def antipodal_pairs(
    points: Float, directions: Float, widest: float, friction: float, count: int, rng: np.random.Generator
) -> Contacts:
    """Pairs that are in force closure with friction (Nguyen, "Constructing force-closure grasps", IJRR 1988).

    From drawn points, along their normals, to the last point on that line within the opening: the line must lie in the
    friction cones of both.

    Args:
        points: (N, 3) the object's surface, metres.
        directions: (N, 3) its normals, signs open.
        widest: longest pair.
        friction: coefficient of Coulomb friction.
        count: points drawn.
        rng: the only source of chance.
    """
    chosen = rng.permutation(len(points))[:count]
    limit = np.cos(np.arctan(friction))
    pairs: list[tuple[Float, Float, Float]] = []
    for start in range(0, len(chosen), _BATCH):
        batch = chosen[start : start + _BATCH]
        for sign in (1.0, -1.0):
            along = sign * directions[batch]
            longest, last = last_on_lines(points, points[batch], along)
            fits = (longest > 2 * _LINE_M) & (longest <= widest)
            a, b = points[batch[fits]], points[last[fits]]
            line = (b - a) / np.linalg.norm(b - a, axis=1, keepdims=True)
            cosines = np.stack(
                [
                    np.abs((line * directions[batch[fits]]).sum(axis=1)),
                    np.abs((line * directions[last[fits]]).sum(axis=1)),
                ]
            )
            closed = cosines.min(axis=0) >= limit
            pairs.append((a[closed], b[closed], cosines.min(axis=0)[closed]))
    first, second, alignment = (np.concatenate(parts) for parts in zip(*pairs, strict=True))
    return Contacts(first, second, alignment)
