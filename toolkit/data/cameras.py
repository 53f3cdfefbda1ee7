"""Where the benchmark's cameras stand. Metres, radians; the table's top is z = 0."""

from __future__ import annotations

from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from toolkit.data.conditions import Conditions
from toolkit.geometry import look_at, make_transform
from toolkit.types import Camera, Float

Resolution = Literal["640x480", "1280x720"]

HOME_AZIMUTH = np.radians(-90)
_DISTANCE_M = 1.05
_ELEVATION = np.radians(45)
_LOOK_AT = np.array([0.0, 0.0, 0.03])

# Colour intrinsics as a factory-calibrated D435i reports them, rounded (librealsense, rs-enumerate-devices -c).
_INTRINSICS = {
    "640x480": (616.0, 616.0, 319.5, 239.5, 640, 480),
    "1280x720": (912.0, 912.0, 639.5, 359.5, 1280, 720),
}

_OTHER_SIZES = ((640, 480), (800, 600), (848, 480), (960, 540), (1024, 768), (1280, 720))
_USUAL_FOCAL = 616 / 480
"""Focal length in image heights."""

_POSE_JITTER_DEG, _POSE_JITTER_M = 0.2, 0.002


def home_camera(resolution: Resolution) -> Camera:
    """The fixed frontal view the goal image is taken from."""
    return _predefined(resolution, HOME_AZIMUTH)


def filming_camera(resolution: Resolution) -> Camera:
    """A view from further off and beside the home view, for people."""
    home = home_camera(resolution)
    return Camera(home.K, look_at(np.array([1.25, 0.85, 0.95]), np.array([0.0, -0.15, 0.25])), home.width, home.height)


def goal_camera(conditions: Conditions, resolution: Resolution, rng: np.random.Generator) -> Camera:
    """The camera of the goal image: at home, unless held by hand; further off where its focal length is longer."""
    K, width, height = _other_intrinsics(rng) if conditions.goal_camera == "other" else _intrinsics(resolution)
    zoom = float(K[1, 1]) / height / _USUAL_FOCAL if conditions.goal_camera == "other" else 1.0
    if not conditions.handheld:
        return Camera(K, _pose(HOME_AZIMUTH, _ELEVATION, _DISTANCE_M * zoom), width, height)
    azimuth = HOME_AZIMUTH + np.radians(rng.uniform(-25, 25))
    return Camera(K, _scattered(azimuth, _held_elevation(rng), _held_distance(rng) * zoom, rng), width, height)


def current_cameras(
    conditions: Conditions, resolution: Resolution, views: int, rng: np.random.Generator
) -> list[Camera]:
    """The cameras of the current frames: evenly spaced on the ring, the first at home, or on an arc about home."""
    count = min(views, conditions.most_views or views)
    ring = conditions.arc_deg == 360
    if ring:
        azimuths = [HOME_AZIMUTH + 2 * np.pi * i / count for i in range(count)]
    else:
        half = np.radians(conditions.arc_deg) / 2 * (count > 1)
        azimuths = (HOME_AZIMUTH + np.linspace(-half, half, count)).tolist()
    if not conditions.handheld:
        return [_predefined(resolution, azimuth) for azimuth in azimuths]
    # An arc is one movement of one person: it has its own middle, height and distance, which the frames keep to.
    start = 0.0 if ring else np.radians(rng.uniform(-40, 40))
    elevation, distance = _held_elevation(rng), _held_distance(rng)
    K, width, height = _intrinsics(resolution)
    return [Camera(K, _scattered(a + start, elevation, distance, rng), width, height) for a in azimuths]


def jitter(camera: Camera, rng: np.random.Generator) -> Camera:
    """Where the camera really is, when its stated pose is off by a calibrated arm's error."""
    turn = Rotation.from_rotvec(rng.normal(0, np.radians(_POSE_JITTER_DEG) / np.sqrt(3), 3)).as_matrix()
    shift = rng.normal(0, _POSE_JITTER_M / np.sqrt(3), 3)
    return Camera(camera.K, camera.T_world_camera @ make_transform(turn, shift), camera.width, camera.height)


def _predefined(resolution: Resolution, azimuth: float) -> Camera:
    K, width, height = _intrinsics(resolution)
    return Camera(K, _pose(azimuth, _ELEVATION, _DISTANCE_M), width, height)


def _intrinsics(resolution: Resolution) -> tuple[Float, int, int]:
    fx, fy, cx, cy, width, height = _INTRINSICS[resolution]
    return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]), width, height


def _other_intrinsics(rng: np.random.Generator) -> tuple[Float, int, int]:
    """A wide phone camera to a short telephoto lens, the principal point a little off the middle."""
    width, height = _OTHER_SIZES[int(rng.integers(len(_OTHER_SIZES)))]
    focal = _USUAL_FOCAL * height * np.exp(rng.uniform(np.log(0.75), np.log(1.5)))
    cx, cy = (width - 1) / 2 + rng.normal(0, 0.01 * width), (height - 1) / 2 + rng.normal(0, 0.01 * height)
    return np.array([[focal, 0, cx], [0, focal * rng.uniform(0.997, 1.003), cy], [0, 0, 1]]), width, height


def _held_elevation(rng: np.random.Generator) -> float:
    return float(np.radians(rng.uniform(26, 72)))


def _held_distance(rng: np.random.Generator) -> float:
    return float(_DISTANCE_M * rng.uniform(0.9, 1.3))


def _scattered(azimuth: float, elevation: float, distance: float, rng: np.random.Generator) -> Float:
    """(4, 4) pose of a camera held by hand near a viewpoint."""
    pose = _pose(
        azimuth + np.radians(rng.normal(0, 3)),
        elevation + np.radians(rng.normal(0, 2)),
        distance * np.exp(rng.normal(0, 0.04)),
        rng.normal(0, 0.02, 3),
    )
    return pose @ make_transform(Rotation.from_euler("z", rng.normal(0, 3), degrees=True).as_matrix(), np.zeros(3))


def _pose(azimuth: float, elevation: float, distance: float, aside: Float | None = None) -> Float:
    """(4, 4) pose of a camera that looks at the table's middle, or `aside` of it."""
    out, up = np.cos(elevation), np.sin(elevation)
    target = _LOOK_AT if aside is None else _LOOK_AT + aside
    return look_at(_LOOK_AT + distance * np.array([out * np.cos(azimuth), out * np.sin(azimuth), up]), target)
