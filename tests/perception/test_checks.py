"""A capture is checked before it is believed: what people bring, a kind each, and nothing said of what is right."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from toolkit.errors import ToolkitError
from toolkit.geometry import invert, make_transform
from toolkit.perception.checks.capture import (
    check_capture,
    check_current,
    check_goal,
    doubted,
    refuse,
    together,
    usable,
)
from toolkit.plugin_kit.conformance.raycast import NOW, THEN, K, camera, shoot
from toolkit.types import Capture, Failure, Finding, Frame, PoseEstimate, Segment

VIEWS = 8
FLIP = np.diag([1.0, -1.0, -1.0, 1.0])
BODY = np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
"""From ROS's axes of a body into those of a camera: forward is z, left -x, up -y."""

Y_UP = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
"""From a world with z up into one with y up."""


@lru_cache
def frames():
    return tuple(shoot(i, camera(-90 + 360 / VIEWS * i), NOW, print_contrast=0.9) for i in range(VIEWS))


@lru_cache
def goal():
    return shoot(0, camera(-80), THEN, depth=False, print_contrast=0.9)


def posed(frame, undo):
    return replace(frame, camera=replace(frame.camera, T_world_camera=undo(frame.camera.T_world_camera)))


def scaled(factor):
    def undo(T):
        return make_transform(T[:3, :3], factor * T[:3, 3])

    return undo


def transposed(T):
    V = invert(T)
    return invert(make_transform(V[:3, :3].T, V[:3, 3]))


def only(findings):
    (finding,) = findings
    return finding


def test_nothing_is_said_of_what_is_right():
    assert check_current(frames()) == []
    assert check_goal(goal(), frames()) == []


@pytest.mark.parametrize("noise", [0.002, 0.005])
def test_noise_and_poses_millimetres_off_are_no_finding(noise):
    rng = np.random.default_rng(3)

    def shaken(T):
        turn = Rotation.from_rotvec(rng.normal(0, np.radians(0.2), 3)).as_matrix()
        return T @ make_transform(turn, rng.normal(0, 0.002, 3))

    noisy = [shoot(i, camera(-90 + 45 * i), NOW, noise=noise, print_contrast=0.9) for i in range(VIEWS)]
    shaky = [posed(frame, shaken) for frame in noisy]
    assert check_current(shaky) == []
    assert check_goal(posed(goal(), shaken), shaky) == []


def test_one_view_is_enough_and_a_bare_table_is_no_finding():
    assert check_current(frames()[:1]) == []
    assert check_goal(goal(), frames()[:1]) == []
    bare = [shoot(i, camera(-90 + 45 * i), []) for i in range(4)]
    assert check_current(bare) == []


@pytest.mark.parametrize(
    ("undo", "cause"),
    [
        (lambda T: T @ FLIP, "OpenGL"),
        (invert, "camera-to-world"),
        (lambda T: invert(T @ FLIP), "camera-to-world ones in OpenGL's axes"),
        (lambda T: T @ BODY, "a body in ROS"),
        (transposed, "transposed"),
        (scaled(1e-3), "are the poses in metres?"),
        (scaled(0.1), "are the poses in centimetres?"),
    ],
)
def test_poses_of_another_convention_are_refused_by_name(undo, cause):
    finding = only(check_current([posed(frame, undo) for frame in frames()]))
    assert finding.severity == "refused"
    assert cause in finding.sentence
    with pytest.raises(ToolkitError, match=r".+"):
        refuse([finding])


@pytest.mark.parametrize(("factor", "said"), [(2.5, "2.5 times"), (10.0, "10 times"), (0.5, "0.5 times")])
def test_depth_in_another_unit_is_refused(factor, said):
    wrong = [replace(frame, depth=frame.depth * np.float32(factor)) for frame in frames()]
    finding = only(check_current(wrong))
    assert finding.severity == "refused"
    assert said in finding.sentence


