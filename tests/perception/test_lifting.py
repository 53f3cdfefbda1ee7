from __future__ import annotations

import numpy as np
import pytest

from toolkit.errors import ToolkitError
from toolkit.geometry import invert, lift, project, transform_points
from toolkit.perception.lifting import lift_pixels
from toolkit.types import Frame


def plane_frame(camera, holes=()):
    """A frame whose depth is that of the plane z = 0, exactly."""
    x, y = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    pixels = np.stack([x, y], axis=-1).reshape(-1, 2)
    origin = camera.T_world_camera[:3, 3]
    rays = lift(camera.K, camera.T_world_camera, pixels, np.ones(len(pixels))) - origin
    depth = (-origin[2] / rays[:, 2]).reshape(y.shape).astype(np.float32)
    for row, column in holes:
        depth[row, column] = 0
    return Frame(0, np.zeros((camera.height, camera.width, 3), np.uint8), camera, np.maximum(depth, 0))


def test_sub_pixel_lifting_is_exact_on_a_plane(camera):
    xy = np.random.default_rng(0).uniform([100, 150], [500, 400], (200, 2))
    points, kept = lift_pixels(plane_frame(camera), np.ones((480, 640), bool), xy)
    assert kept.all()
    np.testing.assert_allclose(points[:, 2], 0, atol=1e-6)
    pixels, _ = project(camera.K, invert(camera.T_world_camera), points)
    np.testing.assert_allclose(pixels, xy, atol=1e-6)


def test_pixels_off_the_object_unmeasured_or_outside_are_dropped(camera):
    mask = np.zeros((480, 640), bool)
    mask[200:300, 200:300] = True
    frame = plane_frame(camera, holes=[(250, 250)])
    xy = np.array([[220.5, 220.5], [199.5, 220], [249.5, 250.2], [-3, 5], [700, 5]])
    points, kept = lift_pixels(frame, mask, xy)
    assert kept.tolist() == [True, False, False, False, False]
    assert np.isfinite(points).all()


def test_a_jump_in_depth_is_not_interpolated(camera):
    frame = plane_frame(camera)
    depth = frame.depth.copy()
    depth[:, 320:] += 0.2
    stepped = Frame(0, frame.rgb, camera, depth)
    _, kept = lift_pixels(stepped, np.ones((480, 640), bool), np.array([[319.5, 240.0], [310.5, 240.0]]))
    assert kept.tolist() == [False, True]


def test_a_frame_without_depth_cannot_lift(camera):
    frame = Frame(3, np.zeros((480, 640, 3), np.uint8), camera)
    with pytest.raises(ToolkitError, match="frame 3 has no depth"):
        lift_pixels(frame, np.ones((480, 640), bool), np.zeros((1, 2)))


def test_lifted_points_move_with_the_camera(camera):
    xy = np.array([[300.0, 240.0]])
    point, _ = lift_pixels(plane_frame(camera), np.ones((480, 640), bool), xy)
    in_camera = transform_points(invert(camera.T_world_camera), point)
    assert in_camera[0, 2] > 0
