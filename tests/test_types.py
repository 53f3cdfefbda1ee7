from __future__ import annotations

import numpy as np
import pytest

from toolkit.errors import ToolkitError
from toolkit.types import Camera, Correspondences, Failure, Frame, Gripper, Matches, PoseEstimate, Segment

RGB = np.zeros((480, 640, 3), np.uint8)


@pytest.mark.parametrize(
    ("K", "said"),
    [
        (np.array([[600.0, 2, 320], [0, 600, 240], [0, 0, 1]]), "not a pinhole"),
        (np.array([[-600.0, 0, 320], [0, 600, 240], [0, 0, 1]]), "not a pinhole"),
        (np.array([[np.nan, 0, 320], [0, 600, 240], [0, 0, 1]]), "not a pinhole"),
        (np.eye(4), "3x3"),
    ],
)
def test_a_camera_refuses_what_is_no_pinhole(K, said):
    with pytest.raises(ToolkitError, match=said):
        Camera(K, np.eye(4), 640, 480)


def test_a_camera_refuses_a_pose_that_is_not_rigid(camera):
    with pytest.raises(ToolkitError, match="not a rigid transform"):
        Camera(camera.K, np.diag([1.0, 1, 2, 1]), 640, 480)


def test_a_gripper_has_size():
    with pytest.raises(ToolkitError, match="measures must be positive"):
        Gripper(0.08, (0.01, 0.0, 0.04), (0.1, 0.1, 0.1))


def test_a_frame_refuses_arrays_that_do_not_fit(camera):
    with pytest.raises(ToolkitError, match="rgb must be uint8"):
        Frame(0, RGB[:100], camera)
    with pytest.raises(ToolkitError, match="depth must be"):
        Frame(0, RGB, camera, np.zeros((2, 2), np.float32))
    with pytest.raises(ToolkitError, match="finite"):
        Frame(0, RGB, camera, np.full((480, 640), np.nan, np.float32))
    with pytest.raises(ToolkitError, match="mask of object 7"):
        Frame(0, RGB, camera, true_masks={7: np.zeros((2, 2), bool)})


def test_values_cannot_be_written_to(camera):
    with pytest.raises(ValueError, match="read-only"):
        camera.K[0, 0] = 1
    with pytest.raises(ValueError, match="read-only"):
        Frame(0, RGB, camera).rgb[0, 0] = 1


def test_a_segment_has_a_pixel_and_a_tight_box():
    mask = np.zeros((10, 20), bool)
    with pytest.raises(ToolkitError, match="empty"):
        Segment(mask)
    mask[2:5, 7:11] = True
    assert Segment(mask).bbox_xyxy == (7, 2, 10, 4)


def test_matches_and_correspondences_check_their_shapes(camera):
    assert len(Matches.empty()) == 0
    with pytest.raises(ToolkitError, match="reference_xy"):
        Matches(np.zeros((2, 2)), np.zeros((3, 2)), np.zeros(2))
    with pytest.raises(ToolkitError, match="finite"):
        Correspondences(np.full((1, 3), np.inf), np.zeros((1, 2)), np.ones(1), camera)


def test_an_estimate_is_a_motion_or_a_failure_and_never_both():
    segment = Segment(np.ones((2, 2), bool))
    failed = PoseEstimate(0, segment, None, None, Failure("pnp", "too few"))
    assert failed.status == "failed"
    with pytest.raises(ToolkitError, match="moves nothing"):
        failed.move(np.zeros((1, 3)))
    with pytest.raises(ToolkitError, match="motion or a failure"):
        PoseEstimate(0, segment, None, None)
    with pytest.raises(ToolkitError, match="motion or a failure"):
        PoseEstimate(0, segment, 1, np.eye(4), Failure("pnp", "too few"))
