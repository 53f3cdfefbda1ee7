"""The one table that all current frames share: its plane, and where it ends."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from toolkit.errors import ToolkitError
from toolkit.geometry import invert, project, transform_points
from toolkit.perception.tabletop.plane import Plane, fit_near, pixel_rays
from toolkit.types import Camera, Float, Frame, Mask

_SAMPLES = 4000
"""Points taken from a frame, whatever its size."""

_PLANES, _HYPOTHESES, _TESTED = 6, 400, 2500
_CONSENSUS_M = 0.008
_LEAST_SHARE = 0.03
"""A plane with less of the depth than this is not looked at."""

_CENTRAL = 0.3
"""Spread of attention around the middle of an image, as a part of its size: people and arms look at the table."""

_THING_M, _MOST_THING_M = 0.012, 0.4
_OFTEN = 0.05
"""A table carries things: with this share of the attention on them, a plane's claim is full."""

_UPPER, _LEAST_CARRIED = 0.35, 0.01
"""The upper of two planes is the table if its claim is this part of the lower one's and it carries things."""

_PARALLEL, _ABOVE_M = np.cos(np.radians(10)), 0.03
_NEAR_M = 0.012
_CELL_M, _CLOSED, _OPENED = 0.01, 5, 3
"""Cells of the plan, and how many of them a gap may be wide, and a spur that is not the table's."""

_LEAST_PART = 0.1
_RASTER_M = 0.005

_NOISES, _LEAST_M = 4.0, 0.004


@dataclass(frozen=True, eq=False)
class Table:
    """The table in the world as it is, and as every frame has it.

    Attributes:
        T_world_table: (4, 4), z = 0 is its surface, z points up from it.
        outline: (M, 2) convex outline in that frame, metres: what lies beyond is not on the table.
        frames: the current frames.
        planes: the table before each frame's camera; None where too little of it is seen.
    """

    T_world_table: Float
    outline: Float
    frames: tuple[Frame, ...]
    planes: tuple[Plane | None, ...]

    def seen(self) -> list[tuple[Frame, Plane]]:
        """The frames that see the table, with its plane before their camera."""
        return [(frame, plane) for frame, plane in zip(self.frames, self.planes, strict=True) if plane is not None]

    def holds(self, xy: Float) -> Mask:
        """(...,) bool: which (..., 2) places in the table's frame lie within its outline, to half a centimetre."""
        low, grid = self._raster
        cells = np.floor((xy - low.astype(xy.dtype)) / xy.dtype.type(_RASTER_M)).astype(np.int32)
        size = np.array(grid.shape)
        inside = (cells >= 0).all(axis=-1) & (cells < size).all(axis=-1)
        held = np.zeros(inside.shape, bool)
        held[inside] = grid[tuple(cells[inside].T)]
        return held

    @cached_property
    def _raster(self) -> tuple[Float, Mask]:
        """Corner of the plan's first cell, metres, and which cells lie within the outline."""
        low = self.outline.min(axis=0) - _RASTER_M
        size = np.ceil((self.outline.max(axis=0) - low) / _RASTER_M).astype(np.int64) + 1
        grid = np.zeros(size.tolist(), np.uint8)
        corners = np.rint((self.outline - low) / _RASTER_M - 0.5).astype(np.int32)
        cv2.fillConvexPoly(grid, np.ascontiguousarray(corners[:, ::-1]), 1)
        return low, grid > 0

    def surface(self, camera: Camera, levels: Sequence[float] = (0.0,)) -> Mask:
        """(H, W) bool: where a camera sees the table, or what reaches up to the highest of the levels (metres)."""
        corners = np.concatenate([np.column_stack([self.outline, np.full(len(self.outline), z)]) for z in levels])
        world = transform_points(self.T_world_table, corners)
        pixels, _ = project(camera.K, invert(camera.T_world_camera), world)
        ahead = pixels[np.isfinite(pixels).all(axis=1)]
        mask = np.zeros((camera.height, camera.width), np.uint8)
        if len(ahead) > 2:
            limit = 20.0 * max(camera.width, camera.height)
            cv2.fillConvexPoly(mask, cv2.convexHull(np.rint(ahead.clip(-limit, limit)).astype(np.int32)), 1)
        return mask > 0


def inside_convex(hull: Float, points: Float) -> Mask:
    """(N,) bool: which (N, 2) points lie in a convex polygon (M, 2) of either orientation."""
    edges = np.roll(hull, -1, axis=0) - hull
    sides = points @ np.stack([-edges[:, 1], edges[:, 0]]) - (hull[:, 1] * edges[:, 0] - hull[:, 0] * edges[:, 1])
    return np.asarray((sides >= 0).all(axis=1) | (sides <= 0).all(axis=1))


