"""The table's plane before one camera.

In a pinhole camera the inverse depth of a plane is linear in the pixel's ray, 1/z = c . (x, y, 1), and a stereo
camera's error is even in inverse depth, so both the fit and its noise live there.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from toolkit.geometry import invert
from toolkit.perception.robust import deviation
from toolkit.types import Camera, Float, Frame, Mask

_SAMPLES = 30_000
_LEAST_INLIERS = 200
_LEAST_REACH_M = 0.002


@dataclass(frozen=True)
class Plane:
    """A plane before a camera.

    Attributes:
        coefficients: (3,) float64 c, in 1/m: points p of the plane, in camera coordinates, have c . p = 1.
        noise: robust deviation of the table's inverse depth from it, in 1/m.
    """

    coefficients: Float
    noise: float

    @property
    def camera_height(self) -> float:
        """Distance from camera to plane, metres."""
        return 1.0 / float(np.linalg.norm(self.coefficients))

    @property
    def normal(self) -> Float:
        """(3,) unit normal in camera coordinates, from the plane towards the camera."""
        return -self.coefficients * self.camera_height

    def inverse_depth(self, rays: Float) -> Float:
        """(...,) 1/m: inverse depth at which (..., 3) rays with z = 1 meet the plane; not positive where none does."""
        return rays @ self.coefficients.astype(rays.dtype)

    def heights(self, rays: Float, depth: Float) -> Float:
        """(...,) metres above the plane of points at `depth` (...,) along (..., 3) rays with z = 1."""
        return self.camera_height * (1 - depth * self.inverse_depth(rays))


def pixel_rays(frame: Frame) -> Float:
    """(H, W, 3) float32 viewing rays with z = 1, camera coordinates."""
    camera = frame.camera
    return _rays(camera.K.tobytes(), camera.height, camera.width)


@lru_cache(maxsize=4)
def _rays(K_bytes: bytes, height: int, width: int) -> Float:
    K = np.frombuffer(K_bytes).reshape(3, 3)
    rays = np.ones((height, width, 3), np.float32)
    rays[..., 0] = (np.arange(width) - K[0, 2]) / K[0, 0]
    rays[..., 1] = ((np.arange(height) - K[1, 2]) / K[1, 1])[:, None]
    rays.flags.writeable = False
    return rays


def fit_near(frame: Frame, T_world_table: Float, reach: float) -> Plane | None:
    """The table as one frame's depth has it: least squares over what lies near the table that all frames share.

    Poses are off by millimetres and a sensor's depth is bowed, so every frame has its own version of one table.

    Args:
        frame: with depth.
        T_world_table: (4, 4), z = 0 is the table and z points up from it.
        reach: metres above and below it that are looked at; shrinks to the frame's own noise.

    Returns:
        The plane before this camera, or None where too little of the table is seen.
    """
    assert frame.depth is not None
    T = invert(frame.camera.T_world_camera) @ T_world_table
    offset = float(T[:3, 2] @ T[:3, 3])
    measured = np.flatnonzero(frame.depth)
    if offset >= 0 or not len(measured):
        # The camera is below the table.
        return None
    chosen = measured[:: max(len(measured) // _SAMPLES, 1)]
    rays = pixel_rays(frame).reshape(-1, 3)[chosen].astype(np.float64)
    depth = frame.depth.ravel()[chosen].astype(np.float64)
    plane = Plane(T[:3, 2] / offset, 0.0)
    for _ in range(6):
        inliers = np.abs(plane.heights(rays, depth)) < reach
        if inliers.sum() < _LEAST_INLIERS:
            return None
        near, inverse = rays[inliers], 1 / depth[inliers]
        coefficients = np.linalg.lstsq(near.T @ near, near.T @ inverse, rcond=None)[0]
        residual = inverse - near @ coefficients
        plane = Plane(coefficients, float(deviation(residual)))
        spread = 3 * plane.noise * plane.camera_height * float(np.median(depth[inliers]))
        reach = float(np.clip(spread, _LEAST_REACH_M, reach))
    return plane


def on_plane(plane: Plane, frame: Frame, tolerance: float = 4.0) -> Mask:
    """(H, W) bool: pixels whose depth is the plane's within `tolerance` deviations of its noise (1 mm at least)."""
    assert frame.depth is not None
    expected = plane.inverse_depth(pixel_rays(frame))
    reach = np.maximum(tolerance * plane.noise, 1e-3 / plane.camera_height * expected)
    with np.errstate(divide="ignore"):
        return np.abs(1 / frame.depth - expected) < reach


def table_homography(T_world_table: Float, camera: Camera) -> Float:
    """(3, 3) from (x, y, 1) on the table to pixels (Hartley and Zisserman, Multiple View Geometry, 8.1)."""
    T = invert(camera.T_world_camera) @ T_world_table
    return camera.K @ T[:3, [0, 1, 3]]