@settings(deadline=None, max_examples=5)
@given(st.floats(-180, 180), st.floats(0, 180), st.floats(-3, 3))
def test_what_is_found_does_not_depend_on_the_world(turn, tilt, far):
    world = make_transform(Rotation.from_euler("zx", [turn, tilt], degrees=True).as_matrix(), np.array([far, 1, -far]))
    moved = [frame.moved(world) for frame in frames()]
    assert check_current(moved) == []
    assert check_goal(goal().moved(world), moved) == []
    flipped = [posed(frame, lambda T: T @ FLIP) for frame in moved]
    assert "OpenGL" in only(check_current(flipped)).sentence


def test_cam_K_of_half_the_size_is_refused():
    half = K * [[0.5], [0.5], [1]]
    wrong = [replace(frame, camera=replace(frame.camera, K=half)) for frame in frames()]
    finding = only(check_current(wrong))
    assert finding.severity == "refused"
    assert "half the size" in finding.sentence


@pytest.mark.parametrize(("how", "axes"), [("mirrored left to right", 1), ("upside down", (0, 1))])
def test_images_that_were_flipped_for_people_are_refused_by_name(how, axes):
    def flipped(frame, *fields):
        return replace(frame, **{name: np.ascontiguousarray(np.flip(getattr(frame, name), axes)) for name in fields})

    finding = only(check_current([flipped(frame, "depth") for frame in frames()]))
    assert (finding.severity, how in finding.sentence) == ("refused", True)
    finding = only(check_current([flipped(frame, "depth", "rgb") for frame in frames()]))
    assert (finding.severity, how in finding.sentence) == ("refused", True)
    # From all around, a table that is as symmetric as this one would be itself in a mirror.
    uneven = [shoot(i, camera(angle), NOW, print_contrast=0.9) for i, angle in enumerate((-90, -70, -20, 10, 60))]
    assert check_goal(goal(), uneven) == []
    colours = [flipped(frame, "rgb") for frame in uneven]
    for seen in (goal(), flipped(goal(), "rgb")):
        finding = only(check_goal(seen, colours))
        assert (finding.severity, f"the current colour images are {how}" in finding.sentence) == ("refused", True)
    finding = only(check_goal(flipped(goal(), "rgb"), frames()))
    assert (finding.severity, f"the goal image is {how}" in finding.sentence) == ("refused", True)


@pytest.mark.parametrize("off", ["focal", "center", "depth"])
def test_frames_that_contradict_each_other_are_doubted(off):
    if off == "depth":
        shift = np.float32([[0.9, 0, 26], [0, 0.9, 12]])
        wrong = [
            replace(f, depth=cv2.warpAffine(f.depth, shift, f.depth.shape[::-1], flags=cv2.INTER_NEAREST))
            for f in frames()
        ]
    else:
        other = K * [[1.2], [1.2], [1]] if off == "focal" else np.add(K, [[0, 0, 25], [0, 0, 0], [0, 0, 0]])
        wrong = [replace(frame, camera=replace(frame.camera, K=other)) for frame in frames()]
    finding = only(check_current(wrong))
    assert (finding.severity, finding.cap < 0.5) == ("doubtful", True)
    assert "contradict" in finding.sentence


def test_a_frame_with_anothers_pose_is_left_out_by_name():
    wrong = [*frames()[:3], replace(frames()[3], camera=frames()[4].camera), *frames()[4:]]
    finding = only(check_current(wrong))
    assert (finding.severity, finding.frames) == ("left out", (3,))
    kept = usable(wrong, [finding])
    assert [frame.index for frame in kept] == [0, 1, 2, 4, 5, 6, 7]
    assert check_current(kept) == []


def test_poses_one_frame_off_are_told_by_the_goal():
    turned = [replace(f, camera=frames()[(i + 1) % VIEWS].camera) for i, f in enumerate(frames())]
    assert check_current(turned) == []
    finding = only(check_goal(goal(), turned))
    assert (finding.severity, finding.cap < 0.5) == ("doubtful", True)
    assert "one image off" in finding.sentence


def test_one_pose_for_all_frames_is_refused():
    same = [replace(frame, camera=frames()[0].camera) for frame in frames()]
    finding = only(check_current(same))
    assert finding.severity == "refused"
    assert "at one place" in finding.sentence


