"""What `toolkit train` reads from experiments/train/*.yaml."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from toolkit.registry import PluginConfig
from toolkit.training.pairs import PairsConfig
from toolkit.training.pool import PoolConfig


class LoopConfig(PluginConfig):
    """Settings of the loop, the same for every network."""

    steps: int = Field(ge=1, description="Optimiser steps.")
    batch: int = Field(ge=1, description="Samples a step.")
    learning_rate: float = Field(gt=0, description="AdamW's, after the warm-up.")
    warmup: int = Field(default=200, ge=0, description="Steps over which the learning rate rises.")
    decay: float = Field(default=0.3, ge=0, le=1, description="Last part of the steps over which it falls to zero.")
    weight_decay: float = Field(default=1e-4, ge=0, description="AdamW's.")
    average: float = Field(
        default=0.998, ge=0, lt=1, description="Of the moving average of the weights, which is exported."
    )
    bf16: bool = Field(default=True, description="Forward passes in bfloat16.")
    seed: int = Field(default=0, ge=0, description="Seed of weights and samples.")
    evaluate_every: int = Field(default=500, ge=1, description="Steps between evaluations.")
    checkpoint_every: int = Field(default=250, ge=1, description="Steps between checkpoints.")


class LoftrTraining(PluginConfig):
    """`toolkit train loftr`."""

    loop: LoopConfig
    pool: PoolConfig = PoolConfig()
    held_out_frames: int = Field(
        default=12, ge=2, description="Frames of every scene of the pool that is evaluated on."
    )
    pairs: PairsConfig = PairsConfig()
    start: Literal["xfeat", "tabletop", "nothing"] = Field(
        default="xfeat",
        description="First weights: XFeat's published ones in the backbone, the whole shipped network, or random.",
    )
    backbone_rate: float = Field(
        default=0.1, ge=0, description="Learning rate of XFeat's own layers, as a part of the others'."
    )
    focal_gamma: float = Field(default=2.0, ge=0, description="Exponent of the focal loss; 0 is plain cross-entropy.")
    negative_weight: float = Field(default=0.5, ge=0, description="Weight of the cells that match nothing.")
    fine_weight: float = Field(default=0.5, ge=0, description="Weight of the fine loss.")
    fine_matches: int = Field(default=256, ge=1, description="Matches of a batch the fine level is trained on.")
    evaluation_pairs: int = Field(default=160, ge=1, description="Held-out pairs evaluated on.")


class MixvprTraining(PluginConfig):
    """`toolkit train mixvpr`."""

    loop: LoopConfig
    pool: PoolConfig = PoolConfig()
    held_out_frames: int = Field(
        default=12, ge=2, description="Frames of every scene of the pool that is evaluated on."
    )
    crops: PairsConfig = PairsConfig(roll_deg=15)
    crops_per_view: int = Field(default=3, ge=1, description="Augmented crops of every view.")
    views_per_object: int = Field(default=8, ge=2, description="Views of every object of a batch.")
    near_deg: float = Field(default=25.0, gt=0, description="Views within this azimuth are alike.")
    far_deg: float = Field(default=50.0, gt=0, description="Views beyond it are not.")
    view_weight: float = Field(default=0.5, ge=0, description="Weight of the loss over an object's own views.")
