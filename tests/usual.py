"""The stages most tests run a pipeline with: true masks, quick parts, no refinement."""

from __future__ import annotations

from typing import Any

from toolkit.pipeline import Stages
from toolkit.stages import (
    ASSOCIATORS,
    DESCRIPTORS,
    INDEXES,
    MATCHERS,
    PNP,
    REFINERS,
    REGISTRATIONS,
    RETRIEVERS,
    SEGMENTERS,
)


def usual_stages(**chosen: Any) -> Stages:
    """The usual stages, some of them replaced."""
    oracle = SEGMENTERS.create("oracle")
    usual = {
        "registration": REGISTRATIONS.create("none"),
        "segmenter": oracle,
        "goal_segmenter": oracle,
        "associator": ASSOCIATORS.create("oracle"),
        "descriptor": DESCRIPTORS.create("color_hist"),
        "index": INDEXES.create("numpy"),
        "retriever": RETRIEVERS.create("instance_vote"),
        "matcher": MATCHERS.create("sift"),
        "pnp": PNP.create("poselib"),
        "refiner": REFINERS.create("none"),
    }
    return Stages(**usual | chosen)
