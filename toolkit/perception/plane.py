"""The table plane in one depth image.

In a pinhole camera the inverse depth of a plane is linear in the pixel's ray, 1/z = c . (x, y, 1), and a stereo
camera's error is even in inverse depth, so both the fit and its noise live there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from toolkit.errors import ToolkitError
from toolkit.geometry import invert
from toolkit.perception.robust import deviation
from toolkit.types import Camera, Float, Frame, Mask

_SAMPLES = 3000
_HYPOTHESES = 256
_CONSENSUS_M = 0.008
_LEAST_CONSENSUS = 0.15


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


def fit_plane(frame: Frame) -> Plane:
    """Find the plane that most measured pixels lie on: RANSAC (Fischler and Bolles, CACM 1981), then least squares.

    Raises:
        ToolkitError: the frame has no depth, too little of it, or no plane that holds a fair part of it.
    """
    if frame.depth is None:
        raise ToolkitError(f"frame {frame.index} has no depth, and the table plane is found in depth")
    measured = np.flatnonzero(frame.depth)
    if len(measured) < _SAMPLES:
        raise ToolkitError(f"frame {frame.index}: only {len(measured)} pixels have depth, too few to find the table")
    rng = np.random.default_rng(0)
    chosen = measured[np.linspace(0, len(measured) - 1, 8 * _SAMPLES).astype(np.int64)]
    rays = pixel_rays(frame).reshape(-1, 3)[chosen].astype(np.float64)
    depth = frame.depth.ravel()[chosen].astype(np.float64)
    coefficients, share = _ransac(rays[::8], depth[::8], rng)
    if share < _LEAST_CONSENSUS:
        raise ToolkitError(f"frame {frame.index}: no plane holds more than {share:.0%} of the depth; is there a table?")
    return _refine(coefficients, rays, depth)


def fit_planes(frames: Sequence[Frame]) -> list[Plane | None]:
    """The table plane of every frame; None where a frame's depth shows none.

    Raises:
        ToolkitError: no frame shows one; the last one's reason.
    """
    planes: list[Plane | None] = []
    reason: ToolkitError | None = None
    for frame in frames:
        try:
            planes.append(fit_plane(frame))
        except ToolkitError as error:
            planes.append(None)
            reason = error
    if reason is not None and not any(planes):
        raise reason
    return planes


def _ransac(rays: Float, depth: Float, rng: np.random.Generator) -> tuple[Float, float]:
    """Return the best (3,) coefficients and the share of points within _CONSENSUS_M of them."""
    triples = rng.integers(0, len(rays), (_HYPOTHESES, 3))
    points = rays[triples] * depth[triples, None]
    usable = np.abs(np.linalg.det(points)) > 1e-6
    coefficients = np.linalg.solve(points[usable], np.ones((int(usable.sum()), 3, 1)))[..., 0]
    if not len(coefficients):
        return np.array([0.0, 0.0, 1.0]), 0.0
    heights = (1 - (rays * depth[:, None]) @ coefficients.T) / np.linalg.norm(coefficients, axis=1)
    votes = (np.abs(heights) < _CONSENSUS_M).mean(axis=0)
    best = int(votes.argmax())
    return coefficients[best], float(votes[best])


def _refine(coefficients: Float, rays: Float, depth: Float) -> Plane:
    """Least squares over the inliers, which shrink to the table's own noise."""
    plane = Plane(coefficients, 0.0)
    inverse = 1 / depth
    reach = _CONSENSUS_M / (plane.camera_height * depth)
    for _ in range(4):
        inliers = np.abs(inverse - plane.inverse_depth(rays)) < reach
        solution = np.linalg.lstsq(rays[inliers], inverse[inliers], rcond=None)[0]
        residual = inverse[inliers] - rays[inliers] @ solution
        plane = Plane(solution, float(deviation(residual)))
        reach = np.minimum(reach, max(3 * plane.noise, 1e-4))
    return plane


def plan_axes(plane: Plane) -> Float:
    """(2, 3) orthonormal axes that span the plane, camera coordinates."""
    helper = np.eye(3)[int(np.abs(plane.normal).argmin())]
    first = np.cross(plane.normal, helper)
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(plane.normal, first)])


def on_plane(plane: Plane, frame: Frame, tolerance: float = 4.0) -> Mask:
    """(H, W) bool: pixels whose depth is the plane's within `tolerance` deviations of its noise (1 mm at least)."""
    assert frame.depth is not None
    expected = plane.inverse_depth(pixel_rays(frame))
    reach = np.maximum(tolerance * plane.noise, 1e-3 / plane.camera_height * expected)
    with np.errstate(divide="ignore"):
        return np.abs(1 / frame.depth - expected) < reach


def table_frame(frames: Sequence[Frame], planes: Sequence[Plane | None]) -> Float:
    """(4, 4) T_world_table: z = 0 is the table, z points up from it; the median of what (F,) frames' planes say."""
    seen = [(frame.camera.T_world_camera, p) for frame, p in zip(frames, planes, strict=True) if p is not None]
    normals = np.array([T[:3, :3] @ plane.normal for T, plane in seen])
    up = np.median(normals, axis=0)
    up /= np.linalg.norm(up)
    levels = [T[:3, 3] @ n - plane.camera_height for (T, plane), n in zip(seen, normals, strict=True)]
    side = np.cross(up, np.eye(3)[int(np.abs(up).argmin())])
    side /= np.linalg.norm(side)
    T = np.eye(4)
    T[:3, :3] = np.stack([side, np.cross(up, side), up], axis=1)
    T[:3, 3] = up * np.median(levels)
    return T


def table_homography(T_world_table: Float, camera: Camera) -> Float:
    """(3, 3) from (x, y, 1) on the table to pixels (Hartley and Zisserman, Multiple View Geometry, 8.1)."""
    T = invert(camera.T_world_camera) @ T_world_table
    return camera.K @ T[:3, [0, 1, 3]]
