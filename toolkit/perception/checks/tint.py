"""Whether red and blue lie in each other's place: the table, and what stands on it, then have the opposite tint."""

from __future__ import annotations

import cv2
import numpy as np
import scipy

from toolkit.perception.checks.likeness import from_above, surely_bare
from toolkit.perception.tabletop.plane import on_plane
from toolkit.perception.tabletop.table import Table
from toolkit.types import Finding, Float, Frame, Image

_OTHER, _BETTER = 0.4, 0.5
"""The table's tint is this far off as it is, and by no more than this part of that with red and blue swapped. Other
light, and another white balance, move it by less; a table of hardly any tint never does."""

_LEAST_CELLS = 1000
"""Of the table's plan (`from_above`): where fewer are seen in both, nothing is said."""

_OWN, _FEW = 0.15, 50
"""What is nearer than this to the table's tint may be the table; fewer pixels of other things say nothing."""

_AROUND_PX, _DARK = 5, 8.0
_THINNED = 37

_DOUBT = 0.3


def check_tint(goal: Frame, table: Table) -> list[Finding]:
    """Compare the colours of a goal image with those of the current frames, given that it shows their table."""
    now, then = _of_the_table(goal, table)
    if len(now) < _LEAST_CELLS:
        return []
    as_it_is, swapped = (float(np.median(np.abs(then - sign * now))) for sign in (1, -1))
    if as_it_is < _OTHER or swapped > _BETTER * as_it_is:
        return []
    things_now, things_then = _of_things(goal, table, float(np.median(now)), float(np.median(then)))
    enough = min(len(things_now), len(things_then)) >= _FEW
    if enough and _distance(things_now, things_then) < _distance(things_now, -things_then):
        return []
    sentence = "red and blue look swapped in the goal image, or in the current ones: the table has the opposite tint"
    remedy = "store all of them in one order (cv2.imwrite takes BGR)"
    return [Finding("doubtful", f"{sentence}; {remedy}", _DOUBT, shown="table")]


def _distance(now: Float, then: Float) -> float:
    return float(scipy.stats.wasserstein_distance(now, then))


def _of_the_table(goal: Frame, table: Table) -> tuple[Float, Float]:
    """The tints (N,) of places on the table, in the current frames that show them bare, and in the goal."""
    views = [from_above(table, f.camera, _tint(f.rgb), surely_bare(f, plane)) for f, plane in table.seen()]
    tints = np.stack([np.where(bare, tint, np.nan) for tint, bare in views])
    then, seen = from_above(table, goal.camera, _tint(goal.rgb), np.ones(goal.rgb.shape[:2], bool))
    both = seen & np.isfinite(tints).any(axis=0)
    return np.nanmedian(tints[:, both], axis=0), then[both]


def _of_things(goal: Frame, table: Table, now: float, then: float) -> tuple[Float, Float]:
    """Tints of what is not of the table's, `now` and `then`, before it: in the current frames, and in the goal."""
    current = [
        _tint(f.rgb)[table.surface(f.camera) & ~on_plane(plane, f) & (f.depth > 0)][::_THINNED]
        for f, plane in table.seen()
        if f.depth is not None
    ]
    things_now, things_then = np.concatenate(current), _tint(goal.rgb)[table.surface(goal.camera)][::_THINNED]
    return things_now[np.abs(things_now - now) > _OWN], things_then[np.abs(things_then - then) > _OWN]


def _tint(rgb: Image) -> Float:
    """(H, W) float32 logarithm of red over blue, of a pixel's surroundings; with the two swapped, its negative."""
    around = cv2.blur(np.ascontiguousarray(rgb), (_AROUND_PX, _AROUND_PX)).astype(np.float32) + _DARK
    return np.log(around[..., 0] / around[..., 2])
