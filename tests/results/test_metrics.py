from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from toolkit.geometry import invert, make_transform, rotation_z
from toolkit.results.metrics import assign_goal_objects, pose_error
from toolkit.types import ObjectModel, Segment, TrueObject

CENTER = np.array([0.05, -0.02, 0.04])
angles = st.floats(-np.pi, np.pi)
offsets = st.tuples(*[st.floats(-0.5, 0.5)] * 3).map(np.array)
poses = st.builds(
    lambda r, t: make_transform(Rotation.from_rotvec(r).as_matrix(), t), offsets.map(lambda v: 4 * v), offsets
)


def about_center(R):
    return make_transform(R, CENTER - R @ CENTER)


def model(kind="none"):
    half = about_center(rotation_z(np.pi)[:3, :3])
    return ObjectModel(
        1,
        "thing",
        CENTER - 0.03,
        np.full(3, 0.06),
        0.1,
        half[None] if kind == "discrete" else np.zeros((0, 4, 4)),
        np.array([[0, 0, 1, *CENTER]]) if kind == "continuous" else np.zeros((0, 6)),
    )


@given(poses, poses, st.sampled_from(["none", "discrete", "continuous"]))
def test_truth_scores_exactly_zero(current, goal, kind):
    truth = TrueObject(model(kind), current, goal, 0)
    error = pose_error(truth.T_goal_current, truth)
    assert (error.rotation_error_deg, error.translation_error_cm) == (0.0, 0.0)
    assert (error.rotation_error_deg_sym, error.translation_error_cm_sym) == (0.0, 0.0)
    assert error.success and error.success_sym


@given(poses, poses, st.floats(0, np.pi), st.floats(-0.2, 0.2))
def test_errors_are_the_angle_and_the_shift_of_the_box_centre(current, goal, angle, shift):
    truth = TrueObject(model(), current, goal, 0)
    wrong = goal @ make_transform(np.eye(3), np.array([shift, 0, 0])) @ about_center(rotation_z(angle)[:3, :3])
    error = pose_error(wrong @ invert(current), truth)
    assert error.rotation_error_deg == pytest.approx(np.degrees(angle), abs=1e-5)
    assert error.translation_error_cm == pytest.approx(100 * abs(shift), abs=1e-6)


@given(poses, poses, angles)
def test_a_turn_about_a_continuous_axis_costs_nothing(current, goal, angle):
    truth = TrueObject(model("continuous"), current, goal, 0)
    turned = goal @ about_center(rotation_z(angle)[:3, :3]) @ invert(current)
    error = pose_error(turned, truth)
    assert error.rotation_error_deg_sym == pytest.approx(0, abs=1e-5)
    assert error.translation_error_cm_sym == pytest.approx(0, abs=1e-6)
    assert error.rotation_error_deg == pytest.approx(np.degrees(abs(angle)), abs=1e-5)


def test_a_tilt_of_a_continuous_object_still_counts():
    truth = TrueObject(model("continuous"), np.eye(4), np.eye(4), 0)
    tilt = about_center(Rotation.from_euler("x", 30, degrees=True).as_matrix() @ rotation_z(1.0)[:3, :3])
    assert pose_error(tilt, truth).rotation_error_deg_sym == pytest.approx(30, abs=1e-6)


def test_a_half_turn_costs_nothing_only_where_the_model_says_so():
    half = about_center(rotation_z(np.pi)[:3, :3])
    for kind, expected in (("discrete", 0.0), ("none", 180.0)):
        error = pose_error(half, TrueObject(model(kind), np.eye(4), np.eye(4), 0))
        assert error.rotation_error_deg_sym == pytest.approx(expected, abs=1e-6)


def test_segments_answer_for_the_object_they_cover():
    masks = {3: np.zeros((20, 20), bool), 5: np.zeros((20, 20), bool), 8: np.zeros((20, 20), bool)}
    masks[3][:10, :10] = masks[5][10:, 10:] = masks[8][:5, 15:] = True
    shifted = np.roll(masks[5], 1, axis=0)
    segments = [Segment(shifted), Segment(masks[3])]
    assert assign_goal_objects(segments, masks) == {3: 1, 5: 0}
    assert assign_goal_objects([], masks) == assign_goal_objects(segments, {}) == {}
