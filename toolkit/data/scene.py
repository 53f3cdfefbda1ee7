"""One scene of the tabletop benchmark: what stands where, before and after, and who looks at it from where."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import Field

from toolkit.data.cameras import Resolution, current_cameras, goal_camera
from toolkit.data.conditions import Conditions, ConditionSettings, draw_conditions
from toolkit.data.layout import RestingObject, hull_points, resting_poses
from toolkit.data.lookalikes import Lookalikes, with_lookalikes
from toolkit.data.objects import ObjectAsset, ObjectSet
from toolkit.data.placing import Stand, draw_roles, place
from toolkit.data.scenery.hands import Look, draw_hands
from toolkit.data.scenery.props import Prop
from toolkit.data.table import Table, draw_table
from toolkit.data.visibility import visible_shares
from toolkit.errors import ToolkitError
from toolkit.geometry import transform_points
from toolkit.sim.bullet import Renderer, best_renderer
from toolkit.types import Camera, Float, Placed, TrueObject

_LEAST_SEEN = 0.4
"""Part of an object's outline that is seen in the goal image, and in one of the current frames."""

_REDRAWS = 100


class TabletopConfig(ConditionSettings):
    """Settings of the tabletop benchmark."""

    objects: str = Field("procedural", description="'procedural', or a folder of scanned objects.")
    scenes: int = Field(150, ge=1, description="Number of scenes.")
    seed: int = Field(0, ge=0, description="Benchmark seed.")
    min_objects: int = Field(1, ge=1, description="Smallest number of objects in a scene.")
    max_objects: int = Field(9, ge=1, description="Largest number of objects in a scene.")
    rotation_deg: float = Field(
        180.0,
        ge=0,
        le=180,
        description="Objects are turned by at most this between goal and now, either way, in degrees.",
    )
    views: int = Field(
        8, ge=1, le=256, description="Current frames, the first from the home view; in the wild track, the most."
    )
    resolution: Resolution = Field("640x480", description="Image size.")
    poses: Literal["upright", "stable"] = Field(
        "upright",
        description="How objects rest: in their natural pose, or in another stable pose in the goal than now, so "
        "that motions have six degrees of freedom.",
    )
    lookalikes: Lookalikes = Field(
        "none", description="Whether every second object repeats the one before it: as a twin, or in other colours."
    )
    radius_m: float = Field(
        0.40,
        gt=0,
        le=0.40,
        description="Radius of the disc in which objects stand; an arm at the edge of the table does not reach all "
        "of 0.4.",
    )
    clearance_m: float = Field(0.01, ge=0, description="Least gap between objects, except between crowded ones.")
    renderer: Renderer = Field(
        default_factory=best_renderer,
        description="PyBullet's EGL plug-in where it loads, else TinyRenderer.",
    )
    supersample: int = Field(2, ge=1, le=4, description="For TinyRenderer: rendered pixels per pixel and axis.")


@dataclass(frozen=True, eq=False)
class TabletopScene:
    """What stands where, before and after.

    Attributes:
        config: the benchmark's settings.
        number: of the scene in the benchmark.
        conditions: what this scene is like.
        table: what the objects stand on.
        assets: the objects that are there now; an object's position is its instance id.
        current: (4, 4) model to world of every one of them now.
        goal: the same in the goal scene, of the first of them: the others are not in the goal.
        goal_only: objects that are not there now, and their (4, 4) places in the goal; their ids go on counting.
        goal_camera: takes the goal image.
        cameras: take the current frames.
        hand: reaches into some pictures.
        goal_hand: (4, 4) hand to world in the goal image.
        hands: the same in every current frame.
    """

    config: TabletopConfig
    number: int
    conditions: Conditions
    table: Table
    assets: tuple[ObjectAsset, ...]
    current: tuple[Float, ...]
    goal: tuple[Float, ...]
    goal_only: tuple[tuple[ObjectAsset, Float], ...]
    goal_camera: Camera
    cameras: tuple[Camera, ...]
    hand: Prop | None
    goal_hand: Float
    hands: tuple[Float, ...]

    @property
    def truth(self) -> dict[int, TrueObject]:
        """True objects that are in both scenes, by instance id."""
        poses = zip(self.assets, self.current, self.goal, strict=False)
        return {i: TrueObject(asset.model, current, goal, i) for i, (asset, current, goal) in enumerate(poses)}

    @property
    def only_current(self) -> dict[int, Placed]:
        """Objects that are there now and not in the goal, by instance id."""
        first = len(self.goal)
        placed = zip(self.assets[first:], self.current[first:], strict=True)
        return {first + i: Placed(asset.model, pose) for i, (asset, pose) in enumerate(placed)}

    @property
    def only_goal(self) -> dict[int, Placed]:
        """Objects that are in the goal and not there now, by instance id."""
        first = len(self.assets)
        return {first + i: Placed(asset.model, pose) for i, (asset, pose) in enumerate(self.goal_only)}


