"""The fewest moves: a minimum feedback vertex set of the dependencies stands aside."""

from __future__ import annotations

from toolkit.rearrangement.planners.ordering.fewest import plan
from toolkit.rearrangement.planners.ordering.following import Following, FollowingConfig
from toolkit.rearrangement.stages import Planner
from toolkit.registry import Plugin


class OptimalConfig(FollowingConfig):
    """Settings of `optimal`."""


class Optimal(Plugin[OptimalConfig], Planner):
    """Fewest moves: the minimum feedback vertex set of the dependency graph stands aside; shortest order by travel."""

    stage = "planner"
    name = "optimal"

    def start(self, seed: int) -> Following:
        """Return the state of a fresh episode; the planner draws nothing at random, so `seed` has no effect."""
        return Following(plan, self.config.tries)
