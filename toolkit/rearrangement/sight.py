"""From pose estimates to what a planner sees: where every object stands, and where it is to go."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from pydantic import Field
from scipy.optimize import linear_sum_assignment

from toolkit.geometry import rotation_angle, transform_points
from toolkit.perception.pipeline import Pipeline
from toolkit.perception.scene import Scene
from toolkit.rearrangement.footprints import Footprint
from toolkit.rearrangement.hidden import empty_below, hidden_space
from toolkit.rearrangement.moves import Item, Layout, Move, Outcome, PickPlace
from toolkit.registry import PluginConfig
from toolkit.types import Failure, Float, Frame, PoseEstimate

_SAME_OBJECT_M = 0.05


class SightSettings(PluginConfig):
    """How estimates become goals."""

    settled_cm: float = Field(
        1.0,
        ge=0,
        description="An object stays where it is when its motion is shorter than this, and turns it by less than "
        "`settled_deg`.",
    )
    settled_deg: float = Field(
        2.5,
        ge=0,
        description="Smallest turn of an object that is moved although its motion is shorter than `settled_cm`.",
    )
    radius_m: float = Field(0.5, gt=0, description="Objects are put down inside this disc around the table's centre.")
    clearance_m: float = Field(0.0, description="Footprints closer than this collide.")


@dataclass(frozen=True, eq=False)
class Sight:
    """What one look at the table says.

    Attributes:
        layout: one item per instance, in the order of their ids.
        clouds: by instance, its (N, 3) points.
        estimates: one per goal object.
        goal_objects: by instance, the goal object it is taken for.
        failures: by goal object, why it has no motion.
        hidden: by instance, (M, 3) middles of the space around it that nobody saw into (`hidden_space`).
        unknown: (K, 3) those of such space elsewhere.
        empty: by instance, (E, 3) points just below its own where it was seen not to be (`empty_below`).
    """

    layout: Layout
    clouds: Mapping[int, Float]
    estimates: tuple[PoseEstimate, ...]
    goal_objects: Mapping[int, int]
    failures: Mapping[int, Failure]
    hidden: Mapping[int, Float]
    unknown: Float
    empty: Mapping[int, Float]

    def obstacles(self, instance: int) -> Float:
        """(M, 3) points of everything but an instance: what was seen of it, and where nobody saw that there is nothing.

        What only the instance hides is not in it, since a gripper that takes hold of it must go there.
        """
        full = (*self.clouds.items(), *self.hidden.items())
        return np.concatenate([self.unknown, *(points for other, points in full if other != instance)])

    def request(self, move: Move) -> PickPlace:
        """What an executor is asked for, to make a move."""
        own = move.object
        return PickPlace(self.clouds[own], move.T_place_pick, self.obstacles(own), self.empty[own])

    def after(self, move: Move) -> Sight:
        """What there is to see when `move` was carried out as meant."""
        T, moved = move.T_place_pick, move.object
        return replace(
            self,
            layout=self.layout.after(move),
            clouds={**self.clouds, moved: transform_points(T, self.clouds[moved])},
            hidden={**self.hidden, moved: transform_points(T, self.hidden[moved])},
            empty={**self.empty, moved: transform_points(T, self.empty[moved])},
        )

    def after_outcome(self, move: Move, outcome: Outcome) -> Sight:
        """What there is to see when `move` had that outcome: the object where the executor says that it is now."""
        T = outcome.T_moved
        if T is None:
            return self if outcome.failure is not None else self.after(move)
        footprint = Footprint.of(transform_points(T, self.clouds[move.object]))
        to = move.to if outcome.failure is None else "buffer"
        return self.after(replace(move, T_place_pick=T, footprint=footprint, to=to))


def look(pipeline: Pipeline, frames: Sequence[Frame], goal: Frame, settings: SightSettings) -> Sight:
    """Estimate every motion, and say what stands where, in the world of the frames.

    Raises:
        ToolkitError: a stage refuses its input.
    """
    scene = pipeline.scene(pipeline.build_database(frames))
    return in_sight(scene, scene.estimate(goal), settings)


def in_sight(
    scene: Scene, estimates: Sequence[PoseEstimate], settings: SightSettings, T_to_world: Float | None = None
) -> Sight:
    """What stands where, and where it is to go. Everything that plans moves takes the table for z = 0.

    An instance that several goal objects claim goes to the one of them that is surest.

    Args:
        scene: as the goal of the estimates showed it.
        estimates: one per goal object.
        settings: how they become goals.
        T_to_world: (4, 4) from the scene's world into the one that is answered in; the scene's own when left out.
    """
    frames, clouds = scene.database.frames, {i: points for i, (points, _) in scene.clouds().items()}
    if T_to_world is not None:
        estimates = [estimate.in_world(T_to_world) for estimate in estimates]
        frames = tuple(frame.moved(T_to_world) for frame in frames)
        clouds = {i: transform_points(T_to_world, points) for i, points in clouds.items()}
    failures = {e.goal_object: e.failure for e in estimates if e.failure is not None}
    claims: dict[int, PoseEstimate] = {}
    for estimate in sorted(estimates, key=_sureness, reverse=True):
        if estimate.T_goal_current is None or estimate.instance is None:
            continue
        if estimate.instance in claims:
            first = claims[estimate.instance].goal_object
            reason = f"goal object {first} is taken for the same object, with more confidence"
            failures[estimate.goal_object] = Failure("retriever", reason)
        else:
            claims[estimate.instance] = estimate
    items = tuple(_item(instance, own, claims.get(instance), settings) for instance, own in clouds.items())
    layout = Layout(items, radius=settings.radius_m, clearance=settings.clearance_m)
    goal_objects = {i: e.goal_object for i, e in claims.items()}
    empty = {instance: empty_below(frames, points) for instance, points in clouds.items()}
    return Sight(layout, clouds, tuple(estimates), goal_objects, failures, *hidden_space(frames, clouds), empty)


def correct(before: Sight, now: Sight) -> Sight:
    """The newer look with the objects named as before, each after the nearest one within 5 cm.

    An object that is not seen again stays as it was; one that was not there before is left out.
    """
    was = np.array([item.footprint.center for item in before.layout.items]).reshape(-1, 2)
    is_now = np.array([item.footprint.center for item in now.layout.items]).reshape(-1, 2)
    distances = np.linalg.norm(was[:, None] - is_now[None], axis=2)
    items, clouds = list(before.layout.items), dict(before.clouds)
    hidden, empty = dict(before.hidden), dict(before.empty)
    for i, j in zip(*linear_sum_assignment(distances), strict=True):
        if distances[i, j] <= _SAME_OBJECT_M:
            seen = now.layout.items[j]
            items[i] = replace(seen, object=items[i].object)
            clouds[items[i].object] = now.clouds[seen.object]
            hidden[items[i].object] = now.hidden[seen.object]
            empty[items[i].object] = now.empty[seen.object]
    layout = replace(before.layout, items=tuple(items))
    return replace(before, layout=layout, clouds=clouds, hidden=hidden, unknown=now.unknown, empty=empty)


def _sureness(estimate: PoseEstimate) -> float:
    return 1.0 if estimate.confidence is None else estimate.confidence


def _item(instance: int, cloud: Float, estimate: PoseEstimate | None, settings: SightSettings) -> Item:
    if estimate is None or estimate.T_goal_current is None:
        return Item.seen(instance, cloud, None)
    alike = [estimate.T_goal_current, *(estimate.equivalents if estimate.equivalents is not None else ())]
    settled = any(_stays(T, cloud, settings) for T in alike)
    return Item.seen(instance, cloud, estimate.T_goal_current, confidence=_sureness(estimate), settled=settled)


def _stays(T: Float, cloud: Float, settings: SightSettings) -> bool:
    center = (cloud.min(axis=0) + cloud.max(axis=0)) / 2
    shift_cm = 100 * float(np.linalg.norm(transform_points(T, center) - center))
    return shift_cm < settings.settled_cm and np.degrees(rotation_angle(T[:3, :3])) < settings.settled_deg
