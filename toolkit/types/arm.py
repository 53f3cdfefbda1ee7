"""An arm and what is around it, as data: what its motions are planned in."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from toolkit.types.arrays import Float, checked, freeze, require


@dataclass(frozen=True, eq=False)
class Shape:
    """Convex pieces that move together. Two shapes are the same only if they are one object.

    Attributes:
        pieces: by piece, (V, 3) points whose convex hull it is, in the shape's own coordinates, metres.

    Raises:
        ToolkitError: there are no pieces, or one is not of its shape.
    """

    pieces: tuple[Float, ...]

    def __post_init__(self) -> None:
        require(self.pieces, "a shape must have pieces")
        freeze(self, pieces=tuple(checked(piece, (None, 3), np.float64, "a piece") for piece in self.pieces))


@dataclass(frozen=True, eq=False)
class Cubes:
    """Full cubes of a grid that has a corner at the origin. Two are the same only if they are one object.

    Attributes:
        cells: (N, 3) int64 which ones: cube (i, j, k) begins at (i, j, k) times its side.
        side: of a cube, metres.

    Raises:
        ToolkitError: there are no cubes, or a value is not of its shape.
    """

    cells: NDArray[np.int64]
    side: float

    def __post_init__(self) -> None:
        require(len(self.cells) > 0 and self.side > 0, "cubes must be at least one, and have a side")
        freeze(self, cells=checked(self.cells, (None, 3), np.int64, "the cells"))

    @property
    def centers(self) -> Float:
        """(N, 3) their middles, metres."""
        return (self.cells + 0.5) * self.side


@dataclass(frozen=True, eq=False)
class Solid:
    """A thing that an arm may touch.

    Attributes:
        name: unique among what is around an arm, and none of its links' names.
        shape: what it looks like: convex pieces where that is known, cubes where it was seen.
        pose: (4, 4) where it is: in the world, or in the frame of the link that holds it.
        held_by: the arm's link that carries it; None where it lies still.

    Raises:
        ToolkitError: the pose is not of its shape.
    """

    name: str
    shape: Shape | Cubes
    pose: Float
    held_by: str | None = None

    def __post_init__(self) -> None:
        freeze(self, pose=checked(self.pose, (4, 4), np.float64, f"the pose of '{self.name}'"))


@dataclass(frozen=True, eq=False)
class ArmWorld:
    """An arm and everything that it must not touch.

    Attributes:
        urdf: the robot's description as XML, in which meshes have absolute file names.
        arm: names of the joints that move, base first.
        others: by name, where its other joints stand, radians or metres.
        T_world_base: (4, 4) where the root of the description stands.
        solids: what is around it, and what it carries.
        allowed: pairs of names, of links or solids, that may touch. Solids that nothing holds may always touch each
            other.

    Raises:
        ToolkitError: two solids have one name, or a value is not of its shape.
    """

    urdf: str
    arm: tuple[str, ...]
    others: Mapping[str, float]
    T_world_base: Float
    solids: tuple[Solid, ...]
    allowed: frozenset[tuple[str, str]]

    def __post_init__(self) -> None:
        names = [solid.name for solid in self.solids]
        require(len({*names}) == len(names), f"things around an arm must have names of their own, got {names}")
        freeze(self, T_world_base=checked(self.T_world_base, (4, 4), np.float64, "the pose of an arm's base"))