def find_table(frames: Sequence[Frame]) -> Table:
    """Find the table in RGB-D frames of one scene. The last scene's is kept, since every stage asks for it.

    All frames are looked at together. Planes are found one after another (RANSAC, Fischler and Bolles, CACM 1981); the
    table is the one that the cameras look at and that carries things: a floor may be larger, and a box's lid nearer.
    The world may have any orientation.

    Raises:
        ToolkitError: there is no frame, a frame has no depth, or no plane holds a fair part of it.
    """
    return _find(tuple(frames))


@lru_cache(maxsize=2)
def _find(frames: tuple[Frame, ...]) -> Table:
    if not frames:
        raise ToolkitError("the table is found in the current frames, and there is none")
    for frame in frames:
        if frame.depth is None:
            raise ToolkitError(f"frame {frame.index} has no depth, and the table is found in depth")
    points, cameras, attention = _sample(frames)
    if len(points) < _HYPOTHESES:
        raise ToolkitError(f"only {len(points)} pixels of the current frames have depth, too few to find a table")
    T = _choose(points, cameras, attention)
    planes = tuple(fit_near(frame, T, _NEAR_M) for frame in frames)
    if not any(planes):
        raise ToolkitError("no current frame sees enough of one plane; is there a table?")
    return Table(T, _outline(frames, planes, T), frames, planes)


