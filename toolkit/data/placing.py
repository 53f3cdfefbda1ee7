"""Where objects stand in the goal and now: which are in one of them only, did not move, or are crowded."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from toolkit.data.conditions import Conditions
from toolkit.data.crowding import Crowd
from toolkit.data.layout import Placement, RestingObject, arrange
from toolkit.types import Float

Poses = dict[int, Float]
"""(4, 4) model to world by an object's number."""


@dataclass(frozen=True)
class Roles:
    """Which objects are where.

    Attributes:
        both: numbers of those that are in both scenes.
        current_only: of those that are only there now.
        goal_only: of those that are only in the goal.
        unmoved: of those that stand at their goal already.
    """

    both: tuple[int, ...]
    current_only: tuple[int, ...]
    goal_only: tuple[int, ...]
    unmoved: tuple[int, ...]


def draw_roles(count: int, conditions: Conditions, rng: np.random.Generator) -> Roles:
    """Draw each object's role by itself; at least one is in both scenes."""
    sided, leaves, stays = (rng.random(count) for _ in range(3))
    one_sided = sided < conditions.one_sided
    one_sided[int(np.argmax(sided))] = False
    both = np.flatnonzero(~one_sided).tolist()
    current_only = np.flatnonzero(one_sided & (leaves < 0.5)).tolist()
    goal_only = np.flatnonzero(one_sided & (leaves >= 0.5)).tolist()
    unmoved = [i for i in both if stays[i] < conditions.unmoved]
    return Roles(tuple(both), tuple(current_only), tuple(goal_only), tuple(unmoved))


@dataclass(frozen=True)
class Stand:
    """How an object rests, and its yaw in radians."""

    resting: RestingObject
    yaw: float


def place(
    roles: Roles,
    goal: Sequence[Stand],
    current: Sequence[Stand],
    conditions: Conditions,
    radius: float,
    clearance: float,
    rng: np.random.Generator,
) -> tuple[Poses, Poses]:
    """Poses in the goal, and now; those of objects in both scenes come first.

    Args:
        roles: of the objects.
        goal: how every object stands in the goal.
        current: how it stands now.
        conditions: how crowded they are.
        radius: of the disc they stand in, metres.
        clearance: least gap between objects that are not crowded, metres.
        rng: the source of chance.

    Raises:
        ToolkitError: the disc does not hold them.
    """
    crowd = Crowd(conditions.crowding, rng) if conditions.crowding else None
    then = dict.fromkeys((*roles.both, *roles.goal_only))
    now = dict.fromkeys((*roles.both, *roles.current_only))
    in_goal, in_current = (crowd if conditions.crowding_in in ("both", side) else None for side in ("goal", "current"))
    places = _arranged({i: goal[i] for i in then}, {}, radius, clearance, rng, in_goal)
    kept = {i: places[i] for i in roles.unmoved}
    stands = {i: goal[i] if i in kept else current[i] for i in now}
    moved = _arranged(stands, kept, radius, clearance, rng, in_current)
    return (
        {i: places[i].pose(goal[i].resting) for i in then},
        {i: moved[i].pose(stands[i].resting) for i in now},
    )


def _arranged(
    stands: Mapping[int, Stand],
    kept: Mapping[int, Placement],
    radius: float,
    clearance: float,
    rng: np.random.Generator,
    crowd: Crowd | None,
) -> dict[int, Placement]:
    ids = list(stands)
    fixed = {ids.index(i): placement for i, placement in kept.items()}
    found = arrange(
        [stands[i].resting for i in ids], [stands[i].yaw for i in ids], radius, clearance, rng, fixed, crowd
    )
    return dict(zip(ids, found, strict=True))
