"""Where objects rest on the table: stable poses, footprints, collision-free arrangements. Metres, radians."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Protocol, cast

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from toolkit.data.objects import ObjectAsset
from toolkit.errors import ToolkitError
from toolkit.geometry import make_transform, rotation_z
from toolkit.types import Float

_FOOTPRINT_DIRECTIONS = 32
_SUPPORT_M = 0.002
"""Hull points this near to the lowest one carry the object."""

_TRIES_PER_OBJECT = 300
_RESTARTS = 60


@dataclass(frozen=True, eq=False)
class RestingObject:
    """An object in a stable orientation, lowest point at z = 0, box centre above the origin.

    Attributes:
        T_rest_model: (4, 4) model to resting pose.
        support: (D,) distance of the footprint's supporting lines from the origin, by direction (see `_directions`).
        outline: (K, 2) corners of the footprint's convex hull, counter-clockwise.
        height: of its highest point.
    """

    T_rest_model: Float
    support: Float
    outline: Float
    height: float

    @property
    def radius(self) -> float:
        """Largest distance of the footprint from the origin."""
        return float(self.support.max())


@lru_cache(maxsize=512)
def resting_poses(asset: ObjectAsset) -> list[RestingObject]:
    """Stable poses of an asset, the natural one first: upright (z up) where that is stable, else the most probable.

    Raises:
        ToolkitError: a collision mesh cannot be read.
    """
    import trimesh

    points, mass_center = hull_points(asset.hulls)
    hull = cast(Any, trimesh.convex.convex_hull(points))
    poses = [np.eye(4)] if _is_stable(points, mass_center) else []
    transforms, probabilities = hull.compute_stable_poses(center_mass=mass_center, sigma=0, threshold=0.02)
    poses += [transforms[i] for i in np.argsort(-probabilities, kind="stable")]
    return [_resting(T, points) for T in poses]


@lru_cache(maxsize=512)
def hull_points(hulls: tuple[Path, ...]) -> tuple[Float, Float]:
    """All vertices (N, 3) of convex meshes, and the volume-weighted centre of mass (3,), in their own coordinates.

    Raises:
        ToolkitError: a mesh cannot be read, or is flat.
    """
    import trimesh

    try:
        meshes = [cast(Any, trimesh.load(hull, force="mesh")) for hull in hulls]
    except Exception as error:
        raise ToolkitError(f"collision mesh of '{hulls[0].parent}' cannot be read: {error}") from error
    convex = [mesh.convex_hull for mesh in meshes]
    volumes = np.array([abs(float(mesh.volume)) for mesh in convex])
    for path, volume in zip(hulls, volumes, strict=True):
        if not volume > 0:
            raise ToolkitError(f"collision mesh '{path}' is flat; remove it or export it again")
    centers = np.array([mesh.center_mass for mesh in convex])
    return np.concatenate([mesh.vertices for mesh in convex]), np.average(centers, axis=0, weights=volumes)


def _is_stable(points: Float, mass_center: Float) -> bool:
    """Say whether the centre of mass lies above the hull of the points that touch the table."""
    contact = points[points[:, 2] < points[:, 2].min() + _SUPPORT_M, :2]
    if len(contact) < 3:
        return False
    try:
        equations = ConvexHull(contact).equations
    except QhullError:
        return False
    return bool((equations[:, :2] @ mass_center[:2] + equations[:, 2] < 0).all())


def _resting(T: Float, points: Float) -> RestingObject:
    turned = points @ T[:3, :3].T
    low, high = turned.min(axis=0), turned.max(axis=0)
    shift = np.array([*(-(low + high)[:2] / 2), -low[2]])
    seen = (turned + shift)[:, :2]
    corners = seen[ConvexHull(seen).vertices]
    return RestingObject(
        make_transform(T[:3, :3], shift), (seen @ _directions().T).max(axis=0), corners, float((high - low)[2])
    )


@lru_cache(maxsize=1)
def _directions() -> Float:
    angles = 2 * np.pi * np.arange(_FOOTPRINT_DIRECTIONS) / _FOOTPRINT_DIRECTIONS
    return np.stack([np.cos(angles), np.sin(angles)], axis=1)


@dataclass(frozen=True)
class Placement:
    """A resting object put on the table: turned by `yaw` about z, then moved to (x, y)."""

    x: float
    y: float
    yaw: float

    def pose(self, resting: RestingObject) -> Float:
        """(4, 4) model to world."""
        T = rotation_z(self.yaw) @ resting.T_rest_model
        T[:2, 3] += [self.x, self.y]
        return T


class Neighbours(Protocol):
    """Puts some objects next to others (`toolkit.data.crowding`)."""

    def anchor(self, objects: Sequence[RestingObject], placed: Mapping[int, Placement]) -> int | None:
        """The object that the next one is to stand at; None where it is to stand by itself."""
        ...

    def place(self, resting: RestingObject, yaw: float, anchor: RestingObject, at: Placement) -> Placement:
        """Draw a place at an object; it may collide with others."""
        ...

    def collides(self, a: RestingObject, at: Placement, b: RestingObject, b_at: Placement) -> bool:
        """Say whether two objects cut into each other."""
        ...


def arrange(
    objects: Sequence[RestingObject],
    yaws: Sequence[float],
    radius: float,
    clearance: float,
    rng: np.random.Generator,
    fixed: Mapping[int, Placement] | None = None,
    neighbours: Neighbours | None = None,
) -> list[Placement]:
    """Draw a collision-free arrangement inside a disc around the table's centre.

    Args:
        objects: what to place.
        yaws: radians, one per object.
        radius: of the disc every footprint stays in.
        clearance: least gap between two footprints, except between neighbours.
        rng: the only source of chance.
        fixed: placements by position in `objects` that are given.
        neighbours: puts objects next to others; without it each stands by itself.

    Raises:
        ToolkitError: the disc does not hold them.
    """
    given = fixed or {}
    # Large ones first: small ones fit into what is left.
    order = sorted((i for i in range(len(objects)) if i not in given), key=lambda i: -objects[i].radius)
    for _ in range(_RESTARTS):
        placed: dict[int, Placement] = dict(given)
        for i in order:
            anchor = neighbours.anchor(objects, placed) if neighbours is not None else None
            if neighbours is not None and anchor is not None:
                found = _place_at(i, anchor, objects, yaws, placed, radius, neighbours)
            else:
                found = _place(i, objects, yaws, placed, radius, clearance, rng)
            if found is None:
                break
            placed[i] = found
        if len(placed) == len(objects):
            return [placed[i] for i in range(len(objects))]
    raise ToolkitError(
        f"the table (a disc of {radius:.2f} m) does not hold these {len(objects)} objects {clearance * 100:.0f} cm "
        "apart; ask for fewer with dataset.max_objects"
    )


def _place(
    index: int,
    objects: Sequence[RestingObject],
    yaws: Sequence[float],
    placed: dict[int, Placement],
    radius: float,
    clearance: float,
    rng: np.random.Generator,
) -> Placement | None:
    support = _turned_support(objects[index], yaws[index])
    for _ in range(_TRIES_PER_OBJECT):
        room = radius - objects[index].radius
        if room < 0:
            return None
        distance, angle = room * np.sqrt(rng.random()), 2 * np.pi * rng.random()
        x, y = float(distance * np.cos(angle)), float(distance * np.sin(angle))
        apart = all(
            _gap(np.array([x, y]), support, np.array([p.x, p.y]), _turned_support(objects[j], p.yaw)) >= clearance
            for j, p in placed.items()
        )
        if apart:
            return Placement(x, y, yaws[index])
    return None


def _place_at(
    index: int,
    anchor: int,
    objects: Sequence[RestingObject],
    yaws: Sequence[float],
    placed: Mapping[int, Placement],
    radius: float,
    neighbours: Neighbours,
) -> Placement | None:
    for _ in range(_TRIES_PER_OBJECT):
        found = neighbours.place(objects[index], yaws[index], objects[anchor], placed[anchor])
        inside = np.hypot(found.x, found.y) <= radius - objects[index].radius
        if inside and not any(neighbours.collides(objects[index], found, objects[j], p) for j, p in placed.items()):
            return found
    return None


def _turned_support(resting: RestingObject, yaw: float) -> Float:
    """Support of the footprint turned by `yaw`, by linear interpolation between directions."""
    steps = np.arange(_FOOTPRINT_DIRECTIONS) - yaw * _FOOTPRINT_DIRECTIONS / (2 * np.pi)
    low = np.floor(steps).astype(int)
    part = steps - low
    n = _FOOTPRINT_DIRECTIONS
    return (1 - part) * resting.support[low % n] + part * resting.support[(low + 1) % n]


def _gap(center_a: Float, support_a: Float, center_b: Float, support_b: Float) -> float:
    """Lower bound of the distance of two footprints: the widest gap along any of the directions."""
    along = _directions() @ (center_b - center_a)
    return float((along - support_a - np.roll(support_b, _FOOTPRINT_DIRECTIONS // 2)).max())
