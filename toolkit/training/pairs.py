"""Training pairs for matching: two augmented crops of one object, and where each coarse cell of one lies in the other.

Correspondences are exact: through depth and pose, with a check that the point is seen in both. Crop pixels count as
everywhere in the toolkit, (0, 0) at the centre of the first; cell (i, j) of LoFTR's coarse map sits on
(8 i - 0.5, 8 j - 0.5), as it does for the published checkpoints.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from toolkit.geometry import invert, lift, project
from toolkit.registry import PluginConfig
from toolkit.training.pool import Pool, View
from toolkit.types import Float, Image, Mask

_VISIBLE_M = 0.004
"""A point whose depth differs more from what the other view measured there is hidden in it."""


class PairsConfig(PluginConfig):
    """Settings of the pairs drawn from a pool."""

    crop_size: int = Field(default=160, ge=32, multiple_of=8, description="Side of the crops, in pixels.")
    max_angle_deg: float = Field(
        default=60.0, gt=0, le=180, description="Largest angle between the viewing directions of a pair, in degrees."
    )
    roll_deg: float = Field(
        default=20.0, ge=0, le=180, description="Largest in-plane rotation of a crop either way, in degrees."
    )
    occlusion: float = Field(default=0.25, ge=0, le=1, description="Share of crops of which a part is hidden.")
    loose_mask: float = Field(
        default=0.3, ge=0, le=1, description="Share of crops whose mask includes some of the table around the object."
    )
    blur_px: float = Field(default=1.2, ge=0, description="Strongest blur, in pixels of the frame.")
    noise: float = Field(default=4.0, ge=0, description="Strongest noise, in grey levels.")


@dataclass(frozen=True, eq=False)
class Sample:
    """One augmented crop.

    Attributes:
        image: (S, S, 3) uint8, black outside the mask.
        mask: (S, S) bool.
        to_crop: (2, 3) takes the view's pixels to the crop's.
        view: what it was cut from.
        visible: (h, w) bool, the view's pixels of the object that the crop shows.
    """

    image: Image
    mask: Mask
    to_crop: Float
    view: View
    visible: Mask


@dataclass(frozen=True, eq=False)
class Pair:
    """Two crops of one object and the truth between them.

    Attributes:
        samples: the two crops.
        cells: (M, 2) int64 matched coarse cells, row-major numbers in the first and the second crop.
        target_xy: (M, 2) float64 where the first crop's cell centres really lie in the second, crop pixels.
        seen_xy: (L, 2) the same for every cell of the first crop; NaN where it is not seen in the second.
    """

    samples: tuple[Sample, Sample]
    cells: NDArray[np.int64]
    target_xy: Float
    seen_xy: Float


class PairSource:
    """Draws pairs from a pool; a pair depends on its generator alone.

    Args:
        pool: the views.
        config: how they are paired and augmented.
    """

    def __init__(self, pool: Pool, config: PairsConfig) -> None:
        self.config, self.pool = config, pool
        self._views = pool.views
        self._partners = [near for rows in pool.by_object() for near in self._near(rows) if len(near[1])]

    def __len__(self) -> int:
        """Number of views that have a partner."""
        return len(self._partners)

    def draw(self, rng: np.random.Generator) -> Pair:
        """One pair of views of one object in the same resting pose, augmented."""
        first, others = self._partners[int(rng.integers(len(self._partners)))]
        second = int(others[rng.integers(len(others))])
        samples = [augmented_crop(self._views[i], self.config, rng) for i in (first, second)]
        return relate(samples[0], samples[1])

    def _near(self, rows: list[int]) -> list[tuple[int, NDArray[np.int64]]]:
        views = [self._views[i] for i in rows]
        if not views:
            return []
        eyes = np.stack([view.T_object_camera[:3, 3] for view in views])
        eyes /= np.linalg.norm(eyes, axis=1, keepdims=True)
        rests = np.array([view.rest for view in views])
        close = (eyes @ eyes.T > np.cos(np.radians(self.config.max_angle_deg))) & (rests[:, None] == rests)
        np.fill_diagonal(close, False)
        return [(rows[i], np.array(rows)[close[i]]) for i in range(len(rows))]


def augmented_crop(view: View, config: PairsConfig, rng: np.random.Generator) -> Sample:
    """Cut a view's object out as the pipeline does (`perception.crops`), rolled, occluded, relit, blurred and noisy."""
    visible = view.mask
    if rng.random() < config.occlusion:
        visible = _bitten(visible, rng)
    shown = visible
    if rng.random() < config.loose_mask:
        side = 2 * int(rng.integers(1, 4)) + 1
        kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side))
        change = cv2.dilate if rng.random() < 0.7 else cv2.erode
        shown = change(visible.astype(np.uint8), kernel) > 0
        shown = shown if shown.sum() > 50 else visible
    size = config.crop_size
    to_crop, scale = _placement(shown, size, np.radians(rng.uniform(-1, 1) * config.roll_deg), rng.uniform(0.02, 0.1))
    rgb = _relit(np.asarray(view.rgb), rng)
    sigma = float(np.hypot(rng.uniform(0, config.blur_px) if rng.random() < 0.5 else 0, _antialias(scale)))
    if sigma > 0.2:
        rgb = cv2.GaussianBlur(rgb, (0, 0), sigma)
    rgb = rgb + rng.normal(0, rng.uniform(0, config.noise), rgb.shape)
    masked = np.where(shown[..., None], rgb, 0).clip(0, 255).astype(np.uint8)
    flags = cv2.INTER_LINEAR if scale < 1 else cv2.INTER_CUBIC
    image = cv2.warpAffine(masked, to_crop, (size, size), flags=flags)
    mask = cv2.warpAffine(shown.astype(np.uint8), to_crop, (size, size), flags=cv2.INTER_NEAREST) > 0
    return Sample(np.where(mask[..., None], image, 0).astype(np.uint8), mask, to_crop, view, visible & shown)


