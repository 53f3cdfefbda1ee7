"""What stands on the table, cut into objects by what all frames see together, and cut out of every frame.

The frames' pixels are joined in voxels of the table's frame. Two neighbouring voxels belong together where the frames
that see both see them on one smooth part; what one frame sees in front of what another sees through is not there.
Objects that came apart on the way (a mug's inside and outside) are joined by colour and place. Their number is what
comes out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components, dijkstra
from scipy.spatial import KDTree

from toolkit.geometry import CUBE_STEPS, cubes, group_means, invert, project, transform_points
from toolkit.perception.tabletop.creases import smooth_parts
from toolkit.perception.tabletop.joining import Pieces, join_pieces
from toolkit.perception.tabletop.labels import nearest_label
from toolkit.perception.tabletop.relief import Relief, survey
from toolkit.perception.tabletop.table import Table, find_table
from toolkit.types import Float, Frame, Mask

_CELL_M, _CELL_PIXELS = 0.004, 2.0
"""Side of a voxel: this, or so many pixels where they are coarser."""

_LEAST_PART_PX = 40
_ON_TABLE = 0.5
_LEAST_CORE_M2 = 1.5e-4
"""Smooth parts smaller than this start no object of their own."""

_TOUCH_M = 0.04
"""What hovers higher than this above the table with all its visible parts does not stand on it."""

_HANG_M = 0.03
"""It may hang on what does stand, this far away: struts and rims are too thin to be measured."""

_LEAST_OBJECT_M2 = 3e-4
"""Less surface than this, all frames together, is noise."""

_SEEN_THROUGH_M, _NOISES = 0.01, 4.0
_EDGE_PX = 5
_PER_DEGREE = 1 / 20
"""A step between voxels is longer by this for every degree that the surface is concave there."""

_LEAST_CERTAIN_PX = 20
_BORDER_PX = 3


@dataclass(frozen=True, eq=False)
class Voxels:
    """What all frames see on the table, on one grid.

    Attributes:
        of_pixel: (P,) int64 the voxel of every pixel of `things`, frame after frame in row-major order.
        frame_of_pixel: (P,) int64 the frame of every pixel.
        center: (V, 3) float64 mean of its pixels in the table's frame, metres.
        concave: (V,) float64 degrees.
        part: (V, F) int64 the smooth part that each frame sees it on, -1 for none.
        elsewhere: (V,) bool, on a part of which most lies beyond or below the table: a chair's back, an arm.
        seen: (V, F) bool, which frames see it.
        pairs: (E, 2) int64 neighbouring voxels.
        face: (E,) bool, those that share a face.
        cell: metres.
    """

    of_pixel: NDArray[np.int64]
    frame_of_pixel: NDArray[np.int64]
    center: Float
    concave: Float
    part: NDArray[np.int64]
    elsewhere: Mask
    seen: Mask
    pairs: NDArray[np.int64]
    face: Mask
    cell: float


@dataclass(frozen=True, eq=False)
class Objects:
    """The objects on the table.

    Attributes:
        labels: by frame index, (H, W) int32: 0 for none, else the object, by the same numbers 1..n in all frames.
        whole: (n,) how likely each is a whole one, and not a part of one that it touches.
    """

    labels: dict[int, NDArray[np.int32]]
    whole: Float


def objects_on_table(frames: Sequence[Frame], min_height: float, min_pixels: int) -> Objects:
    """Label what stands on the table in every frame of a scene. The last scene's labels are kept.

    Args:
        frames: RGB-D frames.
        min_height: metres; what is lower is table, also where depth is less noisy than that.
        min_pixels: objects of fewer pixels, all frames together, are dropped.

    Raises:
        ToolkitError: no frame's depth shows a table.
    """
    return _objects(tuple(frames), min_height, min_pixels)


@lru_cache(maxsize=2)
def _objects(frames: tuple[Frame, ...], min_height: float, min_pixels: int) -> Objects:
    table = find_table(frames)
    reliefs = survey(table, min_height)
    found = {frame.index: np.zeros(frame.rgb.shape[:2], np.int32) for frame in frames}
    cut, whole = cut_objects(reliefs, table, min_pixels)
    for r, labels in zip(reliefs, cut, strict=True):
        found[r.frame.index] = _with_borders(labels, r.unsure)
    return Objects(found, whole)


def _with_borders(labels: NDArray[np.int32], free: Mask) -> NDArray[np.int32]:
    """Labels grown over the few pixels beside them that depth says nothing sure about."""
    gap = cv2.distanceTransform((labels == 0).astype(np.uint8), cv2.DIST_L2, 3)
    return np.where((labels == 0) & free & (gap <= _BORDER_PX), nearest_label(labels), labels)


def cut_objects(reliefs: Sequence[Relief], table: Table, min_pixels: int) -> tuple[list[NDArray[np.int32]], Float]:
    """Label the objects on the table, in every frame by the same numbers.

    Args:
        reliefs: of the frames that see the table.
        table: the table.
        min_pixels: smaller objects, all frames together, are dropped.

    Returns:
        One (H, W) int32 for every relief: 0 for none, else the object, 1..n; and (n,) how likely each is a whole one.
    """
    if not any(r.things.any() for r in reliefs):
        return [np.zeros(r.things.shape, np.int32) for r in reliefs], np.zeros(0)
    voxels, pieces = cut_pieces(reliefs, table)
    objects, whole = join_pieces(pieces)
    owner = objects[voxels.of_pixel]
    certain = np.concatenate([r.certain[r.things] for r in reliefs])
    count = int(objects.max()) + 1
    known = owner >= 0
    pixels = np.bincount(owner[known], minlength=count)
    sure = np.bincount(owner[known], certain[known], count)
    area = np.bincount(objects[objects >= 0], minlength=count) * voxels.cell**2
    kept = (pixels >= min_pixels) & (sure >= min(_LEAST_CERTAIN_PX, min_pixels)) & (area >= _LEAST_OBJECT_M2)
    number = np.append(np.cumsum(kept) * kept, 0).astype(np.int32)
    labels: list[NDArray[np.int32]] = []
    for k, r in enumerate(reliefs):
        label = np.zeros(r.things.shape, np.int32)
        label[r.things] = number[owner[voxels.frame_of_pixel == k]]
        labels.append(label)
    return labels, whole[kept]


def cut_pieces(reliefs: Sequence[Relief], table: Table) -> tuple[Voxels, Pieces]:
    """The voxels on the table, and the smooth pieces they fall into, before any are joined."""
    voxels = _voxels(reliefs)
    there, voxels = _standing(voxels, ~(_seen_through(reliefs, table, voxels) | voxels.elsewhere))
    pieces = _flooded(_cores(voxels, there), voxels, there)
    colours = np.concatenate([r.frame.rgb[r.things] for r in reliefs])
    return voxels, Pieces(pieces, voxels.center, voxels.pairs, voxels.concave, voxels.of_pixel, colours, voxels.cell)


def _voxels(reliefs: Sequence[Relief]) -> Voxels:
    places = np.concatenate([r.places[r.things] for r in reliefs]).astype(np.float64)
    frame_of = np.repeat(np.arange(len(reliefs)), [int(r.things.sum()) for r in reliefs])
    cell = max(_CELL_M, _CELL_PIXELS * max(_pixel_m(r) for r in reliefs if r.things.any()))
    grid = cubes(places - places.min(axis=0), cell)
    keys, of_pixel, counts = np.unique(grid, return_inverse=True, return_counts=True)
    n = len(keys)
    center = group_means(places, of_pixel, counts)
    parts, angles = np.full((n, len(reliefs)), -1, np.int64), np.zeros(len(places))
    elsewhere = np.zeros(n, bool)
    for k, r in enumerate(reliefs):
        smooth, concave = smooth_parts(r)
        own = frame_of == k
        angles[own] = concave[r.things]
        numbers, beyond = _part_numbers(smooth, r.things)
        parts[:, k] = _most_common(of_pixel[own], numbers[r.things], n)
        elsewhere |= (parts[:, k] >= 0) & beyond[parts[:, k]]
    seen = np.zeros((n, len(reliefs)), bool)
    seen[of_pixel, frame_of] = True
    pairs, face = _neighbours(keys)
    return Voxels(
        of_pixel, frame_of, center, np.bincount(of_pixel, angles, n) / counts, parts, elsewhere, seen, pairs, face, cell
    )


def _pixel_m(relief: Relief) -> float:
    assert relief.frame.depth is not None
    return float(np.median(relief.frame.depth[relief.things])) / relief.frame.camera.K[0, 0]


def _part_numbers(smooth: Mask, things: Mask) -> tuple[NDArray[np.int64], Mask]:
    """(H, W) connected parts, -1 off them and where they are small; and by number, whether most of it is no thing."""
    _, found, stats, _ = cv2.connectedComponentsWithStats(smooth.astype(np.uint8), connectivity=4)
    labels = found.astype(np.int64)
    sizes = stats[:, cv2.CC_STAT_AREA]
    large = sizes >= _LEAST_PART_PX
    large[0] = False
    beyond = np.bincount(labels[things], minlength=len(sizes)) < _ON_TABLE * sizes
    return np.where(large[labels], labels, -1), beyond


def _most_common(groups: NDArray[np.int64], values: NDArray[np.int64], count: int) -> NDArray[np.int64]:
    """(count,) the value that each group has most often, -1 not counted; -1 where it has no other."""
    chosen = np.full(count, -1, np.int64)
    known = values >= 0
    if known.any():
        span = int(values.max()) + 1
        pairs, counts = np.unique(groups[known] * span + values[known], return_counts=True)
        order = np.argsort(counts, kind="stable")
        chosen[pairs[order] // span] = pairs[order] % span
    return chosen


def _neighbours(keys: NDArray[np.int64]) -> tuple[NDArray[np.int64], Mask]:
    """Pairs of 26-neighbouring cells among sorted keys of `cubes`, and which of them share a face."""
    steps = [(x, y, z) for z in (-1, 0, 1) for y in (-1, 0, 1) for x in (-1, 0, 1) if (z, y, x) > (0, 0, 0)]
    pairs: list[NDArray[np.int64]] = []
    face: list[Mask] = []
    for step in steps:
        wanted = keys + np.dot(step, CUBE_STEPS)
        at = np.searchsorted(keys, wanted).clip(max=len(keys) - 1)
        found = np.flatnonzero(keys[at] == wanted)
        pairs.append(np.stack([found, at[found]], axis=1))
        face.append(np.full(len(found), sum(map(abs, step)) == 1))
    return np.concatenate(pairs), np.concatenate(face)


def _seen_through(reliefs: Sequence[Relief], table: Table, voxels: Voxels) -> Mask:
    """(V,) bool: more frames look through the voxel than see it."""
    world = transform_points(table.T_world_table, voxels.center)
    against = np.zeros(len(world), np.int64)
    for k, r in enumerate(reliefs):
        assert r.frame.depth is not None
        camera = r.frame.camera
        xy, depth = project(camera.K, invert(camera.T_world_camera), world)
        x, y = np.rint(np.nan_to_num(xy, nan=-1.0)).astype(np.int64).T
        inside = (x >= 0) & (y >= 0) & (x < camera.width) & (y < camera.height)
        # The nearest depth around the pixel: at an edge the ray may pass beside what is there.
        nearest = cv2.erode(np.where(r.frame.depth > 0, r.frame.depth, np.inf), np.ones((_EDGE_PX, _EDGE_PX)))
        behind = np.full(len(world), np.inf)
        behind[inside] = nearest[y[inside], x[inside]]
        reach = _SEEN_THROUGH_M + _NOISES * r.plane.noise * depth**2
        against += inside & np.isfinite(behind) & (behind > depth + reach) & ~voxels.seen[:, k]
    return against > voxels.seen.sum(axis=1)


def _standing(voxels: Voxels, there: Mask) -> tuple[Mask, Voxels]:
    """Of the voxels that are there (V,) those that hang together down to the table, and the voxels so connected."""
    whole = _connected(voxels.pairs, there)
    lowest = np.full(int(whole.max(initial=-1)) + 1, np.inf)
    np.minimum.at(lowest, whole[there], voxels.center[there, 2])
    hovers = there & (np.append(lowest, 0)[whole] >= _TOUCH_M)
    links = [voxels.pairs]
    while hovers.any() and (stands := np.flatnonzero(there & ~hovers)).size:
        high = np.flatnonzero(hovers)
        ground = KDTree(voxels.center[stands])
        gaps, nearest = (np.asarray(a) for a in ground.query(voxels.center[high], distance_upper_bound=_HANG_M))
        near = np.isfinite(gaps)
        if not near.any():
            break
        links.append(np.stack([high[near], stands[nearest[near]]], axis=1))
        hovers &= ~np.isin(whole, whole[high[near]])
    pairs = np.concatenate(links)
    face = np.append(voxels.face, np.zeros(len(pairs) - len(voxels.face), bool))
    return there & ~hovers, replace(voxels, pairs=pairs, face=face)


def _cores(voxels: Voxels, there: Mask) -> NDArray[np.int64]:
    """(V,) the smooth cores of objects, -1 between them."""
    one, other = voxels.part[voxels.pairs[:, 0]], voxels.part[voxels.pairs[:, 1]]
    both = (one >= 0) & (other >= 0)
    same, different = (both & (one == other)).sum(axis=1), (both & (one != other)).sum(axis=1)
    linked = (same > different) | ((same + different == 0) & voxels.face)
    smooth = there & (2 * (voxels.part >= 0).sum(axis=1) >= voxels.seen.sum(axis=1))
    cores = _connected(voxels.pairs[linked], smooth)
    sizes = np.bincount(cores[cores >= 0], minlength=1) * voxels.cell**2
    cores[(cores >= 0) & (sizes[cores] <= _LEAST_CORE_M2)] = -1
    # What is too thin to have a core is one object as it is.
    whole = _connected(voxels.pairs, there)
    has_core = np.zeros(int(whole.max(initial=-1)) + 1, bool)
    has_core[whole[cores >= 0]] = True
    alone = there & ~np.append(has_core, True)[whole]
    cores[alone] = whole[alone] + len(cores)
    return cores


def _connected(pairs: NDArray[np.int64], members: Mask) -> NDArray[np.int64]:
    """(V,) connected components of the members; -1 for the others."""
    kept = pairs[members[pairs].all(axis=1)]
    n = len(members)
    _, labels = connected_components(coo_matrix((np.ones(len(kept)), kept.T), shape=(n, n)), directed=False)
    return np.where(members, labels, -1).astype(np.int64)


def _flooded(cores: NDArray[np.int64], voxels: Voxels, there: Mask) -> NDArray[np.int64]:
    """Give every voxel the core nearest to it along the surface, which is longer over creases; numbered from 0."""
    starts = np.flatnonzero(cores >= 0)
    owners = np.full(len(cores), -1, np.int64)
    if len(starts):
        pairs = voxels.pairs[there[voxels.pairs].all(axis=1)]
        lengths = np.linalg.norm(voxels.center[pairs[:, 0]] - voxels.center[pairs[:, 1]], axis=1)
        lengths *= 1 + voxels.concave[pairs].max(axis=1) * _PER_DEGREE
        n = len(cores)
        graph = coo_matrix((np.maximum(lengths, 1e-9), pairs.T), shape=(n, n)).tocsr()
        distance, _, source = dijkstra(graph, directed=False, indices=starts, min_only=True, return_predecessors=True)
        reached = np.isfinite(distance)
        owners[reached] = cores[source[reached]]
        owners[starts] = cores[starts]
    owners[~there] = -1
    known = owners >= 0
    owners[known] = np.unique(owners[known], return_inverse=True)[1]
    return owners
