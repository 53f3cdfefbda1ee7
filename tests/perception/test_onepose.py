"""Landmarks of a fused model against a surface that is known, and the motion they give."""

from __future__ import annotations

import numpy as np
import pytest

from toolkit.errors import ToolkitError
from toolkit.geometry import invert, look_at, make_transform, project, rotation_angle, rotation_z, transform_points
from toolkit.perception.fusion import Patch
from toolkit.perception.refiners.landmarks.exactness import chance, covariance
from toolkit.perception.refiners.landmarks.landmarks import Landmarks, find, gather, on_surface
from toolkit.perception.rootsift import SiftFeatures
from toolkit.plugin_kit.conformance.scene import refine_task, true_motion
from toolkit.stages import REFINERS
from toolkit.types import Camera, Correspondences, Crop, Failure, Refined


def slanted(shape=(40, 50)) -> Patch:
    """A view of the plane x = 0.001 u, y = 0.001 v, z = 0.0005 u, of which the left half is the object."""
    mask = np.zeros(shape, bool)
    mask[:, : shape[1] // 2] = True
    y, x = np.nonzero(mask)
    pixels = np.stack([x, y], axis=1).astype(np.int32)
    points = np.stack([0.001 * x, 0.001 * y, 0.0005 * x], axis=1).astype(np.float32)
    return Patch(np.zeros((*shape, 3), np.uint8), mask, pixels, points, np.array([0.0, 0, 1]))


def unit(rows: np.ndarray) -> np.ndarray:
    return (rows / np.linalg.norm(rows, axis=1, keepdims=True)).astype(np.float32)


def whole(patch: Patch) -> Crop:
    side = max(patch.mask.shape)
    return Crop(np.zeros((side, side, 3), np.uint8), np.zeros((side, side), bool), 1.0, np.zeros(2))


def test_positions_between_pixels_lie_on_the_surface_and_the_rest_is_dropped():
    xy = np.array([[3.25, 7.5], [10.0, 20.0], [24.5, 5.0], [40.0, 5.0], [3.0, 39.5]])
    points, kept = on_surface(slanted(), xy)
    assert kept.tolist() == [True, True, False, False, False]
    expected = np.stack([0.001 * xy[:, 0], 0.001 * xy[:, 1], 0.0005 * xy[:, 0]], axis=1)
    np.testing.assert_allclose(points[kept], expected[kept], atol=1e-7)


def test_views_of_one_point_become_one_landmark_with_their_mean_descriptor():
    rng = np.random.default_rng(0)
    base = unit(np.abs(rng.normal(size=(3, 128))))
    there = np.array([[5.0, 5.0], [15.0, 5.0], [5.0, 30.0]])
    again = unit(base + 0.02 * rng.normal(size=base.shape))
    again[2] = unit(rng.normal(size=(1, 128)))[0]  # seen quite otherwise: a landmark of its own
    patch = slanted()
    crops, features = [whole(patch)] * 2, [SiftFeatures(there, base), SiftFeatures(there + 0.5, again)]
    found = gather([patch, patch], crops, features)
    assert len(found.points) == 4
    np.testing.assert_allclose(np.linalg.norm(found.descriptors, axis=1), 1, atol=1e-6)
    for k in range(2):
        row = int((found.descriptors @ base[k]).argmax())
        np.testing.assert_allclose(found.descriptors[row], unit((base[[k]] + again[[k]]) / 2)[0], atol=1e-5)
        np.testing.assert_allclose(found.points[row][:2], 0.001 * (there[k] + 0.25), atol=1e-6)


def test_the_ratio_test_asks_other_places_only():
    """Two landmarks alike at one place do not hide each other; at two places they do."""
    rng = np.random.default_rng(1)
    descriptors = unit(rng.normal(size=(3, 128)))
    descriptors[1] = unit(descriptors[[0]] + 0.01 * rng.normal(size=(1, 128)))[0]
    near = Landmarks(np.array([[0, 0, 0], [0.002, 0, 0], [0.1, 0, 0]]), descriptors)
    far = Landmarks(np.array([[0, 0, 0], [0.05, 0, 0], [0.1, 0, 0]]), descriptors)
    query = unit(descriptors[[0]] + 0.02 * rng.normal(size=(1, 128)))
    assert len(find(near, query, 0.8)[0]) == 1
    assert len(find(far, query, 0.8)[0]) == 0
    assert len(find(Landmarks(np.zeros((0, 3)), np.zeros((0, 128), np.float32)), query, 0.8)[0]) == 0


def test_the_covariance_is_that_of_least_squares():
    """Against derivatives taken by finite differences."""
    rng = np.random.default_rng(2)
    K = np.array([[600.0, 0, 320], [0, 600, 240], [0, 0, 1]])
    camera = Camera(K, look_at(np.array([0.6, 0.0, 0.6]), np.zeros(3)), 640, 480)
    center, T = np.array([0.1, 0.2, 0.05]), make_transform(rotation_z(0.7)[:3, :3], np.array([-0.1, -0.15, 0.0]))
    points = center + rng.uniform(-0.04, 0.04, (60, 3))
    moved = transform_points(T, points)
    exact = project(K, invert(camera.T_world_camera), moved)[0]
    slopes = []
    for k in range(6):
        step = 1e-6 * np.eye(6)[k]
        nudged = moved + np.cross(step[:3], moved - transform_points(T, center)) + step[3:]
        slopes.append((project(K, invert(camera.T_world_camera), nudged)[0] - exact).ravel() / 1e-6)
    J = np.stack(slopes, axis=1)
    noise = rng.normal(0, 1.0, exact.shape)
    problem = Correspondences(points, exact + noise, np.ones(60), camera)
    stated = covariance(problem, T, np.ones(60, bool), center)
    np.testing.assert_allclose(stated, (noise**2).mean() * np.linalg.inv(J.T @ J), rtol=1e-3)


def test_the_chance_falls_with_the_spread():
    tight, loose = np.diag([1e-6] * 6), np.diag([1e-1] * 3 + [1e-2] * 3)
    assert chance(tight) == pytest.approx(1.0)
    assert chance(loose) < 0.1


@pytest.mark.parametrize("object_id", [1, 3])
def test_it_finds_the_motion_without_a_start(object_id):
    task = refine_task(object_id)
    refiner = REFINERS.create("onepose")
    answer = refiner.refine(task)
    assert isinstance(answer, Refined)
    off = answer.T_goal_current @ invert(true_motion(object_id))
    assert np.degrees(rotation_angle(off[:3, :3])) < 5
    assert answer.confidence > 0.5
    assert refiner.verify(task) >= 8


def test_what_does_not_match_is_a_failure_with_a_reason():
    answer = REFINERS.create("onepose", {"ratio": 0.01}).refine(refine_task(1))
    assert isinstance(answer, Failure) and "matched with the fused model: too few correspondences" in answer.reason


def test_its_solver_is_chosen_as_any_other():
    assert (
        REFINERS.create("onepose", {"pnp": {"name": "opencv_sqpnp", "min_inliers": 5}}).config.pnp.settings[
            "min_inliers"
        ]
        == 5
    )
    with pytest.raises(ToolkitError, match="poselib"):
        REFINERS.create("onepose", {"pnp": "poseleb"})
