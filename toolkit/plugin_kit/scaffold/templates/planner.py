"""template: a planner. Whatever can go to its goal goes; where all wait for each other, one stands aside."""

from __future__ import annotations

import numpy as np
from pydantic import Field

from toolkit.rearrangement.footprints import planar_motion
from toolkit.rearrangement.moves import Finished, Item, Layout, Move
from toolkit.registry import Plugin, PluginConfig
from toolkit.stages import Planner, Schedule
from toolkit.types import Failure


class TemplateConfig(PluginConfig):
    """Settings of `template`."""

    tries: int = Field(200, ge=1, description="Places drawn for an object that stands aside.")
    moves: int = Field(4, ge=1, description="Moves per object, at most.")


class Template(Plugin[TemplateConfig], Planner):
    """Greedy: the nearest goal that is free first; without one, an object moves aside to a place drawn at random."""

    stage = "planner"
    name = "template"

    def start(self, seed: int) -> Greedy:
        """Begin a rearrangement."""
        return Greedy(self.config, np.random.default_rng(seed))


class Greedy(Schedule):
    """The moves of one rearrangement, from where things stand at every call."""

    def __init__(self, config: TemplateConfig, rng: np.random.Generator) -> None:
        self._config, self._rng = config, rng
        self._moved: dict[int, int] = {}

    def next(self, layout: Layout) -> Move | Finished:
        """Return the next move, or Finished with the reason for every object that is not at its goal."""
        waiting = [i for i in layout.items if i.wanted and self._moved.get(i.object, 0) < self._config.moves]
        move = self._to_a_goal(waiting, layout) or self._aside(waiting, layout)
        if move is None:
            left = [item.object for item in layout.items if item.wanted]
            return Finished(dict.fromkeys(left, Failure("planner", "its goal is not free, and nothing can make room")))
        self._moved[move.object] = self._moved.get(move.object, 0) + 1
        return move

    def _to_a_goal(self, waiting: list[Item], layout: Layout) -> Move | None:
        moves = [item.to_goal() for item in waiting]
        free = [m for m in moves if layout.holds(m.footprint) and not layout.in_the_way(m.footprint, of=m.object)]
        return min(free, key=lambda m: float(np.linalg.norm(m.T_place_pick[:2, 3])), default=None)

    def _aside(self, waiting: list[Item], layout: Layout) -> Move | None:
        for item in waiting:
            goals = [other.goal for other in waiting if other.goal is not None]
            for place in self._places(layout):
                footprint = item.footprint.moved(place - item.footprint.center)
                if not layout.holds(footprint) or layout.in_the_way(footprint, of=item.object):
                    continue
                if all(np.linalg.norm(goal.center - place) > goal.width + footprint.width for goal in goals):
                    T = planar_motion(item.footprint.center, place - item.footprint.center)
                    return Move(item.object, T, footprint, "buffer", "its goal is not free")
        return None

    def _places(self, layout: Layout) -> np.ndarray:
        distance = layout.radius * np.sqrt(self._rng.random(self._config.tries))
        angle = 2 * np.pi * self._rng.random(self._config.tries)
        return np.array(layout.center) + (distance * np.array([np.cos(angle), np.sin(angle)])).T
