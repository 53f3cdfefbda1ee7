from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from toolkit.geometry import (
    invert,
    is_rigid,
    lift,
    look_at,
    make_transform,
    observation_vector,
    orthonormalize,
    project,
    rotation_angle,
    rotation_z,
    transform_points,
)

numbers = st.floats(-2, 2, allow_nan=False)
vectors = st.tuples(numbers, numbers, numbers).map(np.array)
transforms = st.builds(lambda r, t: make_transform(Rotation.from_rotvec(r).as_matrix(), t), vectors, vectors)
K = np.array([[600.0, 0, 320], [0, 610.0, 240], [0, 0, 1]])


@given(transforms)
def test_inverse_undoes_a_transform(T):
    assert is_rigid(T)
    np.testing.assert_allclose(T @ invert(T), np.eye(4), atol=1e-12)


@given(transforms, transforms, vectors)
def test_transforms_compose(A, B, point):
    np.testing.assert_allclose(
        transform_points(A @ B, point), transform_points(A, transform_points(B, point)), atol=1e-9
    )


@given(st.floats(0, np.pi))
def test_rotation_angle_is_exact_from_zero_to_pi(angle):
    assert rotation_angle(rotation_z(angle)[:3, :3]) == pytest.approx(angle, abs=1e-9)


@given(vectors, st.floats(0.2, 3), st.floats(0, 639), st.floats(0, 479))
def test_projection_undoes_lifting(eye, depth, u, v):
    if np.hypot(*eye[:2]) < 0.05:
        return
    T = look_at(eye, eye - [eye[0], eye[1], 0.3])
    point = lift(K, T, np.array([[u, v]]), np.array([depth]))
    pixel, z = project(K, invert(T), point)
    np.testing.assert_allclose(pixel, [[u, v]], atol=1e-6)
    np.testing.assert_allclose(z, [depth], atol=1e-9)


def test_points_behind_the_camera_have_no_pixel():
    pixels, depth = project(K, np.eye(4), np.array([[0.0, 0, -1], [0, 0, 1]]))
    assert np.isnan(pixels[0]).all() and depth[0] == -1
    np.testing.assert_allclose(pixels[1], [320, 240])


def test_look_at_puts_the_target_on_the_optical_axis_and_the_sky_up():
    T = look_at(np.array([0.0, -1, 1]), np.zeros(3))
    pixels, _ = project(K, invert(T), np.array([[0, 0, 0], [0, 0, 0.1]]))
    np.testing.assert_allclose(pixels[0], [320, 240])
    assert pixels[1, 1] < 240
    with pytest.raises(ValueError, match="parallel"):
        look_at(np.array([0.0, 0, 1]), np.zeros(3))


@given(transforms, st.floats(-1e-4, 1e-4))
def test_orthonormalize_returns_the_nearest_rigid_transform(T, noise):
    assert is_rigid(orthonormalize(T + noise * np.array([[1, -1, 1, 0], [1, 1, 0, 0], [0, 1, 1, 0], [0, 0, 0, 0]])))


@pytest.mark.parametrize(
    "broken", [np.full((4, 4), np.nan), np.diag([1.0, 1, -1, 1]), np.diag([2.0, 1, 1, 1]), np.eye(3)]
)
def test_what_is_not_rigid_is_said_to_be_so(broken):
    assert not is_rigid(broken)


def test_observation_vector_points_from_the_cloud_to_the_camera():
    T = look_at(np.array([0.0, -2, 0.0]), np.zeros(3))
    np.testing.assert_allclose(observation_vector(T, np.array([[0.0, 0, 0.1], [0, 0, -0.1]])), [0, -1, 0], atol=1e-12)