def relate(first: Sample, second: Sample) -> Pair:
    """Find the true matches between two crops' coarse cells: nearest in both directions, seen in both."""
    grid = cell_centers(first.mask.shape[0])
    forth, back = _carry(first, second, grid), _carry(second, first, grid)
    there, here = _cell_of(forth, second.mask), _cell_of(back, first.mask)
    own = np.arange(len(grid))
    start = _cell_of(grid, first.mask)
    matched = (start == own) & (there >= 0) & (here[np.maximum(there, 0)] == own)
    cells = np.stack([own[matched], there[matched]], axis=1)
    return Pair((first, second), cells, forth[matched], np.where((start == own)[:, None], forth, np.nan))


def cell_centers(size: int) -> Float:
    """(L, 2) crop pixels (x, y) of the coarse cells of an S-pixel crop, row-major."""
    ticks = np.arange(0, size, 8) - 0.5
    return np.stack(np.meshgrid(ticks, ticks), axis=-1).reshape(-1, 2)


def _cell_of(xy: Float, mask: Mask) -> NDArray[np.int64]:
    """(N,) the cell nearest to each position; -1 where there is none or its own pixel is off the mask."""
    n = mask.shape[0] // 8
    known = np.asarray(np.isfinite(xy).all(axis=1))
    cell = np.rint((np.where(known[:, None], xy, 0) + 0.5) / 8).astype(np.int64)
    known &= ((cell >= 0) & (cell < n)).all(axis=1)
    cell = np.where(known[:, None], cell, 0)
    known &= mask[8 * cell[:, 1], 8 * cell[:, 0]]
    return np.where(known, cell[:, 1] * n + cell[:, 0], -1)


def _carry(source: Sample, target: Sample, crop_xy: Float) -> Float:
    """(N, 2) positions of one crop in the other; NaN where the point is off the object or hidden."""
    R, t = source.to_crop[:, :2], source.to_crop[:, 2]
    xy = (crop_xy - t) @ np.linalg.inv(R).T
    depth = _depth_at(source.view, source.visible, xy)
    known = np.isfinite(depth)
    points = lift(source.view.K, source.view.T_object_camera, xy, np.where(known, depth, 1.0))
    seen, z = project(target.view.K, invert(target.view.T_object_camera), points)
    measured = _depth_at(target.view, target.visible, np.nan_to_num(seen, nan=-1e3))
    known &= np.isfinite(measured) & (np.abs(np.nan_to_num(measured) - z) < _VISIBLE_M)
    return np.where(known[:, None], seen @ target.to_crop[:, :2].T + target.to_crop[:, 2], np.nan)