@pytest.mark.parametrize(
    ("undo", "cause"),
    [
        (lambda T: T @ FLIP, "OpenGL"),
        (lambda T: T @ BODY, "a body in ROS"),
        (invert, "camera-to-world"),
        (scaled(1e-3), "in metres"),
        (lambda T: Y_UP @ T, "another axis up"),
        (lambda T: invert(Y_UP) @ T, "another axis up"),
    ],
)
def test_a_goal_of_another_convention_is_refused_by_name(undo, cause):
    finding = only(check_goal(posed(goal(), undo), frames()))
    assert finding.severity == "refused"
    assert cause in finding.sentence


@pytest.mark.parametrize("undo", [invert, scaled(1e-3)])
def test_a_mistake_in_writing_is_undone_in_the_world_it_was_made_in(undo):
    elsewhere = make_transform(Rotation.from_rotvec([0.3, -0.2, 1.1]).as_matrix(), np.array([0.4, -0.7, 0.2]))
    wrong, moved = posed(goal(), undo), [frame.moved(elsewhere) for frame in frames()]
    finding = only(check_goal(wrong.moved(elsewhere), moved, invert(elsewhere)))
    assert finding.severity == "refused"
    assert finding.sentence == only(check_goal(wrong, frames())).sentence


@pytest.mark.parametrize(("factor", "size"), [(0.5, "half"), (2.0, "twice")])
def test_a_goal_with_cam_K_of_another_size_is_refused_by_name(factor, size):
    other = replace(goal().camera, K=goal().camera.K * [[factor], [factor], [1]])
    finding = only(check_goal(replace(goal(), camera=other), frames()))
    assert finding.severity == "refused"
    assert f"{size} the size" in finding.sentence


@pytest.mark.parametrize("quarters", [1, 3])
def test_a_goal_turned_by_a_quarter_is_refused_by_name(quarters):
    turned = np.ascontiguousarray(np.rot90(goal().rgb, quarters))
    height, width = turned.shape[:2]
    wrong = Frame(0, turned, replace(goal().camera, width=width, height=height))
    finding = only(check_goal(wrong, frames()))
    assert (finding.severity, "turned by a quarter" in finding.sentence) == ("refused", True)


def test_depth_along_rays_is_refused_by_name():
    v, u = np.indices(goal().rgb.shape[:2])
    stretch = np.sqrt(1 + ((u - K[0, 2]) / K[0, 0]) ** 2 + ((v - K[1, 2]) / K[1, 1]) ** 2)
    finding = only(check_current([replace(f, depth=(f.depth * stretch).astype(np.float32)) for f in frames()]))
    assert (finding.severity, "distances from the camera" in finding.sentence) == ("refused", True)


def test_where_depth_is_in_two_units_the_frames_are_blamed_and_not_the_goal():
    mixed = [replace(f, depth=f.depth * np.float32(0.25)) if i % 2 else f for i, f in enumerate(frames())]
    found = check_capture(Capture("mixed", tuple(mixed), goal(), None, "", {}, {}))
    assert "current frames contradict each other" in found[0].sentence and "in one unit" in found[0].sentence
    assert "turned by 0.0 deg" not in found[0].sentence
    assert found == together(check_current(mixed), check_goal(goal(), mixed))


def test_frames_in_doubt_are_refused_with_a_goal_that_does_not_fit_them():
    doubt, misfit = Finding("doubtful", "frames", 0.3, shown="cameras"), Finding("refused", "goal", shown="table")
    other = Finding("doubtful", "dark", 0.3)
    assert [f.severity for f in together([doubt, other], [])] == ["doubtful", "doubtful"]
    found = together([doubt, other], [misfit])
    assert [(f.severity, f.sentence) for f in found] == [
        ("refused", "frames"),
        ("refused", "goal"),
        ("doubtful", "dark"),
    ]


def test_a_single_view_and_its_goal_of_another_convention_are_refused_by_name():
    finding = only(check_goal(posed(goal(), lambda T: T @ FLIP), [posed(frames()[0], lambda T: T @ FLIP)]))
    assert finding.severity == "refused"
    assert "OpenGL" in finding.sentence


def test_a_goal_that_looks_away_is_refused():
    away = camera(-90)
    turned = away.T_world_camera @ make_transform(Rotation.from_euler("y", 180, degrees=True).as_matrix(), np.zeros(3))
    finding = only(check_goal(replace(goal(), camera=replace(away, T_world_camera=turned)), frames()))
    assert finding.severity == "refused"
    assert "no table" in finding.sentence


