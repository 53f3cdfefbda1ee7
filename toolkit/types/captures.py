"""Captures, and the truth about the objects in them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from toolkit.geometry import is_rigid
from toolkit.types.arrays import Float, checked, checked_motion, freeze, require
from toolkit.types.images import Frame


@dataclass(frozen=True, eq=False)
class ObjectModel:
    """What scoring needs to know of an object (BOP models_info, in metres).

    Attributes:
        object_id: BOP object id.
        name: the object's name.
        box_min: (3,) float64 smallest corner of the axis-aligned box, model coordinates.
        box_size: (3,) float64, its size.
        diameter: largest distance between two model points.
        discrete_symmetries: (S, 4, 4) float64 rigid symmetries besides the identity.
        continuous_axes: (A, 6) float64 axis (unit) and a point on it, of continuous rotations.

    Raises:
        ToolkitError: a value is not as said.
    """

    object_id: int
    name: str
    box_min: Float
    box_size: Float
    diameter: float
    discrete_symmetries: Float
    continuous_axes: Float

    def __post_init__(self) -> None:
        what = f"object {self.object_id}"
        box_min = checked(self.box_min, (3,), np.float64, f"{what}: box_min")
        box_size = checked(self.box_size, (3,), np.float64, f"{what}: box_size")
        require((box_size >= 0).all(), f"{what}: box_size must not be negative, got {box_size.tolist()}")
        require(0 < self.diameter < np.inf, f"{what}: diameter must be positive, got {self.diameter}")
        turns = checked(self.discrete_symmetries, (None, 4, 4), np.float64, f"{what}: discrete_symmetries")
        require(all(map(is_rigid, turns)), f"{what}: every discrete symmetry must be a rigid transform")
        axes = checked(self.continuous_axes, (None, 6), np.float64, f"{what}: continuous_axes")
        require(np.allclose(np.linalg.norm(axes[:, :3], axis=1), 1), f"{what}: axes of symmetry must be of length 1")
        freeze(self, box_min=box_min, box_size=box_size, discrete_symmetries=turns, continuous_axes=axes)

    @property
    def center(self) -> Float:
        """(3,) centre of the axis-aligned box, where translations are scored."""
        return self.box_min + 0.5 * self.box_size


@dataclass(frozen=True, eq=False)
class TrueObject:
    """Where one object really is, before and after.

    Attributes:
        model: the object.
        T_world_current: (4, 4) float64 model to world in the current scene, metres.
        T_world_goal: (4, 4) float64 model to world in the goal scene, metres.
        instance_id: id of the object inside its scene (unique even where two share a model).

    Raises:
        ToolkitError: a pose is not rigid.
    """

    model: ObjectModel
    T_world_current: Float
    T_world_goal: Float
    instance_id: int

    def __post_init__(self) -> None:
        for name in ("T_world_current", "T_world_goal"):
            freeze(self, **{name: checked_motion(getattr(self, name), f"{name} of object {self.instance_id}")})

    @property
    def T_goal_current(self) -> Float:
        """(4, 4) the true motion in world coordinates."""
        return self.T_world_goal @ np.linalg.inv(self.T_world_current)


@dataclass(frozen=True, eq=False)
class Placed:
    """Where one object really is, in one of the two scenes.

    Attributes:
        model: the object.
        T_world_model: (4, 4) float64 model to world, metres.

    Raises:
        ToolkitError: the pose is not rigid.
    """

    model: ObjectModel
    T_world_model: Float

    def __post_init__(self) -> None:
        pose = checked_motion(self.T_world_model, f"T_world_model of {self.model.name}")
        freeze(self, T_world_model=pose)


@dataclass(frozen=True, eq=False)
class Capture:
    """One task: posed RGB-D frames of the current scene, one RGB image of the goal, and the truth where known.

    Attributes:
        name: the capture folder's name.
        current: the current scene's frames, at least one, all with depth, no index twice.
        goal: the goal image.
        truth: true objects that are in both scenes by instance id, or None.
        digest: sha256 of the files it was read from.
        only_current: true objects that are not in the goal, by instance id.
        only_goal: true objects that are not in the current scene, by instance id.
        notes: what reading it left out, changed or did not use, in sentences.

    Raises:
        ToolkitError: the current frames are not as said.
    """

    name: str
    current: tuple[Frame, ...]
    goal: Frame
    truth: Mapping[int, TrueObject] | None
    digest: str
    only_current: Mapping[int, Placed] = field(default_factory=dict[int, Placed])
    only_goal: Mapping[int, Placed] = field(default_factory=dict[int, Placed])
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        require(len(self.current) > 0, f"capture {self.name}: there is no current frame")
        for frame in self.current:
            require(frame.depth is not None, f"capture {self.name}: current frame {frame.index} has no depth")
        require(
            len({frame.index for frame in self.current}) == len(self.current),
            f"capture {self.name}: two current frames have the same index",
        )