def _depth_at(view: View, visible: Mask, xy: Float) -> Float:
    """(N,) depth by bilinear inverse depth where all four neighbours show one surface of the object; else NaN."""
    height, width = visible.shape
    corner = np.floor(xy).astype(np.int64)
    inside = np.asarray(((corner >= 0) & (corner < [width - 1, height - 1])).all(axis=1))
    x, y = np.where(inside[:, None], corner, 0).T
    rows, columns = y[:, None] + [0, 0, 1, 1], x[:, None] + [0, 1, 0, 1]
    depths = view.depth[rows, columns].astype(np.float64)
    good = inside & visible[rows, columns].all(axis=1) & (np.ptp(depths, axis=1) < 0.01)
    fx, fy = (xy - corner).T
    weights = np.stack([(1 - fx) * (1 - fy), fx * (1 - fy), (1 - fx) * fy, fx * fy], axis=1)
    inverse = (weights / np.maximum(depths, 1e-6)).sum(axis=1)
    return np.where(good, 1 / np.where(good, inverse, 1.0), np.nan)


def _placement(shown: Mask, size: int, roll: float, margin: float) -> tuple[Float, float]:
    """The similarity that turns the mask by `roll` and fits its box into the crop; and its scale."""
    R = np.array([[np.cos(roll), -np.sin(roll)], [np.sin(roll), np.cos(roll)]])
    rows, columns = np.nonzero(shown)
    turned = np.stack([columns, rows], axis=1) @ R.T
    low, high = turned.min(axis=0), turned.max(axis=0)
    scale = size / ((float((high - low).max()) + 1) * (1 + 2 * margin))
    shift = (size - 1) / 2 - scale * (low + high) / 2
    return np.concatenate([scale * R, shift[:, None]], axis=1), scale


def _antialias(scale: float) -> float:
    return 0.5 * float(np.sqrt(1 / scale**2 - 1)) if scale < 1 else 0.0


def _bitten(mask: Mask, rng: np.random.Generator) -> Mask:
    """Hide what lies beyond a random line, or inside a random ellipse at the border: up to about half of the mask."""
    rows, columns = np.nonzero(mask)
    at = int(rng.integers(len(rows)))
    y, x = np.indices(mask.shape)
    angle = rng.uniform(0, 2 * np.pi)
    along = np.cos(angle) * x + np.sin(angle) * y
    if rng.random() < 0.5:
        hidden = along > np.quantile(along[mask], rng.uniform(0.55, 0.95))
    else:
        across = -np.sin(angle) * x + np.cos(angle) * y
        a, b = np.sqrt(mask.sum()) * rng.uniform(0.1, 0.45, 2)
        du, dv = along - along[rows[at], columns[at]], across - across[rows[at], columns[at]]
        hidden = (du / a) ** 2 + (dv / b) ** 2 < 1
    left = mask & ~hidden
    return left if np.count_nonzero(left) > 0.4 * np.count_nonzero(mask) else mask


def _relit(rgb: Image, rng: np.random.Generator) -> Float:
    """Another exposure, contrast, white balance, and light that falls off across the object; float32, not clipped."""
    height, width = rgb.shape[:2]
    image = (rgb.astype(np.float32) / 255) ** np.float32(np.exp(rng.uniform(-0.35, 0.35)))
    gain = np.exp(rng.uniform(-0.3, 0.3)) * np.exp(rng.uniform(-0.1, 0.1, 3))
    slope = rng.uniform(-0.3, 0.3, 2)
    ramp = 1 + slope[0] * np.linspace(-1, 1, width)[None, :] + slope[1] * np.linspace(-1, 1, height)[:, None]
    return (255 * image * gain * ramp[..., None]).astype(np.float32)
