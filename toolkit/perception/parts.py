"""What a pipeline is made of: one implementation of every stage, the pipeline's own settings, a seed and a clock."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from pydantic import Field, field_validator

from toolkit.perception.meter import Meter
from toolkit.perception.stages import (
    Associator,
    Descriptor,
    Explainer,
    Index,
    Matcher,
    PnP,
    Refiner,
    Registration,
    Retriever,
    Segmenter,
)
from toolkit.registry import PluginConfig


class PipelineSettings(PluginConfig):
    """What the pipeline itself decides, besides its stages."""

    views: int | Literal["all"] = Field(
        default="all", description="Number of current frames that are used, evenly spaced from the first one; or all."
    )
    fuse: Literal["all", "first"] = Field(
        default="all",
        description="Solve from all accepted candidates of the instance, or from the first accepted (the paper).",
    )
    min_matches: int = Field(
        default=6, ge=3, description="Number of lifted matches that a candidate needs to be accepted."
    )
    assignment: Literal["vote", "global", "truth"] = Field(
        default="vote",
        description="Goal objects choose their instance on their own (the paper), each instance is given once, or "
        "every object gets its true one (to measure what retrieval costs).",
    )
    crop_margin: float = Field(
        default=0.05, ge=0, le=1, description="Free border of a crop, as a part of the longer side of its box."
    )

    @field_validator("views")
    @classmethod
    def _some(cls, views: int | str) -> int | str:
        if views != "all" and int(views) < 1:
            raise ValueError("at least one current frame is needed")
        return views


_DEFAULTS = PipelineSettings()


@dataclass(frozen=True)
class Stages:
    """One implementation for every stage of the perception module."""

    registration: Registration
    segmenter: Segmenter
    goal_segmenter: Segmenter
    associator: Associator
    explainer: Explainer
    descriptor: Descriptor
    index: Index
    retriever: Retriever
    matcher: Matcher
    pnp: PnP
    refiner: Refiner


@dataclass(frozen=True)
class Parts:
    """What every step of the pipeline is given.

    Args:
        stages: the implementations.
        settings: the pipeline's own choices.
        seed: makes every random choice; the same seed gives the same bytes.
        meter: where stage times go; share it with caching wrappers.
    """

    stages: Stages
    settings: PipelineSettings = _DEFAULTS
    seed: int = 0
    meter: Meter = field(default_factory=Meter)
