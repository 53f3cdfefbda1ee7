"""The simulator's camera is the toolkit's camera: sub-pixel and sub-millimetre."""

from __future__ import annotations

import cv2
import numpy as np
import pybullet
import pytest

from toolkit.geometry import invert, lift, look_at, project
from toolkit.sim.bullet import best_renderer
from toolkit.sim.world import Light, World
from toolkit.types import Camera

HALF = np.array([0.10, 0.07, 0.03])
RENDERERS = [
    ("tiny", 1),
    ("tiny", 2),
    ("tiny", 3),
    pytest.param("egl", 1, marks=pytest.mark.skipif(best_renderer() != "egl", reason="EGL does not load here")),
]


def render_box(renderer, supersample, camera):
    with World(renderer) as world:
        box = pybullet.createVisualShape(pybullet.GEOM_BOX, halfExtents=HALF.tolist(), physicsClientId=world.client)
        pybullet.createMultiBody(0, -1, box, physicsClientId=world.client)
        return world.render(camera, Light(), supersample)


@pytest.mark.parametrize(("renderer", "supersample"), RENDERERS)
def test_masks_lie_where_the_camera_model_says(renderer, supersample):
    K = np.array([[616.0, 0, 331.3], [0, 616, 236.7], [0, 0, 1]])
    camera = Camera(K, look_at(np.array([0.1, -0.8, 0.6]), np.zeros(3)), 640, 480)
    _, _, ids = render_box(renderer, supersample, camera)
    corners = HALF * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    pixels, _ = project(K, invert(camera.T_world_camera), corners)
    outline = cv2.moments(cv2.convexHull(pixels.astype(np.float32)))
    expected = np.array([outline["m10"], outline["m01"]]) / outline["m00"]
    y, x = np.nonzero(ids >= 0)
    # An even number of samples has none at the pixel's centre: the id is that of the next one.
    tolerance = 0.1 if supersample % 2 else 0.3
    np.testing.assert_allclose([x.mean(), y.mean()], expected, atol=tolerance)
    assert (ids >= 0).sum() == pytest.approx(outline["m00"], rel=0.005)


@pytest.mark.parametrize(("renderer", "supersample"), RENDERERS)
def test_depth_lifts_to_the_surface(renderer, supersample):
    K = np.array([[616.0, 0, 319.5], [0, 616, 239.5], [0, 0, 1]])
    camera = Camera(K, look_at(np.array([0.2, -0.8, 0.7]), np.zeros(3)), 640, 480)
    _, depth, ids = render_box(renderer, supersample, camera)
    inside = cv2.erode((ids >= 0).astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    y, x = np.nonzero(inside)
    points = lift(K, camera.T_world_camera, np.stack([x, y], axis=1), depth[y, x])
    surface = np.abs(np.abs(points) - HALF).min(axis=1)
    assert np.quantile(surface, 0.95) < 0.0003
    assert (np.abs(points) < HALF + 0.001).all()


def test_worlds_do_not_share_a_client():
    with World() as a, World() as b:
        assert a.client != b.client
