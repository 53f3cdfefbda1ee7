"""The stages most tests run a pipeline with: true masks, quick parts, no refinement."""

from __future__ import annotations

from typing import Any

from toolkit.perception.pipeline import Stages
from toolkit.slots import SLOTS
from toolkit.stages import REGISTRIES

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
