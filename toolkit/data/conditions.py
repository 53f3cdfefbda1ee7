"""What a scene is like and how it is seen: tracks, and their settings, each of which can be set or swept alone."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import Any, Literal, get_args

import numpy as np
from pydantic import Field, field_validator

from toolkit.registry import PluginConfig

Effect = Literal[
    "depth",
    "quantization",
    "dropout",
    "ripple",
    "flying_pixels",
    "shadow",
    "holes",
    "border",
    "color",
    "exposure",
    "blur",
    "light",
    "pose",
]
Track = Literal["clean", "d435", "realsense", "kinect", "crowded", "wild"]
Sensor = Literal["d435", "kinect"]
TableLook = Literal["plain", "wood", "cloth", "varied"]
TableShape = Literal["square", "rectangle", "round", "any"]

PUBLISHED: tuple[Effect, ...] = ("depth", "quantization", "dropout", "color", "light", "pose")
"""The effects of track `d435`."""

_REAL: tuple[Effect, ...] = ("ripple", "flying_pixels", "shadow", "holes", "border", "exposure", "blur")
KINECT: tuple[Effect, ...] = (*PUBLISHED, *_REAL)
REALSENSE: tuple[Effect, ...] = tuple(effect for effect in KINECT if effect != "dropout")
"""Without the published loss at all edges alike: a real one loses what its second eye does not see."""


class ConditionSettings(PluginConfig):
    """A track, and its settings; one that is left out (None) is as the track has it."""

    track: Track = Field(
        "clean",
        description="Bundle of the settings below: `clean`; `d435`, noise as published for it; `realsense` and "
        "`kinect`, with what those sensors do at edges and on dark or shiny things too; `crowded`, objects touch and "
        "hide each other; `wild`, all of it drawn anew for every scene.",
    )
    noise: tuple[Effect, ...] | None = Field(
        None, description="The effects of the sensor that are on; all of the track's when left out."
    )

    @field_validator("noise", mode="before")
    @classmethod
    def _effects(cls, value: Any) -> Any:
        if isinstance(value, str):
            track = f"; '{value}' is a track: --set dataset.track={value}" if value in get_args(Track) else ""
            raise ValueError(f"effects stand in brackets, such as [depth, pose]{track}")
        return value

    sensor: Sensor | None = Field(None, description="Active stereo (d435) or structured light (kinect).")
    table: TableLook | None = Field(None, description="What the table looks like; `varied`: another in every scene.")
    table_shape: TableShape | None = Field(
        None, description="Square: 1.24 m, its edges mostly out of sight. The others are smaller, of random size."
    )
    background: bool | None = Field(None, description="A floor, walls and furniture beyond the table's edge.")
    clutter: int | None = Field(
        None, ge=0, le=20, description="Most flat things (paper, mats, cloths) on the table, some in one scene only."
    )
    shadows: bool | None = Field(None, description="Objects cast shadows.")
    gloss: float | None = Field(
        None, ge=0, le=1, description="How much table and objects mirror the lamps; 1: as polished lacquer."
    )
    crowding: float | None = Field(
        None,
        ge=0,
        le=1,
        description="Share of objects put against another (0 to 5 mm) or behind it, as seen from home.",
    )
    crowding_in: Literal["both", "goal", "current"] | None = Field(
        None, description="The scenes in which objects are crowded."
    )
    one_sided: float | None = Field(
        None, ge=0, le=0.8, description="Share of objects that are only in the goal, or only in the current scene."
    )
    unmoved: float | None = Field(None, ge=0, le=1, description="Share of objects that stand at their goal already.")
    arc_deg: float | None = Field(
        None, ge=0, le=360, description="Current frames lie on an arc of this many degrees; 360: the ring."
    )
    handheld: bool | None = Field(None, description="Viewpoints scatter in height, distance, aim and roll.")
    goal_camera: Literal["same", "other"] | None = Field(
        None, description="The goal is taken by the frames' camera, or by one of another focal length and image size."
    )
    hands: float | None = Field(
        None, ge=0, le=1, description="Share of the images, goal included, that a hand or a gripper reaches into."
    )


@dataclass(frozen=True)
class Conditions:
    """The conditions of one scene, nothing left to a track; meanings as in `ConditionSettings`.

    Attributes:
        most_views: the current frames there are at most; None: as many as the benchmark has.
    """

    noise: tuple[Effect, ...] = ()
    sensor: Sensor = "d435"
    table: TableLook = "wood"
    table_shape: TableShape = "square"
    background: bool = False
    clutter: int = 0
    shadows: bool = False
    gloss: float = 0.0
    crowding: float = 0.0
    crowding_in: Literal["both", "goal", "current"] = "both"
    one_sided: float = 0.0
    unmoved: float = 0.0
    arc_deg: float = 360.0
    handheld: bool = False
    goal_camera: Literal["same", "other"] = "same"
    hands: float = 0.0
    most_views: int | None = None


def _wild(rng: np.random.Generator) -> Conditions:
    """Draw each setting by itself, so that none is tied to another, and none is on in every scene or in no scene."""

    def chance(probability: float) -> bool:
        return bool(rng.random() < probability)

    def some(probability: float, low: float, high: float) -> float:
        """A number that is 0 in some scenes."""
        drawn = float(rng.uniform(low, high))
        return drawn if chance(probability) else 0.0

    near = chance(0.5)
    sensor: Sensor = "kinect" if chance(0.4) else "d435"
    arc, few = float(rng.uniform(8, 90)), int(rng.integers(1, 6))
    return Conditions(
        noise=tuple(effect for effect in (KINECT if sensor == "kinect" else REALSENSE) if chance(0.9)),
        sensor=sensor,
        table="varied",
        table_shape="any",
        background=chance(0.85),
        clutter=int(rng.integers(0, 8)),
        shadows=chance(0.9),
        gloss=some(0.6, 0.1, 0.8),
        crowding=some(0.75, 0.2, 0.9),
        one_sided=some(0.4, 0.1, 0.4),
        unmoved=1.0 if chance(0.1) else some(0.5, 0.2, 0.8),
        arc_deg=arc if near else 360.0,
        handheld=chance(0.75),
        goal_camera="other" if chance(0.4) else "same",
        hands=some(0.3, 0.2, 0.6),
        most_views=few if near else None,
    )


_TRACKS: dict[str, Callable[[np.random.Generator], Conditions]] = {
    "clean": lambda _: Conditions(),
    "d435": lambda _: Conditions(noise=PUBLISHED),
    "realsense": lambda _: Conditions(noise=REALSENSE),
    "kinect": lambda _: Conditions(noise=KINECT, sensor="kinect"),
    "crowded": lambda _: Conditions(crowding=0.7),
    "wild": _wild,
}


def draw_conditions(settings: ConditionSettings, rng: np.random.Generator) -> Conditions:
    """The conditions of one scene: what the settings give, and the track's, constant or drawn, for the rest."""
    drawn = _TRACKS[settings.track](rng)
    given: dict[str, Any] = {field.name: getattr(settings, field.name, None) for field in fields(Conditions)}
    return replace(drawn, **{name: value for name, value in given.items() if value is not None})
