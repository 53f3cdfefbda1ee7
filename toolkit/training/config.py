"""What `toolkit train` reads from experiments/train/*.yaml."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from toolkit.registry import PluginConfig
from toolkit.training.pairs import PairsConfig
from toolkit.training.pool import PoolConfig


class LoopConfig(PluginConfig):
    """Settings of the loop, the same for every network."""

    steps: int = Field(ge=1, description="Number of optimiser steps.")
    batch: int = Field(ge=1, description="Number of samples per step.")
    learning_rate: float = Field(gt=0, description="Learning rate of AdamW after the warm-up.")
    warmup: int = Field(default=200, ge=0, description="Number of steps over which the learning rate rises.")
    decay: float = Field(
        default=0.3,
        ge=0,
        le=1,
        description="Share of the steps, at the end, over which the learning rate falls to zero.",
    )
    weight_decay: float = Field(default=1e-4, ge=0, description="Weight decay of AdamW.")
    average: float = Field(
        default=0.998, ge=0, lt=1, description="Decay of the moving average of the weights, which is what is exported."
    )
    bf16: bool = Field(default=True, description="Whether forward passes are computed in bfloat16.")
    seed: int = Field(default=0, ge=0, description="Seed of weights and samples.")
    evaluate_every: int = Field(default=500, ge=1, description="Steps between evaluations.")
    checkpoint_every: int = Field(default=250, ge=1, description="Steps between checkpoints.")


class LoftrTraining(PluginConfig):
    """`toolkit train loftr`."""

    loop: LoopConfig
    pool: PoolConfig = PoolConfig()
    held_out_frames: int = Field(
        default=12, ge=2, description="Number of frames of every scene in the pool that is used for evaluation."
    )
    pairs: PairsConfig = PairsConfig()
    start: Literal["xfeat", "tabletop", "nothing"] = Field(
        default="xfeat",
        description="The weights at the start: XFeat's published ones in the backbone, the whole shipped network, or "
        "random ones.",
    )
    backbone_rate: float = Field(
        default=0.1, ge=0, description="Learning rate of XFeat's own layers, as a part of that of the other layers."
    )
    focal_gamma: float = Field(
        default=2.0, ge=0, description="Exponent of the focal loss; 0 gives plain cross-entropy."
    )
    negative_weight: float = Field(default=0.5, ge=0, description="Weight of the cells that match nothing.")
    fine_weight: float = Field(default=0.5, ge=0, description="Weight of the fine loss.")
    fine_matches: int = Field(
        default=256, ge=1, description="Number of matches of a batch on which the fine level is trained."
    )
    evaluation_pairs: int = Field(
        default=160, ge=1, description="Number of held-out pairs that are used for evaluation."
    )


class MixvprTraining(PluginConfig):
    """`toolkit train mixvpr`."""

    loop: LoopConfig
    pool: PoolConfig = PoolConfig()
    held_out_frames: int = Field(
        default=12, ge=2, description="Number of frames of every scene in the pool that is used for evaluation."
    )
    crops: PairsConfig = PairsConfig(roll_deg=15)
    crops_per_view: int = Field(default=3, ge=1, description="Number of augmented crops of every view.")
    views_per_object: int = Field(default=8, ge=2, description="Number of views of every object of a batch.")
    near_deg: float = Field(default=25.0, gt=0, description="Views whose azimuths differ by less than this are alike.")
    far_deg: float = Field(
        default=50.0, gt=0, description="Views whose azimuths differ by more than this are not alike."
    )
    view_weight: float = Field(default=0.5, ge=0, description="Weight of the loss over an object's own views.")
