"""Monte-Carlo tree search over arrangements (Labbe et al., RA-L 2020)."""

from __future__ import annotations

import numpy as np
from pydantic import Field

from toolkit.rearrangement.planners.arrangements.growth import solved
from toolkit.rearrangement.planners.arrangements.table import Step, Table
from toolkit.rearrangement.planners.arrangements.tree import tree_search
from toolkit.rearrangement.planners.ordering.following import Following, FollowingConfig
from toolkit.rearrangement.stages import Planner
from toolkit.registry import Plugin


class MctsConfig(FollowingConfig):
    """Settings of `mcts`."""

    iterations: int = Field(10_000, ge=1, description="Arrangements looked at in a search.")
    exploration: float = Field(0.2, ge=0, description="How much little-tried moves are favoured, in objects.")


class Mcts(Plugin[MctsConfig], Planner):
    """Monte-Carlo tree search over arrangements; the reward is the number of objects at their goals."""

    stage = "planner"
    name = "mcts"

    def start(self, seed: int) -> Following:
        config = self.config
        gave_up = f"no way was found in {config.iterations} iterations"

        def search(table: Table, rng: np.random.Generator) -> list[Step]:
            return tree_search(table, rng, config.iterations, config.exploration)

        return Following(lambda layout: solved(layout, search, seed, gave_up), config.tries)
