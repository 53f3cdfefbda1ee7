"""Object regions of the current scene, and what ties them to objects of the goal image."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from toolkit.geometry import transform_points
from toolkit.types.arrays import Float, checked, freeze, require
from toolkit.types.images import Camera, Segment


@dataclass(frozen=True, eq=False)
class Region:
    """An object region o_k^i of a current frame (Sec. Method A): segment and point cloud in world coordinates.

    Attributes:
        frame_index: index of the frame it was seen in.
        segment: the mask in that frame.
        points: (N, 3) float32 world coordinates, metres; at least one.
        pixels: (N, 2) int32 (x, y) of every point, on the mask, row-major order.
        observation: (3,) float64 unit vector from the cloud's mean to the camera (Eq. obs_pose).

    Raises:
        ToolkitError: an array has another shape or type, or a pixel is off the mask or out of order.
    """

    frame_index: int
    segment: Segment
    points: Float
    pixels: NDArray[np.int32]
    observation: Float

    def __post_init__(self) -> None:
        points = checked(self.points, (None, 3), np.float32, "a region's points")
        require(len(points) > 0, "a region needs at least one point")
        pixels = checked(self.pixels, (len(points), 2), np.int32, "a region's pixels")
        (x, y), (height, width) = pixels.T, self.segment.mask.shape
        inside = (pixels >= 0).all() and x.max() < width and y.max() < height
        require(inside and self.segment.mask[y, x].all(), "a region's pixels must lie on its mask")
        require((np.diff(y.astype(np.int64) * width + x) > 0).all(), "a region's pixels must be in row-major order")
        observation = checked(self.observation, (3,), np.float64, "a region's observation vector")
        length = float(np.linalg.norm(observation))
        require(abs(length - 1) < 1e-6, f"a region's observation vector must be of length 1, got {length}")
        freeze(self, points=points, pixels=pixels, observation=observation)

    def moved(self, T: Float) -> Region:
        """The region in another world, into which (4, 4) `T` takes points of its own."""
        points = transform_points(T, self.points.astype(np.float64)).astype(np.float32)
        return replace(self, points=points, observation=T[:3, :3] @ self.observation)

    @property
    def centroid(self) -> Float:
        """(3,) float64 mean of the points, metres."""
        return np.asarray(self.points.mean(axis=0, dtype=np.float64))


@dataclass(frozen=True, eq=False)
class Matches:
    """2D-2D correspondences between a query crop and a reference crop, in crop pixels.

    Attributes:
        query_xy: (M, 2) float64.
        reference_xy: (M, 2) float64.
        scores: (M,) float64 in 0..1, higher is better.

    Raises:
        ToolkitError: an array has another shape, or is not finite, or a score is out of range.
    """

    query_xy: Float
    reference_xy: Float
    scores: Float

    def __post_init__(self) -> None:
        scores = _checked_shares(self.scores, (None,), "scores")
        query = checked(self.query_xy, (len(scores), 2), np.float64, "query_xy")
        reference = checked(self.reference_xy, (len(scores), 2), np.float64, "reference_xy")
        freeze(self, query_xy=query, reference_xy=reference, scores=scores)

    def __len__(self) -> int:
        return len(self.scores)

    @classmethod
    def empty(cls) -> Matches:
        """No correspondence at all."""
        return cls(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0))


@dataclass(frozen=True, eq=False)
class Correspondences:
    """2D-3D correspondences of one object: the PnP problem (M_3D of the paper).

    Attributes:
        points: (N, 3) float64, metres, in the world of the current scene.
        pixels: (N, 2) float64, in the goal image.
        weights: (N,) float64 in 0..1, the matches' scores.
        camera: the goal camera; its pose is what a prior about the table is stated in.

    Raises:
        ToolkitError: an array has another shape, or is not finite, or a weight is out of range.
    """

    points: Float
    pixels: Float
    weights: Float
    camera: Camera

    def __post_init__(self) -> None:
        points = checked(self.points, (None, 3), np.float64, "the correspondences' points")
        pixels = checked(self.pixels, (len(points), 2), np.float64, "the correspondences' pixels")
        weights = _checked_shares(self.weights, (len(points),), "the correspondences' weights")
        freeze(self, points=points, pixels=pixels, weights=weights)

    def moved(self, T: Float) -> Correspondences:
        """The same problem in another world, into which (4, 4) `T` takes points of its own."""
        return replace(self, points=transform_points(T, self.points), camera=self.camera.moved(T))

    @property
    def K(self) -> Float:
        """(3, 3) float64 intrinsics of the goal camera, pixels."""
        return self.camera.K

    def __len__(self) -> int:
        return len(self.points)


def _checked_shares(values: Float, shape: tuple[int | None], what: str) -> Float:
    shares = checked(values, shape, np.float64, what)
    require(((shares >= 0) & (shares <= 1)).all(), f"{what} must be in 0..1")
    return shares
