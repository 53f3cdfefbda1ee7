"""One goal object, cut out: the grid hypotheses are scored on, the crop poses are refined on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from toolkit.geometry import invert
from toolkit.perception.jax_geometry import on_device
from toolkit.perception.refiners.comparing.align import GoalImage
from toolkit.perception.refiners.comparing.images import Normalizer, opponent
from toolkit.perception.refiners.comparing.render import GRID, GoalGrid
from toolkit.types import Float, Frame, Image, Mask, Segment

LEVELS_PX = (2.5, 1.2, 0.6)
"""Blur of the intensities, coarse to fine, in pixels of the goal."""

_CROP_PX = 192
_CONTOUR = 128
_MARGIN = 0.25
_SMOOTH = 0.4
"""Blur before an image is made smaller, in pixels of the smaller one; four times that is all that a sample sees."""

_CUT_OFF_SHARE = 0.08


@dataclass(frozen=True)
class GoalView:
    """A goal object as the refiners see it.

    Attributes:
        frame: the goal image.
        mask: (H, W) bool, the object.
        cut_off: whether much of the outline is where another object or the image's border ends what is seen.
        grid: for `render.score_poses`.
        image: for `align.align`.
    """

    frame: Frame
    mask: Mask
    cut_off: bool
    grid: GoalGrid
    image: GoalImage


def view_goal(frame: Frame, segment: Segment, others: Sequence[Segment]) -> GoalView:
    """Cut one object out of the goal image; `others` are the remaining objects, which may hide parts of it."""
    hidden = np.zeros(segment.mask.shape, bool)
    for other in others:
        hidden |= other.mask
    hidden &= ~segment.mask
    cut_off = _cut_off(segment.mask, hidden) > _CUT_OFF_SHARE
    cut = _Cut.of(frame, segment, hidden)
    return GoalView(frame, segment.mask, cut_off, _grid(cut), _image(cut, frame))


@dataclass(frozen=True)
class _Cut:
    """The part of the goal that an object's grid and crop are made of.

    Attributes:
        rgb: (h, w, 3) of the image.
        mask: (h, w) bool, the object.
        hidden: (h, w) bool, what other objects may hide.
        corner: pixel of the image that is the part's first one.
        origin: outer corner of the square around the object, in pixels of the part.
        side: of the square, pixels.
    """

    rgb: Image
    mask: Mask
    hidden: Mask
    corner: Float
    origin: Float
    side: float

    @classmethod
    def of(cls, frame: Frame, segment: Segment, hidden: Mask) -> _Cut:
        origin, side = _square(segment, _MARGIN)
        seen = np.ceil(4 * _SMOOTH * side / GRID) + 2
        x0, y0 = np.maximum(origin - seen, 0).astype(int)
        x1, y1 = np.ceil(origin + max(side, _CROP_PX) + seen).astype(int)
        part = np.s_[y0:y1, x0:x1]
        corner = np.array([x0, y0], float)
        return cls(frame.rgb[part], segment.mask[part], hidden[part], corner, origin - corner, side)


def _cut_off(mask: Mask, hidden: Mask) -> float:
    """Share of the outline that touches another object or the image's border."""
    kernel = np.ones((3, 3), np.uint8)
    inside = cv2.copyMakeBorder(mask.astype(np.uint8), 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=0)
    foreign = cv2.copyMakeBorder(hidden.astype(np.uint8), 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=1)
    ring = (cv2.dilate(inside, kernel) > 0) & (inside == 0)
    return float((ring & (cv2.dilate(foreign, kernel) > 0)).sum() / max(ring.sum(), 1))


def _square(segment: Segment, margin: float) -> tuple[Float, float]:
    """Corner pixel (its outer corner) and side of the square around a segment, pixels."""
    x0, y0, x1, y1 = segment.bbox_xyxy
    side = (max(x1 - x0, y1 - y0) + 1) * (1 + 2 * margin)
    return np.array([x0 + x1, y0 + y1]) / 2 - side / 2, side


