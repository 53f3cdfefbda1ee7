"""The table that all frames share, and the objects that all frames together see on it, on ray-cast boxes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from toolkit.errors import ToolkitError
from toolkit.geometry import make_transform, transform_points
from toolkit.perception.tabletop.joining import Pieces, borders, join_pieces
from toolkit.perception.tabletop.pieces import cut_pieces, objects_on_table
from toolkit.perception.tabletop.plane import fit_near, pixel_rays
from toolkit.perception.tabletop.relief import relief, surfaces
from toolkit.perception.tabletop.table import find_table
from toolkit.plugin_kit.conformance.raycast import HALF_TABLE, HEIGHT, NOW, WIDTH, Box, camera, shoot
from toolkit.types import Float, Frame

UP = np.array([0.0, 0.0, 1.0])


def ring(boxes: Sequence[Box], noise: float = 0.0, count: int = 5) -> list[Frame]:
    return [shoot(i, camera(-90 + 360 / count * i), boxes, noise) for i in range(count)]


def in_world(frames: Sequence[Frame], T: Float) -> list[Frame]:
    """The same frames, with poses in a world that is moved by T."""
    return [replace(f, camera=replace(f.camera, T_world_camera=T @ f.camera.T_world_camera)) for f in frames]


def floored(frame: Frame) -> Frame:
    """The frame with a floor 70 cm below the table, all around it and far larger."""
    assert frame.depth is not None
    T = frame.camera.T_world_camera
    rays = pixel_rays(frame).astype(np.float64) @ T[:3, :3].T
    depth = np.where(rays[..., 2] < -0.05, (-0.7 - T[2, 3]) / np.minimum(rays[..., 2], -0.05), 0)
    return replace(frame, depth=np.where(frame.depth > 0, frame.depth, depth).astype(np.float32))


@settings(max_examples=20, deadline=None)
@given(st.floats(-180, 180), st.floats(0.0, 0.004), st.integers(0, 2**32 - 1))
def test_the_table_is_found_in_any_world(azimuth: float, noise: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    T = make_transform(Rotation.random(random_state=rng).as_matrix(), rng.uniform(-2, 2, 3))
    table = find_table(in_world([shoot(i, camera(azimuth + 70 * i), NOW, noise) for i in range(3)], T))
    assert np.degrees(np.arccos(min(float(table.T_world_table[:3, 2] @ T[:3, :3] @ UP), 1.0))) < 0.5
    corner = transform_points(np.linalg.inv(table.T_world_table), transform_points(T, np.array([0.1, 0.2, 0.05])))
    assert abs(corner[2] - 0.05) < 3e-3


def test_a_buffer_that_is_filled_again_is_another_picture() -> None:
    frames = ring(NOW)
    buffers = [np.array(frame.depth) for frame in frames]
    views = [replace(frame, depth=buffer) for frame, buffer in zip(frames, buffers, strict=True)]
    first = find_table(views)
    for buffer in buffers:
        buffer *= 1.2
    second = find_table([replace(view) for view in views])
    assert np.linalg.norm(second.T_world_table[:3, 3] - first.T_world_table[:3, 3]) > 0.05


def test_a_larger_floor_is_not_the_table() -> None:
    table = find_table([floored(frame) for frame in ring(NOW)])
    assert abs(table.T_world_table[2, 3]) < 3e-3
    inside = transform_points(np.linalg.inv(table.T_world_table), np.array([[0.4, 0.4, 0.0], [0.7, 0.0, 0.0]]))
    assert table.holds(inside[:, :2]).tolist() == [True, False]
    extent = np.ptp(table.outline @ table.T_world_table[:2, :2].T, axis=0)
    assert (np.abs(extent - 2 * HALF_TABLE) < 0.05).all()


def test_every_frame_has_its_own_version_of_the_table() -> None:
    frames = ring(NOW)
    raised = make_transform(np.eye(3), 0.006 * UP) @ frames[0].camera.T_world_camera
    frames[0] = replace(frames[0], camera=replace(frames[0].camera, T_world_camera=raised))
    own = fit_near(frames[0], find_table(frames).T_world_table, 0.012)
    assert own is not None and abs(own.camera_height - 0.75) < 1e-3


def test_depth_in_one_column_alone_breaks_no_fit() -> None:
    frame = ring(NOW)[0]
    assert frame.depth is not None
    column = np.zeros((HEIGHT, WIDTH), np.float32)
    column[:, WIDTH // 2] = frame.depth[:, WIDTH // 2]
    narrow = replace(frame, depth=column)
    plane = fit_near(narrow, np.eye(4), 0.012)
    assert plane is None or np.isfinite(plane.coefficients).all()


def test_depth_without_a_table_is_a_users_mistake() -> None:
    frames = ring(NOW)
    blind = [replace(frame, depth=np.zeros((HEIGHT, WIDTH), np.float32)) for frame in frames]
    with pytest.raises(ToolkitError, match="pixels"):
        find_table(blind)
    rng = np.random.default_rng(0)
    fog = [replace(f, depth=rng.uniform(0.5, 2, (HEIGHT, WIDTH)).astype(np.float32)) for f in frames]
    with pytest.raises(ToolkitError, match="plane"):
        find_table(fog)
    with pytest.raises(ToolkitError, match="none"):
        find_table([])


def test_flying_pixels_lie_on_no_surface() -> None:
    depth = np.full((40, 40), 1.0, np.float32)
    depth[:, 20:] = 0.8
    depth[10, 19] = 0.9
    solid = surfaces(depth, noise=1e-4)
    assert not solid[10, 19]
    assert solid[20, 5] and solid[20, 30]


@pytest.mark.parametrize("noise", [0.0, 0.002])
@pytest.mark.parametrize("count", [1, 5])
def test_objects_have_one_number_in_all_frames(noise: float, count: int) -> None:
    frames = ring(NOW, noise, count)
    found = objects_on_table(frames, 0.0015, 60)
    numbers: dict[int, set[int]] = {}
    for frame in frames:
        labels = found.labels[frame.index]
        for k, mask in (frame.true_masks or {}).items():
            values, pixels = np.unique(labels[mask], return_counts=True)
            numbers.setdefault(k, set()).add(int(values[pixels.argmax()]))
            covered = labels == values[pixels.argmax()]
            assert (covered & mask).sum() / (covered | mask).sum() > (0.6 if noise else 0.85)
    assert sorted(map(sorted, numbers.values())) == [[1], [2], [3]]
    assert len(found.whole) >= 3 and (found.whole[:3] > 0.9).all()


def test_boxes_that_touch_are_two() -> None:
    touching: list[Box] = [((-0.06, 0, 0), (0.12, 0.12, 0.12)), ((0.035, 0, 0), (0.07, 0.08, 0.05))]
    frames = ring(touching)
    labels = objects_on_table(frames, 0.0015, 60).labels
    for frame in frames:
        assert frame.true_masks is not None
        most = [int(np.bincount(labels[frame.index][m]).argmax()) for m in frame.true_masks.values()]
        assert len(set(most)) == len(frame.true_masks)


def test_what_hangs_above_the_table_belongs_to_what_carries_it() -> None:
    tree: list[Box] = [((0, 0, 0), (0.06, 0.06, 0.1)), ((0, 0, 0.112), (0.16, 0.16, 0.02))]
    frames = ring(tree)
    labels = objects_on_table(frames, 0.0015, 60).labels
    assert {int(k) for frame in frames for k in np.unique(labels[frame.index])} == {0, 1}
    alone: list[Box] = [((0, 0, 0.2), (0.16, 0.16, 0.02)), ((0.3, 0.3, 0), (0.06, 0.06, 0.06))]
    frames = ring(alone)
    labels = objects_on_table(frames, 0.0015, 60).labels
    assert {int(k) for frame in frames for k in np.unique(labels[frame.index])} == {0, 1}


def test_what_one_thing_carries_is_no_part_of_another_that_it_touches() -> None:
    carried: list[Box] = [((0, 0, 0), (0.06, 0.06, 0.1)), ((0, 0, 0.1), (0.16, 0.16, 0.02))]
    beside: Box = ((0.125, 0, 0), (0.09, 0.12, 0.16))
    frames = ring([*carried, beside])
    labels = objects_on_table(frames, 0.0015, 60).labels
    own: dict[int, set[int]] = {}
    for frame in frames:
        for k, mask in (frame.true_masks or {}).items():
            own.setdefault(k, set()).add(int(np.bincount(labels[frame.index][mask]).argmax()))
    assert not own[3] & (own[1] | own[2])


def test_the_table_beside_an_object_is_no_part_of_it() -> None:
    frames = ring(NOW)
    table = find_table(frames)
    for frame, plane in table.seen():
        things = relief(frame, plane, table, 0.0015).things
        true = np.any(list((frame.true_masks or {}).values()), axis=0)
        assert (things & ~true).sum() < 0.01 * true.sum()


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_joining_does_not_depend_on_the_order_of_pieces(seed: int) -> None:
    pieces = made_pieces()
    count = int(pieces.of_voxel.max()) + 1
    order = np.random.default_rng(seed).permutation(count)
    other = replace(pieces, of_voxel=np.where(pieces.of_voxel >= 0, order[pieces.of_voxel], -1))
    a, b = join_pieces(pieces)[0], join_pieces(other)[0]
    assert len(np.unique(np.stack([a, b]), axis=1).T) == len(np.unique(a)) == len(np.unique(b))


def test_borders_say_how_pieces_meet() -> None:
    pieces = made_pieces()
    for (i, j), (length, features) in borders(pieces).items():
        assert i < j and length > 0
        assert features.shape == (5,)
        assert 0 <= features[1] <= 1 and 0 <= features[2] <= 1 and features[3] > 0 and features[4] in (0, 1)


def made_pieces() -> Pieces:
    """Of a box on a box, and one beside them."""
    stack: list[Box] = [((0, 0, 0), (0.12, 0.12, 0.08)), ((0.02, 0.01, 0.08), (0.06, 0.06, 0.06)), NOW[0]]
    frames = ring(stack)
    table = find_table(frames)
    return cut_pieces([relief(frame, plane, table, 0.0015) for frame, plane in table.seen()], table)[1]
