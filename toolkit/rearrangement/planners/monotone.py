"""The monotone solver, and objects put aside at random where that is not enough (Krontiris and Bekris; Wang et al.)."""

from __future__ import annotations

import numpy as np
from pydantic import Field

from toolkit.rearrangement.planners.arrangements.growth import solved
from toolkit.rearrangement.planners.arrangements.perturbation import perturbed
from toolkit.rearrangement.planners.arrangements.table import Step, Table
from toolkit.rearrangement.planners.ordering.following import Following, FollowingConfig
from toolkit.rearrangement.stages import Planner
from toolkit.registry import Plugin


class MonotoneConfig(FollowingConfig):
    """Settings of `monotone`."""

    perturbations: int = Field(
        1000, ge=0, description="Times an object is put aside and the rest solved anew; 0 is the monotone solver alone."
    )


class Monotone(Plugin[MonotoneConfig], Planner):
    """One move per object where that is enough; else a search that puts one object aside at a time."""

    stage = "planner"
    name = "monotone"

    def start(self, seed: int) -> Following:
        config = self.config
        gave_up = f"no way was found in {config.perturbations} perturbations"

        def search(table: Table, rng: np.random.Generator) -> list[Step]:
            return perturbed(table, rng, config.perturbations)

        return Following(lambda layout: solved(layout, search, seed, gave_up), config.tries)
