"""Tabletop rearrangement with lazy buffers (Gao et al., ICRA 2022)."""

from __future__ import annotations

import numpy as np
from pydantic import Field

from toolkit.rearrangement.planners.arrangements.growth import solved
from toolkit.rearrangement.planners.arrangements.lazy import running_buffers
from toolkit.rearrangement.planners.arrangements.table import Step, Table
from toolkit.rearrangement.planners.ordering.following import Following, FollowingConfig
from toolkit.rearrangement.stages import Planner
from toolkit.registry import Plugin


class TrlbConfig(FollowingConfig):
    """Settings of `trlb`."""

    plans: int = Field(100, ge=1, description="Plans tried, each from an arrangement that another one reached.")


class Trlb(Plugin[TrlbConfig], Planner):
    """Fewest objects aside at a time, their places chosen once it is known what comes into their way."""

    stage = "planner"
    name = "trlb"

    def start(self, seed: int) -> Following:
        config = self.config
        gave_up = f"no way was found in {config.plans} plans"

        def search(table: Table, rng: np.random.Generator) -> list[Step]:
            return running_buffers(table, rng, config.plans)

        return Following(lambda layout: solved(layout, search, seed, gave_up), config.tries)
