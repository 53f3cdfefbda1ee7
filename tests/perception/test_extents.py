"""Boxes and outlines of objects, in worlds that lie as they like."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from toolkit.geometry import invert, make_transform, rotation_z, transform_points
from toolkit.perception.extents import measure_extent

CORNERS = np.stack(np.meshgrid([-0.5, 0.5], [-0.5, 0.5], [-0.5, 0.5]), axis=-1).reshape(-1, 3)


@given(
    size=st.tuples(*[st.floats(0.01, 0.5)] * 3),
    yaw=st.floats(-np.pi, np.pi),
    place=st.tuples(*[st.floats(-1, 1)] * 3),
    turn=st.tuples(*[st.floats(-np.pi, np.pi)] * 3),
)
def test_a_box_is_measured_as_it_is(size, yaw, place, turn):
    T_level_box = make_transform(rotation_z(yaw)[:3, :3], np.array(place))
    T_world_level = make_transform(Rotation.from_euler("xyz", turn).as_matrix(), np.array([3.0, -1, 2]))
    inside = np.random.default_rng(0).uniform(-0.5, 0.5, (40, 3))
    points = transform_points(T_world_level @ T_level_box, np.concatenate([CORNERS, inside]) * size)
    extent = measure_extent(points, T_world_level)
    np.testing.assert_allclose(extent.T_world_box[:3, 3], (T_world_level @ T_level_box)[:3, 3], atol=1e-5)
    np.testing.assert_allclose(extent.T_world_box[:3, 2], T_world_level[:3, 2], atol=1e-12)
    np.testing.assert_allclose(sorted(extent.size[:2]), sorted(size[:2]), rtol=1e-3, atol=1e-5)
    assert extent.size[2] == pytest.approx(size[2], abs=1e-9)
    inside_box = np.abs(transform_points(invert(extent.T_world_box), points)) <= extent.size / 2 + 1e-4
    assert inside_box.all()
    outline = transform_points(invert(T_world_level), extent.footprint)
    np.testing.assert_allclose(outline[:, 2], place[2] - size[2] / 2, atol=1e-9)
    x, y = outline[:, 0], outline[:, 1]
    area = (x * np.roll(y, -1) - np.roll(x, -1) * y).sum() / 2
    assert area == pytest.approx(size[0] * size[1], rel=1e-2, abs=1e-6)


@pytest.mark.parametrize("count", [1, 2])
def test_an_object_of_one_or_two_points_has_a_box_too(count):
    points = np.array([[0.1, 0.2, 0.3], [0.2, 0.2, 0.3]])[:count]
    extent = measure_extent(points, np.eye(4))
    np.testing.assert_allclose(extent.T_world_box[:3, 3], points.mean(axis=0), atol=1e-7)
    assert sorted(extent.size) == pytest.approx([0, 0, 0.1 * (count - 1)], abs=1e-7) and len(extent.footprint) == count