def scene_generator(config: TabletopConfig, number: int, purpose: str) -> np.random.Generator:
    """The source of chance for one purpose in one scene, whatever else is drawn."""
    return np.random.default_rng(np.random.SeedSequence([config.seed, number, *purpose.encode()]))


def draw_scene(config: TabletopConfig, objects: ObjectSet, number: int, cache: Path) -> TabletopScene:
    """Draw what stands where in scene `number`; files of recoloured objects are kept below `cache`.

    Raises:
        ToolkitError: there are fewer objects than asked for, or no arrangement of them was found that the table holds
            and the cameras see.
    """
    rng = scene_generator(config, number, "layout")
    most = config.max_objects
    if config.min_objects > most:
        raise ToolkitError(f"dataset: min_objects is {config.min_objects}, more than max_objects, {most}")
    if most > len(objects.assets):
        raise ToolkitError(f"dataset: max_objects is {most}, but '{objects.name}' has {len(objects.assets)} objects")
    count = int(rng.integers(config.min_objects, most + 1))
    chosen = sorted(rng.choice(len(objects.assets), count, replace=False).tolist())
    assets = with_lookalikes([objects.assets[i] for i in chosen], config.lookalikes, cache)
    rests = [resting_poses(asset) for asset in assets]
    now = [rest[0] for rest in rests]
    then = [_other(rest, rng) for rest in rests] if config.poses == "stable" else now
    yaws = rng.uniform(-np.pi, np.pi, count)
    turns = np.radians(rng.uniform(-config.rotation_deg, config.rotation_deg, count))
    goal_stands = [Stand(rest, float(yaw)) for rest, yaw in zip(then, yaws, strict=True)]
    stands = [Stand(rest, float(yaw)) for rest, yaw in zip(now, yaws + turns, strict=True)]

    conditions = draw_conditions(config, scene_generator(config, number, "conditions"))
    table = draw_table(conditions.table_shape, config.radius_m, scene_generator(config, number, "table"))
    roles = draw_roles(count, conditions, scene_generator(config, number, "roles"))
    viewpoints = scene_generator(config, number, "cameras")
    for _ in range(_REDRAWS):
        goal, current = place(roles, goal_stands, stands, conditions, config.radius_m, config.clearance_m, rng)
        looks = [
            Look(goal_camera(conditions, config.resolution, viewpoints), _bodies(assets, goal)),
            *(
                Look(camera, _bodies(assets, current))
                for camera in current_cameras(conditions, config.resolution, config.views, viewpoints)
            ),
        ]
        # On the predefined views all is seen of objects that stand apart.
        if _predefined(conditions) or (_all_seen(looks[:1]) and _all_seen(looks[1:])):
            break
    else:
        raise ToolkitError(
            f"scene {number}: no arrangement was found in which the cameras see every object; ask for fewer with "
            "dataset.max_objects, or for less dataset.crowding"
        )
    hand, reaching = draw_hands(conditions.hands, looks, scene_generator(config, number, "hands"))
    return TabletopScene(
        config=config,
        number=number,
        conditions=conditions,
        table=table,
        assets=tuple(assets[i] for i in current),
        current=tuple(current.values()),
        goal=tuple(goal[i] for i in roles.both),
        goal_only=tuple((assets[i], goal[i]) for i in roles.goal_only),
        goal_camera=looks[0].camera,
        cameras=tuple(look.camera for look in looks[1:]),
        hand=hand,
        goal_hand=reaching[0],
        hands=tuple(reaching[1:]),
    )


def _other(rests: list[RestingObject], rng: np.random.Generator) -> RestingObject:
    return rests[int(rng.integers(1, len(rests)))] if len(rests) > 1 else rests[0]


def _bodies(assets: Sequence[ObjectAsset], poses: Mapping[int, Float]) -> list[Float]:
    return [transform_points(T, hull_points(assets[i].hulls)[0]) for i, T in poses.items()]


def _predefined(conditions: Conditions) -> bool:
    return not (conditions.crowding or conditions.handheld) and conditions.goal_camera == "same"


def _all_seen(looks: Sequence[Look]) -> bool:
    """Say whether every object is seen well in one of several pictures."""
    shares = [visible_shares(look.bodies, look.camera) for look in looks]
    return bool((np.max(shares, axis=0) >= _LEAST_SEEN).all())