def _grid(cut: _Cut) -> GoalGrid:
    scale = GRID / cut.side
    color = _resampled(np.where(cut.mask[..., None], opponent(cut.rgb), 0), cut.origin, scale, GRID)
    mask = _resampled(cut.mask, cut.origin, scale, GRID)
    covered = _resampled(cut.hidden, cut.origin, scale, GRID)
    return GoalGrid(
        on_device(color / np.maximum(mask, 0.25)[..., None]),
        on_device(mask > 0.5),
        on_device(covered > 0.25),
        on_device(scale),
        on_device(cut.origin + cut.corner),
    )


def _resampled(image: Float | Image | Mask, origin: Float, scale: float, size: int) -> Float:
    """(size, size) samples of an image whose square starts at the outer corner `origin`."""
    smooth = np.asarray(image, np.float32)
    if scale < 1:
        smooth = np.asarray(cv2.GaussianBlur(smooth, (0, 0), _SMOOTH / scale), np.float32)
    offset = 0.5 * scale - origin * scale - 0.5
    matrix = np.array([[scale, 0, offset[0]], [0, scale, offset[1]]])
    return np.asarray(cv2.warpAffine(smooth, matrix, (size, size), flags=cv2.INTER_LINEAR), np.float32)


def _image(cut: _Cut, frame: Frame) -> GoalImage:
    scale = min(1.0, _CROP_PX / cut.side)
    # At natural size the crop keeps the pixel grid: nothing is interpolated.
    origin = np.floor(cut.origin) - 0.5 if scale == 1.0 else cut.origin
    rgb = np.rint(_resampled(cut.rgb, origin, scale, _CROP_PX)).clip(0, 255).astype(np.uint8)
    mask = _resampled(cut.mask, origin, scale, _CROP_PX) > 0.5
    covered = _resampled(cut.hidden, origin, scale, _CROP_PX) > 0.25
    colors, start = opponent(rgb), origin + cut.corner
    values = np.stack([Normalizer(mask, sigma * scale).normalized(colors) for sigma in LEVELS_PX])
    outside = cv2.distanceTransform((~(mask | covered)).astype(np.uint8), cv2.DIST_L2, 5)
    contour, normals = _outline(mask, covered, frame, start, scale)
    weight = np.zeros(_CONTOUR, np.float32)
    weight[: len(contour)] = 1
    K = np.array(frame.camera.K)
    K[:2] *= scale
    K[:2, 2] += 0.5 * scale - start * scale - 0.5
    T = invert(frame.camera.T_world_camera)
    arrays = (values, outside, _padded(contour), _padded(normals), weight, K, T[:3, :3], T[:3, 3])
    return GoalImage(*map(on_device, arrays))


def _outline(mask: Mask, covered: Mask, frame: Frame, origin: Float, scale: float) -> tuple[Float, Float]:
    """(C, 2) pixels of the mask's outline where it is the object's own, and (C, 2) outward normals."""
    contours, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    points = np.concatenate([c[:, 0] for c in contours]).astype(np.float64) if contours else np.zeros((0, 2))
    soft = cv2.GaussianBlur(mask.astype(np.float32), (0, 0), 1.5)
    slope = -np.stack([cv2.Sobel(soft, cv2.CV_32F, 1, 0), cv2.Sobel(soft, cv2.CV_32F, 0, 1)], axis=-1)
    x, y = points.astype(int).T
    normals = slope[y, x]
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    near_other = cv2.dilate(covered.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    in_goal = (points + 0.5) / scale + origin - 0.5
    height, width = frame.rgb.shape[:2]
    inner = ((in_goal > 1.5) & (in_goal < np.array([width, height]) - 2.5)).all(axis=1)
    own = ~near_other[y, x] & inner & (length[:, 0] > 1e-6)
    points, normals = points[own], (normals / np.maximum(length, 1e-9))[own]
    # The outline runs half a pixel outside the mask's last pixels.
    points = points + 0.5 * normals
    if len(points) > _CONTOUR:
        chosen = np.linspace(0, len(points) - 1, _CONTOUR).astype(int)
        points, normals = points[chosen], normals[chosen]
    return points, normals


def _padded(rows: Float) -> Float:
    padded = np.zeros((_CONTOUR, 2))
    padded[: len(rows)] = rows
    return padded
