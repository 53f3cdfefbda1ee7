"""Whether frames of one scene agree: what one of them measures, no other may look through."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from toolkit.geometry import invert, project
from toolkit.perception.checks.sighting import Sighting
from toolkit.types import Float

_REACH = 0.02
"""Depths within this part of themselves are the same: noise of a sensor, and poses some millimetres off."""

_OTHERS = 8
"""Frames that one is compared with, evenly spread over the capture."""

_FEW = 500
"""With as many points as these compared, what they say counts half."""

_TURNED_DEG, _CONTRADICTED, _OFF_TABLE = 2.0, 0.25, 0.35


@dataclass(frozen=True, eq=False)
class Agreement:
    """How frames agree under some poses of their cameras.

    Attributes:
        spread_deg: how far the frames' tables are turned against each other, degrees, by the median.
        overlap: 0..1, part of the bare table that another frame has in view, on average.
        off_table: 0..1, part of the bare table seen twice that the other frame has at another depth.
        contradicted: (F,) 0..1, part of what stands on the table, seen from each frame and compared with another, that
            one of the two looks through; drawn towards 0 where little is compared.
    """

    spread_deg: float
    overlap: float
    off_table: float
    contradicted: Float

    @property
    def sound(self) -> bool:
        """Whether the poses can be right."""
        return not self.faults

    @property
    def faults(self) -> tuple[str, ...]:
        """What shows that the poses cannot be right, in words; empty where they can."""
        through = float(np.median(self.contradicted))
        said = {
            f"{through:.0%} of what one sees on the table another looks through": through >= _CONTRADICTED,
            f"{self.off_table:.0%} of the bare table is at another depth for another": self.off_table >= _OFF_TABLE,
            f"their tables are turned by {self.spread_deg:.1f} deg": self.spread_deg >= _TURNED_DEG,
        }
        return tuple(words for words, wrong in said.items() if wrong)


def agreement(sightings: Sequence[Sighting], poses: Sequence[Float]) -> Agreement:
    """Compare two or more frames pair by pair.

    Args:
        sightings: F, what each frame sees.
        poses: F (4, 4) T_world_camera to judge.
    """
    count = len(sightings)
    raised, flat = np.zeros((count, 2)), np.zeros(2)
    for i, j in _pairs(count):
        T = invert(poses[j]) @ poses[i]
        through, same, _ = _compare(sightings[i].raised, T, sightings[j])
        # A point that is looked through speaks against either frame.
        raised[[i, j]] += through, same
        flat += np.array(_compare(sightings[i].flat, T, sightings[j])) @ [[1, 0], [0, 1], [1, 0]]
    normals = np.array([T[:3, :3] @ s.plane.normal for s, T in zip(sightings, poses, strict=True)])
    mean = normals.mean(axis=0)
    turned = np.arccos((normals @ (mean / max(float(np.linalg.norm(mean)), 1e-9))).clip(-1, 1))
    shown = sum(len(sightings[i].flat) for i, _ in _pairs(count))
    return Agreement(
        float(np.degrees(np.median(turned))),
        float(flat.sum() / max(shown, 1)),
        float(flat[0] / max(flat.sum(), 1)),
        raised[:, 0] / (raised.sum(axis=1) + _FEW),
    )


def _pairs(count: int) -> list[tuple[int, int]]:
    steps = sorted({1 + k * (count - 1) // _OTHERS for k in range(_OTHERS)} & set(range(1, count)))
    return [(i, (i + step) % count) for i in range(count) for step in steps]


def _compare(points: Float, T: Float, other: Sighting) -> tuple[int, int, int]:
    """How many points, taken by `T` before the other camera, it looks through, sees as deep, and sees before."""
    frame = other.frame
    assert frame.depth is not None
    xy, depth = project(frame.camera.K, T, points)
    ahead = np.isfinite(xy).all(axis=1)
    x, y = np.rint(xy[ahead].clip(-1e6, 1e6)).astype(np.int64).T
    inside = (x >= 0) & (y >= 0) & (x < frame.camera.width) & (y < frame.camera.height)
    seen, expected = frame.depth[y[inside], x[inside]], depth[ahead][inside]
    gap = (seen / expected - 1)[seen > 0]
    return int((gap > _REACH).sum()), int((np.abs(gap) <= _REACH).sum()), int((gap < -_REACH).sum())
