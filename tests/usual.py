"""Stages that most tests run a pipeline with: true masks, quick parts, no refinement; a matcher that does as told."""

from __future__ import annotations

from typing import Any

import numpy as np

from toolkit.perception.pipeline import Stages
from toolkit.slots import SLOTS
from toolkit.stages import REGISTRIES, Matcher
from toolkit.types import Matches

USUAL = {
    "segmenter": "oracle",
    "goal_segmenter": "oracle",
    "associator": "oracle",
    "descriptor": "color_hist",
    "index": "numpy",
    "retriever": "instance_vote",
    "matcher": "sift",
    "pnp": "poselib",
}
"""What stands under `pipeline` in the experiments of tests."""


def usual_stages(**chosen: Any) -> Stages:
    """The usual stages, some of them replaced."""
    left = {slot: stage for slot, stage in SLOTS.items() if slot not in chosen}
    return Stages(**{slot: REGISTRIES[stage].create(USUAL.get(slot, "none")) for slot, stage in left.items()}, **chosen)


MANY = 12
"""Matches of a reference that has any."""


class Scripted(Matcher):
    """Finds many matches on the references whose turn, from 0, is in `good`, and none on the others."""

    crop_size = 96

    def __init__(self, good):
        self.good, self.batches = good, []

    def extract(self, crops):
        return list(crops)

    def match(self, query, references):
        turn = sum(self.batches)
        self.batches.append(len(references))
        return [on_object(r) if turn + k in self.good else Matches.empty() for k, r in enumerate(references)]


def on_object(crop):
    """Matches at pixels well inside a crop's mask."""
    y, x = np.nonzero(crop.mask)
    inner = np.flatnonzero(np.hypot(x - x.mean(), y - y.mean()) < 8)[:MANY]
    xy = np.stack([x[inner], y[inner]], axis=1).astype(np.float64)
    return Matches(xy, xy, np.ones(len(xy)))
