"""Single images: too dark, too bright, and depth in steps."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from toolkit.types import Finding, Float, Frame, Image

_DARK, _BRIGHT = 25, 250
_MOST_BRIGHT = 0.6
_LEAST_STEP, _PIXELS = 0.05, 500
_PART = 50
"""One depth in so many mostly shows that they take many values."""

_DOUBT = 0.3


def check_exposure(frames: Sequence[Frame]) -> list[Finding]:
    """Leave out current images in which next to nothing is to be seen, or doubt them where all are so."""
    bad = {frame.index: wrong for frame in frames if (wrong := _exposure(frame.rgb)) is not None}
    if len(bad) < len(frames):
        return [
            Finding("left out", f"current image {i} is {why} and is not used", frames=(i,)) for i, why in bad.items()
        ]
    sentence = f"every current image is {' or '.join(sorted(set(bad.values())))}; take them again in other light"
    return [Finding("doubtful", sentence, _DOUBT)]


def check_goal_exposure(goal: Frame) -> list[Finding]:
    """Doubt a goal image in which next to nothing is to be seen."""
    wrong = _exposure(goal.rgb)
    if wrong is None:
        return []
    return [Finding("doubtful", f"the goal image is {wrong}; take it again in other light", _DOUBT)]


def _exposure(rgb: Image) -> str | None:
    small = rgb[::4, ::4]
    if np.percentile(small, 95) < _DARK:
        return "nearly black"
    return "overexposed" if (small.min(axis=2) > _BRIGHT).mean() > _MOST_BRIGHT else None


def check_steps(frames: Sequence[Frame]) -> list[Finding]:
    """Refuse depth that was rounded to whole metres or the like."""
    for frame in frames:
        assert frame.depth is not None
        measured = frame.depth[frame.depth > 0]
        if len(measured) <= _PIXELS:
            continue
        most = _LEAST_STEP * float(np.median(measured))
        if 0 < _step(np.unique(measured[::_PART])) <= most:
            continue  # between more depths the least step is no larger
        levels = np.unique(measured)
        step = _step(levels)
        if len(levels) == 1 or step > most:
            apart = f", {step:.2g} m apart" if step else ""
            sentence = f"the depth of current frame {frame.index} takes only {len(levels)} values{apart}"
            remedy = "was it rounded to whole metres? Write millimetres, or finer, as 16-bit numbers"
            return [Finding("refused", f"{sentence}; {remedy}")]
    return []


def _step(levels: Float) -> float:
    """The least difference of ascending levels; 0 for fewer than two."""
    return float(np.diff(levels).min()) if len(levels) > 1 else 0.0
