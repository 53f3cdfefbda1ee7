"""Every claim of a value's docstring is checked where the value is made."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from toolkit.errors import ToolkitError
from toolkit.geometry import invert, rotation_z
from toolkit.types import (
    Camera,
    Capture,
    Correspondences,
    Crop,
    Failure,
    Frame,
    Gripper,
    Matches,
    ObjectModel,
    PnPSolution,
    PoseEstimate,
    Refined,
    Region,
    Segment,
    TrueObject,
)

RGB = np.zeros((480, 640, 3), np.uint8)
DEPTH = np.full((480, 640), 0.8, np.float32)
SQUARE = np.zeros((8, 8), bool)
SQUARE[2:5, 3:6] = True
HALF_TURN = rotation_z(np.pi)


def refused(value, said, **changes):
    """Require that a valid value with these fields changed is refused, in one sentence that says this."""
    with pytest.raises(ToolkitError, match=said) as error:
        replace(value, **changes)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("K", "said"),
    [
        (np.array([[600.0, 2, 320], [0, 600, 240], [0, 0, 1]]), "not a pinhole"),
        (np.array([[-600.0, 0, 320], [0, 600, 240], [0, 0, 1]]), "not a pinhole"),
        (np.array([[np.nan, 0, 320], [0, 600, 240], [0, 0, 1]]), "cam_K must be finite"),
        (np.eye(4), "cam_K must be float64 3x3, got float64 4x4"),
    ],
)
def test_a_camera_refuses_what_is_no_pinhole(K, said):
    with pytest.raises(ToolkitError, match=said):
        Camera(K, np.eye(4), 640, 480)


def test_a_camera_is_rigid_in_metres_and_of_whole_pixels(camera):
    refused(camera, "not a rigid transform", T_world_camera=np.diag([1.0, 1, 2, 1]))
    refused(camera, "must be float64 4x4, got float64 3x4", T_world_camera=np.eye(4)[:3])
    refused(camera, "finite", T_world_camera=np.full((4, 4), np.nan))
    far = np.eye(4)
    far[:3, 3] = [120.0, -700.0, 600.0]  # millimetres
    refused(camera, "930 m from the world's origin; poses are in metres, so divide millimetres", T_world_camera=far)
    refused(camera, "whole pixels", width=640.5)
    refused(camera, "at least 1x1, got 640x0", height=0)
    assert replace(camera, width=np.int64(640)).width == 640


def test_a_gripper_has_size():
    with pytest.raises(ToolkitError, match="measures must be positive"):
        Gripper(0.08, (0.01, 0.0, 0.04), (0.1, 0.1, 0.1))


def test_a_frame_refuses_arrays_that_do_not_fit(camera):
    frame = Frame(0, RGB, camera, DEPTH, {7: np.zeros((480, 640), bool)})
    refused(frame, "rgb must be uint8 480x640x3, got uint8 100x640x3", rgb=RGB[:100])
    refused(frame, "rgb must be uint8 480x640x3, got float64", rgb=RGB / 255)
    refused(frame, "depth must be float32 480x640, got float32 2x2", depth=DEPTH[:2, :2])
    refused(frame, "finite", depth=np.full((480, 640), np.nan, np.float32))
    refused(frame, "negative", depth=-DEPTH)
    refused(frame, "mask of object 7 must be bool 480x640, got bool 2x2", true_masks={7: np.zeros((2, 2), bool)})
    refused(frame, "mask of object 7 must be bool 480x640, got uint8", true_masks={7: np.zeros((480, 640), np.uint8)})
    assert frame.depth.dtype == replace(frame, depth=DEPTH.astype(np.float64)).depth.dtype == np.float32


def test_depth_is_in_metres(camera):
    frame = Frame(3, RGB, camera, DEPTH)
    stored = np.full((480, 640), 800, np.uint16)
    refused(frame, "frame 3: depth must be float metres, got uint16; multiply .* by its depth scale", depth=stored)
    refused(frame, "must be in metres, but its median is 800; multiply", depth=stored.astype(np.float32))
    few = np.where(np.arange(640) < 8, 65.535, 0.0) * np.ones((480, 1))  # what some sensors write for no echo
    assert replace(frame, depth=few).depth.max() > 65


def test_values_cannot_be_written_to(camera):
    with pytest.raises(ValueError, match="read-only"):
        camera.K[0, 0] = 1
    with pytest.raises(ValueError, match="read-only"):
        Frame(0, RGB, camera).rgb[0, 0] = 1
    with pytest.raises(ValueError, match="read-only"):
        Frame(0, RGB, camera, true_masks={0: np.zeros((480, 640), bool)}).true_masks[0][0] = True
    with pytest.raises(ValueError, match="read-only"):
        ESTIMATE.equivalents[0] = 0


def test_a_segment_has_a_pixel_a_score_and_a_tight_box():
    segment = Segment(SQUARE)
    assert segment.bbox_xyxy == (3, 2, 5, 4)
    refused(segment, "empty", mask=np.zeros((8, 8), bool))
    refused(segment, "must be bool NxN, got uint8 8x8", mask=SQUARE.astype(np.uint8))
    refused(segment, "score must be in 0..1, got 1.5", score=1.5)
    refused(segment, "score must be in 0..1, got nan", score=float("nan"))


def test_a_crop_is_square_and_black_outside_its_mask():
    crop = Crop(
        np.where(SQUARE[..., None], np.uint8(9), np.uint8(0)) * np.ones((1, 1, 3), np.uint8), SQUARE, 2.0, np.ones(2)
    )
    np.testing.assert_array_equal(crop.to_image(np.array([[4.0, 6.0]])), [[3.0, 4.0]])
    refused(crop, "must be uint8 6x6x3, got uint8 6x8x3", image=crop.image[:6])
    refused(crop, "mask must be bool 8x8", mask=SQUARE[:6])
    refused(crop, "black outside", image=crop.image + np.uint8(1))
    refused(crop, "scale must be positive", scale=0.0)
    refused(crop, "origin_xy must be float64 2, got float64 3", origin_xy=np.ones(3))


def test_a_region_is_points_on_its_mask_in_order():
    rows, columns = np.nonzero(SQUARE)
    pixels = np.stack([columns, rows], axis=1).astype(np.int32)
    region = Region(
        0, Segment(SQUARE), np.arange(27, dtype=np.float32).reshape(9, 3), pixels, np.array([0.0, 0.6, 0.8])
    )
    np.testing.assert_array_equal(region.centroid, [12.0, 13.0, 14.0])
    assert replace(region, points=region.points.astype(np.float64)).points.dtype == np.float32
    refused(region, "at least one point", points=np.zeros((0, 3)), pixels=np.zeros((0, 2), np.int32))
    refused(region, "points must be float32 Nx3, got float64 9x2", points=np.zeros((9, 2)))
    refused(region, "finite", points=np.full((9, 3), np.inf))
    refused(region, "pixels must be int32 9x2, got float64 9x2", pixels=pixels.astype(np.float64))
    refused(region, "on its mask", pixels=pixels + np.int32(1))
    refused(region, "on its mask", pixels=pixels * np.int32(4))
    refused(region, "row-major", pixels=pixels[::-1])
    refused(region, "of length 1, got 2", observation=np.array([0.0, 0.0, 2.0]))
    refused(region, "must be float64 3", observation=np.ones(1))


def test_matches_and_correspondences_check_shapes_and_scores(camera):
    assert len(Matches.empty()) == 0
    matches = Matches(np.zeros((2, 2), np.int64), np.zeros((2, 2), np.float32), np.array([0.0, 1.0]))
    assert matches.query_xy.dtype == matches.reference_xy.dtype == matches.scores.dtype == np.float64
    refused(matches, "reference_xy must be float64 2x2, got float64 3x2", reference_xy=np.zeros((3, 2)))
    refused(matches, "query_xy must be finite", query_xy=np.full((2, 2), np.nan))
    refused(matches, "scores must be in 0..1", scores=np.array([0.5, 1.1]))
    problem = Correspondences(np.zeros((1, 3)), np.zeros((1, 2)), np.ones(1), camera)
    np.testing.assert_array_equal(problem.K, camera.K)
    refused(problem, "points must be finite", points=np.full((1, 3), np.inf))
    refused(problem, "pixels must be float64 1x2, got float64 2x2", pixels=np.zeros((2, 2)))
    refused(problem, "weights must be in 0..1", weights=-np.ones(1))
    refused(problem, "weights must be float64 1, got", weights=np.ones(2))


REFINED = Refined(np.eye(4), 0.9, np.stack([np.eye(4), HALF_TURN]), "symmetric", np.eye(6))


def test_a_refined_motion_is_the_first_of_its_equivalents():
    refused(REFINED, "not a rigid transform", T_goal_current=np.diag([1.0, 1, -1, 1]))
    refused(REFINED, "confidence must be in 0..1, got -0.1", confidence=-0.1)
    refused(REFINED, "must be float64 Nx4x4, got float64 4x4", equivalents=np.eye(4))
    refused(REFINED, "the first of the equivalents must be the motion itself", equivalents=REFINED.equivalents[::-1])
    refused(REFINED, "the first of the equivalents", equivalents=np.zeros((0, 4, 4)))
    refused(REFINED, "every equivalent must be a rigid", equivalents=np.stack([np.eye(4), 2 * np.eye(4)]))
    refused(REFINED, "one of none, symmetric, hidden, got maybe", ambiguity="maybe")
    refused(REFINED, "2 equivalents cannot have the ambiguity 'none'", ambiguity="none")
    refused(REFINED, "1 equivalents cannot have the ambiguity 'symmetric'", equivalents=np.eye(4)[None])


@pytest.mark.parametrize(
    ("covariance", "said"),
    [
        (np.eye(3), "must be float64 6x6, got float64 3x3"),
        (np.triu(np.ones((6, 6))), "symmetric"),
        (-np.eye(6), "variances from 0 up"),
        (np.full((6, 6), np.nan), "finite"),
    ],
)
def test_a_covariance_is_symmetric_with_variances_from_zero_up(covariance, said):
    for value in (REFINED, PnPSolution(np.eye(4), np.ones(3, bool), np.eye(6)), ESTIMATE):
        refused(value, said, covariance=covariance)


def test_a_pnp_solution_is_a_rigid_motion_with_a_flag_for_each_correspondence():
    solution = PnPSolution(np.eye(4), np.ones(3, bool))
    refused(solution, "not a rigid transform", T_camera_world=np.zeros((4, 4)))
    refused(solution, "inliers must be bool N, got int64 3", inliers=np.arange(3))


ESTIMATE = PoseEstimate(0, Segment(SQUARE), 1, np.eye(4), confidence=0.5, equivalents=np.eye(4)[None], ambiguity="none")


def test_what_is_held_fixed_in_an_estimate_is_so_in_every_world():
    T = rotation_z(0.7) @ HALF_TURN
    T[:3, 3] = [0.3, -2.0, 0.7]
    tilted = T.copy()
    tilted[:3, :3] = T[:3, :3] @ Rotation.from_rotvec([0.3, 0.2, 0.1]).as_matrix()
    fixed = replace(ESTIMATE, covariance=np.diag([0, 0, 1e-4, 1e-6, 1e-6, 0]))
    for there in (T, tilted):
        back = fixed.in_world(there).in_world(invert(there))
        np.testing.assert_allclose(back.covariance, fixed.covariance, atol=1e-15)
        np.testing.assert_allclose(back.T_goal_current, fixed.T_goal_current, atol=1e-12)


def test_an_estimate_is_a_motion_or_a_failure_and_never_both():
    failed = PoseEstimate(0, Segment(SQUARE), None, None, Failure("pnp", "too few"))
    assert failed.status == "failed" and ESTIMATE.status == "estimated"
    with pytest.raises(ToolkitError, match="moves nothing"):
        failed.move(np.zeros((1, 3)))
    refused(ESTIMATE, "motion or a failure", T_goal_current=None)
    refused(ESTIMATE, "motion or a failure", failure=Failure("pnp", "too few"))


def test_an_estimate_checks_what_it_says_of_itself(camera):
    refused(ESTIMATE, "not a rigid transform", T_goal_current=np.zeros((4, 4)))
    refused(ESTIMATE, "confidence must be in 0..1, got 1.2", confidence=1.2)
    refused(ESTIMATE, "the motion itself", equivalents=HALF_TURN[None])
    refused(ESTIMATE, "objects count from 0", instance=-1)
    refused(ESTIMATE, "objects count from 0", goal_object=-1)
    refused(ESTIMATE, "inliers are some of its correspondences", inliers=np.ones(2, bool))
    problem = Correspondences(np.zeros((3, 3)), np.zeros((3, 2)), np.ones(3), camera)
    refused(ESTIMATE, "inliers must be bool 3, got bool 2", correspondences=problem, inliers=np.ones(2, bool))


MODEL = ObjectModel(4, "mug", np.zeros(3), np.ones(3), 1.8, HALF_TURN[None], np.array([[0.0, 0, 1, 0, 0, 0]]))


def test_a_model_has_a_size_and_proper_symmetries():
    np.testing.assert_array_equal(MODEL.center, [0.5, 0.5, 0.5])
    refused(MODEL, "object 4: box_min must be float64 3", box_min=np.zeros(2))
    refused(MODEL, "object 4: box_size must be float64 3, got float64 1", box_size=np.ones(1))
    refused(MODEL, "object 4: box_size must not be negative", box_size=-np.ones(3))
    refused(MODEL, "object 4: diameter must be positive", diameter=0.0)
    refused(
        MODEL, "object 4: discrete_symmetries must be float64 Nx4x4, got float64 4x4", discrete_symmetries=HALF_TURN
    )
    refused(MODEL, "object 4: every discrete symmetry must be a rigid", discrete_symmetries=2 * np.eye(4)[None])
    refused(MODEL, "object 4: continuous_axes must be float64 Nx6", continuous_axes=np.zeros((1, 3)))
    refused(MODEL, "object 4: axes of symmetry must be of length 1", continuous_axes=np.zeros((1, 6)))


def test_a_true_object_has_a_rigid_pose_in_both_scenes():
    truth = TrueObject(MODEL, HALF_TURN, np.eye(4), 2)
    np.testing.assert_allclose(truth.T_goal_current, HALF_TURN, atol=1e-12)
    refused(truth, "T_world_goal of object 2 is not a rigid transform", T_world_goal=np.zeros((4, 4)))
    refused(truth, "T_world_current of object 2 must be float64 4x4", T_world_current=np.eye(3))


def test_a_capture_has_frames_with_depth_each_once(camera):
    capture = Capture(
        "mine", (Frame(0, RGB, camera, DEPTH), Frame(1, RGB, camera, DEPTH)), Frame(0, RGB, camera), None, ""
    )
    refused(capture, "mine: there is no current frame", current=())
    refused(capture, "mine: current frame 0 has no depth", current=(capture.goal,))
    refused(capture, "mine: two current frames have the same index", current=capture.current[:1] * 2)
