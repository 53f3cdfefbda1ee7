"""The simulator's camera is the toolkit's camera: sub-pixel and sub-millimetre."""

from __future__ import annotations

import cv2
import numpy as np
import pybullet
import pytest

from toolkit.geometry import invert, lift, look_at, make_transform, project
from toolkit.sim.bullet import best_renderer
from toolkit.sim.world import Light, World
from toolkit.types import Camera

HALF = np.array([0.10, 0.07, 0.03])
NO_EGL = pytest.mark.skipif(best_renderer() != "egl", reason="EGL does not load here")
RENDERERS = [
    ("tiny", 1),
    ("tiny", 2),
    ("tiny", 3),
    pytest.param("egl", 1, marks=NO_EGL),
]


def render_box(renderer, supersample, camera):
    with World(renderer) as world:
        box = world.client.createVisualShape(pybullet.GEOM_BOX, halfExtents=HALF.tolist())
        world.client.createMultiBody(0, -1, box)
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
        a.client.createMultiBody(0)
        assert (a.client.getNumBodies(), b.client.getNumBodies()) == (1, 0)


@pytest.mark.parametrize(("renderer", "supersample"), RENDERERS)
def test_every_mesh_wears_its_own_texture(renderer, supersample, tmp_path):
    """Quads of one colour each, whose own materials name the image, as scans' do."""
    camera = Camera(
        np.array([[500.0, 0, 159.5], [0, 500, 119.5], [0, 0, 1]]),
        look_at(np.array([0, -0.1, 1.0]), np.zeros(3)),
        320,
        240,
    )
    colors = np.array([[200, 30, 30], [30, 200, 30], [30, 30, 200], [200, 200, 30]])
    visuals = [_quad(tmp_path / str(i), color) for i, color in enumerate(colors)]
    with World(renderer) as world:
        bodies = world.add_visuals(visuals)
        world.move_all(
            bodies, [make_transform(np.eye(3), np.array([0.12 * i - 0.18, 0, 0])) for i in range(len(colors))]
        )
        rgb, _, ids = world.render(camera, Light(), supersample)
    for body, color in zip(bodies, colors, strict=True):
        seen = np.median(rgb[ids == body], axis=0)
        assert np.corrcoef(seen, color)[0, 1] > 0.99


def _quad(folder, color):
    folder.mkdir()
    cv2.imwrite(str(folder / "texture.png"), np.full((64, 64, 3), color[::-1], np.uint8))
    (folder / "textured.mtl").write_text("newmtl material_0\nKa 1 1 1\nKd 1 1 1\nmap_Kd texture.png\n")
    corners = [(-0.05, -0.05), (0.05, -0.05), (0.05, 0.05), (-0.05, 0.05)]
    lines = ["mtllib textured.mtl", "usemtl material_0", *(f"v {x} {y} 0" for x, y in corners)]
    lines += ["vt 0 0", "vt 1 0", "vt 1 1", "vt 0 1", "vn 0 0 1", "f 1/1/1 2/2/1 3/3/1", "f 1/1/1 3/3/1 4/4/1"]
    (folder / "textured.obj").write_text("\n".join(lines) + "\n")
    return folder / "textured.obj", folder / "texture.png"


@pytest.mark.parametrize("renderer", ["tiny", pytest.param("egl", marks=NO_EGL)])
def test_a_mesh_whose_material_names_a_picture_that_is_not_there_prints_nothing(renderer, tmp_path, capfd):
    (tmp_path / "mesh.mtl").write_text("newmtl one\nmap_Kd elsewhere.jpg\n")
    corners = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\n"
    (tmp_path / "mesh.obj").write_text(f"mtllib mesh.mtl\nusemtl one\n{corners}f 1/1 2/2 3/3\n")
    cv2.imwrite(str(tmp_path / "picture.png"), np.zeros((4, 4, 3), np.uint8))
    with World(renderer) as world:
        capfd.readouterr()
        world.add_visuals([(tmp_path / "mesh.obj", tmp_path / "picture.png")])
        assert capfd.readouterr() == ("", "")
