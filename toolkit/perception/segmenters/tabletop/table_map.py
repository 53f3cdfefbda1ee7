"""The empty table as a camera would see it, put together from the current frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from toolkit.errors import ToolkitError
from toolkit.geometry import invert, project
from toolkit.perception.plane import Plane, fit_planes, on_plane, pixel_rays, table_frame, table_homography
from toolkit.perception.segmenters.tabletop.clusters import cluster_above_plane, table_hull
from toolkit.perception.segmenters.tabletop.looks import learn_looks
from toolkit.types import Camera, Float, Frame, Image, Mask

_OBJECT_MARGIN_PX = 4
_HEADROOM = 1.2
_LEAST_HEIGHT_M = 0.05


@dataclass(frozen=True, eq=False)
class TableScan:
    """What the current frames' depth says about the table.

    Attributes:
        frames: (frame, (H, W) bool mask of its table pixels), one per frame whose depth shows the table.
        T_world_table: (4, 4) the table's own frame: z = 0 is its surface, z points up from it.
        outline: (M, 2) float64 convex outline in that frame, metres.
        height: of the tallest object, metres.
        looks: (K, B) of the objects in the fullest frame, from `learn_looks`.
    """

    frames: tuple[tuple[Frame, Mask], ...]
    T_world_table: Float
    outline: Float
    height: float
    looks: Float


@dataclass(frozen=True, eq=False)
class TableView:
    """The empty table in one camera.

    Attributes:
        rgb: (H, W, 3) uint8, the median of the frames that saw the table there.
        seen: (H, W) bool, where one did.
        table: (H, W) bool, the table's surface.
        reach: (H, W) bool, where things that stand on the table can appear.
    """

    rgb: Image
    seen: Mask
    table: Mask
    reach: Mask


def scan_table(current: Sequence[Frame]) -> TableScan:
    """Find the table in every frame and join what they say.

    Args:
        current: RGB-D frames.

    Raises:
        ToolkitError: no frame's depth shows a table.
    """
    frames: list[tuple[Frame, Mask]] = []
    planes: list[Plane] = []
    height = _LEAST_HEIGHT_M
    labels: list[NDArray[np.int32]] = []
    if not current:
        raise ToolkitError("table_appearance learns the table from the current frames, and there is none")
    for frame, plane in zip(current, fit_planes(current), strict=True):
        if plane is None:
            continue
        labels.append(cluster_above_plane(frame, plane))
        things = labels[-1] > 0
        if things.any() and frame.depth is not None:
            tops = plane.heights(pixel_rays(frame)[things], frame.depth[things])
            height = max(height, float(np.percentile(tops, 99)))
        kernel = np.ones((2 * _OBJECT_MARGIN_PX + 1,) * 2, np.uint8)
        frames.append((frame, on_plane(plane, frame) & (cv2.dilate(things.astype(np.uint8), kernel) == 0)))
        planes.append(plane)
    T_world_table = table_frame([frame for frame, _ in frames], planes)
    points = np.concatenate([_table_points(frame, mask) for frame, mask in frames])
    in_table = (points - T_world_table[:3, 3]) @ T_world_table[:3, :2]
    outline = table_hull(in_table.astype(np.float32)).astype(np.float64)
    places = [_places(frame, label, T_world_table) for (frame, _), label in zip(frames, labels, strict=True)]
    looks = learn_looks([frame for frame, _ in frames], labels, places)
    return TableScan(tuple(frames), T_world_table, outline, height * _HEADROOM, looks)


def render_table(scan: TableScan, camera: Camera) -> TableView:
    """Draw the empty table as `camera` sees it: every frame warped by the table's homography, then their median."""
    size = (camera.width, camera.height)
    to_camera = table_homography(scan.T_world_table, camera)
    colours, counts = [], np.zeros((camera.height, camera.width), np.uint8)
    for frame, mask in scan.frames:
        warp = table_homography(scan.T_world_table, frame.camera) @ np.linalg.inv(to_camera)
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        rgb = cv2.warpPerspective(frame.rgb, warp, size, flags=flags)
        seen = cv2.warpPerspective(mask.astype(np.uint8) * 255, warp, size, flags=flags) == 255
        # What a frame did not see sorts last, behind the `counts` samples that the median is taken of.
        rgb[~seen] = 255
        colours.append(rgb)
        counts += seen
    stack = _sorted(colours)
    middle = (np.maximum(counts, 1).astype(np.int64) - 1) // 2
    rgb = np.take_along_axis(stack, middle[None, :, :, None], axis=0)[0]
    surface = _polygon(scan, camera, (0.0,))
    return TableView(rgb, (counts > 0) & surface, surface, _polygon(scan, camera, (0.0, scan.height)))


def _sorted(images: list[Image]) -> Image:
    """Sort along a new first axis by odd-even transposition, each step over whole images: faster than np.sort."""
    rows = list(images)
    for step in range(len(rows)):
        for i in range(step % 2, len(rows) - 1, 2):
            rows[i], rows[i + 1] = np.minimum(rows[i], rows[i + 1]), np.maximum(rows[i], rows[i + 1])
    return np.stack(rows)


def _places(frame: Frame, labels: NDArray[np.int32], T_world_table: Float) -> Float:
    """(n, 2) mean position of every label 1..n on the table, metres."""
    assert frame.depth is not None
    T = invert(T_world_table) @ frame.camera.T_world_camera
    chosen = (labels > 0) & (frame.depth > 0)
    plan = (pixel_rays(frame)[chosen] * frame.depth[chosen][:, None]) @ T[:2, :3].T + T[:2, 3]
    members = labels[chosen]
    counts = np.bincount(members, minlength=int(labels.max()) + 1)[1:]
    sums = [np.bincount(members, axis, len(counts) + 1)[1:] for axis in plan.T]
    return np.stack(sums, axis=1) / np.maximum(counts, 1)[:, None]


def _table_points(frame: Frame, mask: Mask, step: int = 4) -> Float:
    """(N, 3) world points of a sparse grid of the table's pixels."""
    assert frame.depth is not None
    chosen = mask[::step, ::step]
    points = pixel_rays(frame)[::step, ::step][chosen] * frame.depth[::step, ::step][chosen][:, None]
    return points @ frame.camera.T_world_camera[:3, :3].T + frame.camera.T_world_camera[:3, 3]


def _polygon(scan: TableScan, camera: Camera, levels: Sequence[float]) -> Mask:
    """(H, W) bool: the convex hull of the table's outline raised to each level."""
    corners = [np.column_stack([scan.outline, np.full(len(scan.outline), level)]) for level in levels]
    world = np.concatenate(corners) @ scan.T_world_table[:3, :3].T + scan.T_world_table[:3, 3]
    pixels, _ = project(camera.K, invert(camera.T_world_camera), world)
    ahead = pixels[np.isfinite(pixels).all(axis=1)]
    mask = np.zeros((camera.height, camera.width), np.uint8)
    if len(ahead) > 2:
        limit = 20.0 * max(camera.width, camera.height)
        cv2.fillConvexPoly(mask, cv2.convexHull(np.rint(ahead.clip(-limit, limit)).astype(np.int32)), 1)
    return mask > 0