def test_depth_in_whole_metres_is_refused():
    wrong = [replace(frame, depth=np.rint(frame.depth)) for frame in frames()]
    finding = only(check_current(wrong))
    assert finding.severity == "refused"
    assert "whole metres" in finding.sentence


def test_black_and_white_images_are_told():
    black = replace(goal(), rgb=goal().rgb // 32)
    white = replace(goal(), rgb=np.full_like(goal().rgb, 254))
    assert "black" in check_goal(black, frames())[0].sentence
    assert "overexposed" in check_goal(white, frames())[0].sentence
    one = [replace(frames()[0], rgb=frames()[0].rgb // 32), *frames()[1:]]
    finding = only(check_current(one))
    assert (finding.severity, finding.frames) == ("left out", (0,))
    every = [replace(frame, rgb=frame.rgb // 32) for frame in frames()]
    assert check_current(every)[0].severity == "doubtful"


def lit(frame, *gains):
    return replace(frame, rgb=(frame.rgb * np.array(gains)).clip(0, 255).astype(np.uint8))


def swapped(frame):
    return replace(frame, rgb=np.ascontiguousarray(frame.rgb[..., ::-1]))


def on_grey(frame):
    """The table without any colour, and what stands on it as it is."""
    things = np.any(list(frame.true_masks.values()), axis=0)[..., None]
    return replace(frame, rgb=np.where(things, frame.rgb, frame.rgb.mean(axis=2, keepdims=True)).astype(np.uint8))


def test_red_and_blue_in_each_others_place_are_told():
    wood, seen = [lit(frame, 1, 0.8, 0.6) for frame in frames()], lit(goal(), 1, 0.8, 0.6)
    for one, others in ((swapped(seen), wood), (seen, [swapped(frame) for frame in wood])):
        finding = only(check_goal(one, others))
        assert (finding.severity, finding.shown) == ("doubtful", "table") and "red and blue" in finding.sentence
    assert check_goal(swapped(seen), [swapped(frame) for frame in wood]) == []


def test_other_light_a_grey_table_and_a_goal_without_colour_are_not_taken_for_it():
    wood, seen = [lit(frame, 1, 0.8, 0.6) for frame in frames()], lit(goal(), 1, 0.8, 0.6)
    # Under the last one, the table alone looks as if red and blue were swapped; not so what stands on it.
    for light in ((0.6, 0.9, 1), (1, 0.9, 0.6), (0.36, 0.8, 1)):
        assert check_goal(lit(seen, *light), wood) == []
    colourless = np.repeat(seen.rgb.mean(axis=2, keepdims=True), 3, axis=2).astype(np.uint8)
    assert check_goal(replace(seen, rgb=colourless), wood) == []
    assert check_goal(on_grey(swapped(goal())), [on_grey(frame) for frame in frames()]) == []


def test_a_frame_without_a_table_is_left_out_and_none_with_one_is_doubted():
    depth = np.zeros_like(frames()[0].depth)
    depth[:10, :10] = 1 + 0.1 * np.random.default_rng(0).random((10, 10))
    blind = replace(frames()[2], depth=depth)
    finding = only(check_current([*frames()[:2], blind, *frames()[3:]]))
    assert (finding.severity, finding.frames) == ("left out", (2,))
    assert only(check_current([blind])).severity == "doubtful"


def test_doubt_caps_confidence_and_makes_none():
    segment = Segment(np.ones((2, 2), bool))
    estimates = [
        PoseEstimate(0, segment, 0, np.eye(4), confidence=0.9),
        PoseEstimate(1, segment, 0, np.eye(4), confidence=0.1),
        PoseEstimate(2, segment, 0, np.eye(4)),
        PoseEstimate(3, segment, None, None, Failure("pnp", "none")),
    ]
    findings = [Finding("doubtful", "a", 0.3), Finding("said", "b"), Finding("doubtful", "c", 0.5)]
    assert [e.confidence for e in doubted(estimates, findings)] == [0.3, 0.1, None, None]
    assert [e.confidence for e in doubted(estimates, [])] == [0.9, 0.1, None, None]