def _sample(frames: Sequence[Frame]) -> tuple[Float, Float, Float]:
    """World points (N, 3), the cameras that saw them (N, 3), and how near the middle of the image each is (N,)."""
    points, cameras, attention = [], [], []
    for frame in frames:
        assert frame.depth is not None
        measured = np.flatnonzero(frame.depth)
        chosen = measured[np.linspace(0, len(measured) - 1, min(_SAMPLES, len(measured))).astype(np.int64)]
        T = frame.camera.T_world_camera
        rays = pixel_rays(frame).reshape(-1, 3)[chosen]
        points.append(transform_points(T, rays * frame.depth.ravel()[chosen, None]))
        cameras.append(np.broadcast_to(T[:3, 3], (len(chosen), 3)))
        size = np.array([frame.camera.width, frame.camera.height])
        off = np.stack([chosen % size[0], chosen // size[0]], axis=1) / size - 0.5
        attention.append(np.exp(-(off**2).sum(axis=1) / (2 * _CENTRAL**2)))
    return np.concatenate(points), np.concatenate(cameras), np.concatenate(attention)


@dataclass(frozen=True, eq=False)
class _Candidate:
    normal: Float
    level: float
    claim: float
    carried: float


def _choose(points: Float, cameras: Float, attention: Float) -> Float:
    """(4, 4) T_world_table of the plane with the best claim."""
    found = [
        _claim(normal, level, rows, points, attention) for normal, level, rows in _planes(points, cameras, attention)
    ]
    if not found:
        raise ToolkitError(f"no plane holds {_LEAST_SHARE:.0%} of the depth of the current frames; is there a table?")
    best = max(found, key=lambda c: c.claim)
    above = [c for c in found if _is_upper(c, best)]
    best = max(above, key=lambda c: float(c.normal @ best.normal) * c.level, default=best)
    side = np.cross(best.normal, np.eye(3)[int(np.abs(best.normal).argmin())])
    side /= np.linalg.norm(side)
    T = np.eye(4)
    T[:3, :3] = np.stack([side, np.cross(best.normal, side), best.normal], axis=1)
    T[:3, 3] = best.normal * best.level
    return T


def _planes(points: Float, cameras: Float, attention: Float) -> list[tuple[Float, float, NDArray[np.int64]]]:
    """Normals towards the cameras, levels and members of planes, each taken away before the next is looked for."""
    rng = np.random.default_rng(0)
    left, found = np.arange(len(points)), list[tuple[Float, float, NDArray[np.int64]]]()
    for _ in range(_PLANES):
        if len(left) < _LEAST_SHARE * len(points):
            break
        corners = left[rng.integers(0, len(left), (_HYPOTHESES, 3))]
        tested = points[left[rng.integers(0, len(left), _TESTED)]]
        a, b, c = np.swapaxes(points[corners], 0, 1)
        normals = np.cross(b - a, c - a)
        lengths = np.linalg.norm(normals, axis=1)
        usable = lengths > 1e-6
        normals = normals[usable] / lengths[usable, None]
        normals *= np.sign((normals * (cameras[corners[usable, 0]] - a[usable])).sum(axis=1))[:, None]
        levels = (normals * a[usable]).sum(axis=1)
        votes = (np.abs(tested @ normals.T - levels) < _CONSENSUS_M).sum(axis=0)
        normal, level = normals[votes.argmax()], float(levels[votes.argmax()])
        for _ in range(5):
            near = points[left[np.abs(points[left] @ normal - level) < _CONSENSUS_M]]
            least = np.linalg.eigh(np.cov(near.T))[1][:, 0]
            normal = least * np.sign(least @ normal)
            level = float(normal @ near.mean(axis=0))
        gaps = np.abs(points[left] @ normal - level)
        rows = left[gaps < _CONSENSUS_M]
        if len(rows) < _LEAST_SHARE * len(points):
            break
        found.append((normal, level, rows))
        left = left[gaps >= 2 * _CONSENSUS_M]
    return found


def _claim(normal: Float, level: float, rows: NDArray[np.int64], points: Float, attention: Float) -> _Candidate:
    axes = np.linalg.svd(normal[None])[2][1:]
    plan, height = points @ axes.T, points @ normal - level
    hull = np.asarray(cv2.convexHull(plan[rows].astype(np.float32))[:, 0], np.float64)
    things = (height > _THING_M) & (height < _MOST_THING_M) & inside_convex(hull, plan)
    carried = float(attention[things].sum() / attention.sum())
    share = float(attention[rows].sum() / attention.sum())
    return _Candidate(normal, level, share * min(1.0, _OFTEN + carried / _OFTEN), carried)


def _is_upper(other: _Candidate, best: _Candidate) -> bool:
    return (
        float(other.normal @ best.normal) > _PARALLEL
        and other.level - best.level > _ABOVE_M
        and other.claim > _UPPER * best.claim
        and other.carried > _LEAST_CARRIED
    )


def _outline(frames: Sequence[Frame], planes: Sequence[Plane | None], T_world_table: Float, step: int = 3) -> Float:
    """(M, 2) convex hull, metres, of what all frames see of the table, as far as things on it connect its parts."""
    bare: list[Float] = []
    covered: list[Float] = []
    for frame, plane in zip(frames, planes, strict=True):
        if plane is None or frame.depth is None:
            continue
        rays, depth = pixel_rays(frame)[::step, ::step], frame.depth[::step, ::step]
        height = np.where(depth > 0, plane.heights(rays, depth), -np.inf)
        reach = np.maximum(_NOISES * plane.noise * plane.camera_height * depth, _LEAST_M)
        T = invert(T_world_table) @ frame.camera.T_world_camera
        plan = (rays * depth[..., None]) @ T[:2, :3].T + T[:2, 3]
        bare.append(plan[np.abs(height) < reach])
        covered.append(plan[(height >= reach) & (height < _MOST_THING_M)])
    points = np.concatenate(bare)
    low = points.min(axis=0) - 2 * _OPENED * _CELL_M
    size = np.floor((points.max(axis=0) - low) / _CELL_M).astype(np.int64) + 2 * _OPENED
    closed = cv2.morphologyEx(_grid(points, low, size), cv2.MORPH_CLOSE, np.ones((_CLOSED, _CLOSED), np.uint8))
    opened = cv2.morphologyEx(closed, cv2.MORPH_OPEN, np.ones((_OPENED, _OPENED), np.uint8))
    surface = np.asarray(opened if opened.any() else closed, np.uint8)
    _, found, stats, _ = cv2.connectedComponentsWithStats(surface)
    parts = found.astype(np.int64)
    sizes = stats[:, cv2.CC_STAT_AREA]
    sizes[0] = 0
    # A crumb behind the table at its height is a chair's; a large part behind things is the table's.
    surface[sizes[parts] < _LEAST_PART * sizes.max()] = 0
    joined = cv2.dilate(surface | _grid(np.concatenate(covered), low, size), np.ones((3, 3), np.uint8))
    _, labels = cv2.connectedComponents(joined)
    largest = int(np.bincount(labels[surface > 0]).argmax())
    corners = np.argwhere((labels == largest) & (surface > 0)).astype(np.float32)
    hull = np.asarray(cv2.convexHull(corners)[:, 0], np.float64)
    return hull * _CELL_M + low + _CELL_M / 2


def _grid(plan: Float, low: Float, size: NDArray[np.int64]) -> NDArray[np.uint8]:
    """(X, Y) 1 in the cells of a plan that (N, 2) points fall into."""
    cells = np.floor((plan - low) / _CELL_M).astype(np.int64)
    cells = cells[(cells >= 0).all(axis=1) & (cells < size).all(axis=1)]
    grid = np.zeros(size.tolist(), np.uint8)
    grid[tuple(cells.T)] = 1
    return grid
