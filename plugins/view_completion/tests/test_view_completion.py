"""The kit's checks; a box seen from one side is completed, and nothing is put where a view sees through."""

import numpy as np
import pytest
from toolkit_view_completion import ViewCompletion, ViewCompletionConfig, complete, plausible

from toolkit.geometry import lift
from toolkit.perception.fusion import FusedModel, Patch
from toolkit.plugin_kit.conformance import Conforms
from toolkit.types import Camera, Frame

K = np.array([[300.0, 0, 159.5], [0, 300.0, 119.5], [0, 0, 1]])
BOX = [((-0.06, -0.04, 0.0), (0.06, 0.04, 0.1))]
ANGLE = [((-0.06, -0.04, 0.0), (0.06, -0.01, 0.1)), ((-0.06, -0.01, 0.0), (-0.03, 0.08, 0.1))]


class TestViewCompletion(Conforms):
    plugin = ViewCompletion


def looking(boxes):
    """What a camera in front of, and above, axis-aligned boxes on a table sees: the frame and the fused model."""
    eye, down = np.array([0.1, -0.5, 0.4]), np.array([0.0, 0.0, 1.0])
    forward = (np.array([0, 0, 0.04]) - eye) / np.linalg.norm(np.array([0, 0, 0.04]) - eye)
    right = np.cross(forward, down) / np.linalg.norm(np.cross(forward, down))
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = np.column_stack([right, np.cross(forward, right), forward]), eye
    x, y = np.meshgrid(np.arange(320), np.arange(240))
    rays = np.stack([(x - K[0, 2]) / K[0, 0], (y - K[1, 2]) / K[1, 1], np.ones_like(x, float)], axis=-1) @ T[:3, :3].T
    table = np.where(rays[..., 2] < 0, -eye[2] / np.minimum(rays[..., 2], -1e-9), np.inf)
    depth = table.copy()
    for low, high in boxes:
        a, b = (np.array(low) - eye) / rays, (np.array(high) - eye) / rays
        enter, leave = np.minimum(a, b).max(axis=-1), np.maximum(a, b).min(axis=-1)
        depth = np.where((enter < leave) & (enter < depth), enter, depth)
    mask = depth < table - 1e-6
    rgb = np.full((240, 320, 3), 128, np.uint8)
    frame = Frame(0, rgb, Camera(K, T, 320, 240), np.where(np.isfinite(depth), depth, 0).astype(np.float32))
    pixels = np.argwhere(mask)[:, ::-1].astype(np.int32)
    points = lift(K, T, pixels, depth[mask]).astype(np.float32)
    observation = (eye - points.mean(axis=0)) / np.linalg.norm(eye - points.mean(axis=0))
    patch = Patch(frame.rgb, mask, pixels, points, observation)
    return frame, FusedModel(
        points, np.full((len(points), 3), 128, np.float32), np.ones((len(points), 1), bool), (patch,)
    )


def test_a_box_gets_the_sides_that_were_not_seen():
    frame, model = looking(BOX)
    completed = complete(model, (frame,), ViewCompletionConfig())
    back = _back(completed)
    assert back.sum() > 100
    assert not _back(model).any()
    assert (completed.points.min(axis=0) > [-0.07, -0.05, -0.01]).all()
    assert (completed.points.max(axis=0) < [0.07, 0.05, 0.11]).all()
    assert len(completed.patches) > 1 and completed.seen_by.shape == (len(completed.points), len(completed.patches))


def test_nothing_is_put_where_a_view_sees_through():
    frame, model = looking(ANGLE)
    completed = complete(model, (frame,), ViewCompletionConfig())
    corner = (completed.points[:, 0] > 0) & (completed.points[:, 1] > 0.02) & (completed.points[:, 2] > 0.05)
    assert not corner.any()


@pytest.mark.parametrize(("shift", "expected"), [((0, 0, 0), 1.0), ((0, -0.05, 0.0), 0.0), ((0.15, 0, 0), 0.0)])
def test_what_a_view_contradicts_is_counted(shift, expected):
    frame, model = looking(BOX)
    share = plausible(model.points + np.array(shift, np.float32), model.patches, (frame,), 0.008)
    assert abs(share - expected) < 0.35


def _back(model):
    """The points on the side of the box that the camera does not see, away from its edges."""
    x, y, z = model.points.T
    return (np.abs(y - 0.04) < 0.005) & (np.abs(x) < 0.05) & (z < 0.08)
