"""Camera poses corrected by the images, on ray-cast scenes whose true poses are known."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from toolkit.errors import ToolkitError
from toolkit.geometry import invert, look_at, make_transform, project, transform_points
from toolkit.perception.registration.surfaces.align import Link, reconcile
from toolkit.perception.registration.tracking.adjust import adjust
from toolkit.perception.registration.tracking.tracks import Tracks
from toolkit.plugin_kit.conformance import raycast
from toolkit.plugin_kit.conformance.raycast import NOW, THEN, camera, shoot
from toolkit.stages import REGISTRATIONS
from toolkit.types import Camera, Frame

PLACES = np.array([[0.2 * np.cos(a), 0.2 * np.sin(a), 0.03] for a in np.linspace(0, 2 * np.pi, 8)[:-1]])
LOOSE = np.repeat([np.radians(1), 0.01], 3)


def misstate(view: Camera, rng: np.random.Generator, degrees: float = 0.15, metres: float = 0.0015) -> Camera:
    """The camera with a pose that is a little wrong."""
    turn = Rotation.from_rotvec(rng.normal(0, np.radians(degrees), 3)).as_matrix()
    error = make_transform(turn, rng.normal(0, metres, 3))
    return Camera(view.K, view.T_world_camera @ error, view.width, view.height)


def scene(seed: int) -> tuple[list[Frame], Frame]:
    """Current frames and a goal whose poses are misstated, and whose light is another."""
    rng = np.random.default_rng(seed)
    current = [shoot(i, camera(-90 + 45 * i), NOW) for i in range(8)]
    goal = shoot(50, camera(-90), THEN, depth=False)
    dimmed = np.rint(0.8 * goal.rgb + 10).astype(np.uint8)
    current = [replace(frame, camera=misstate(frame.camera, rng)) for frame in current]
    return current, replace(goal, rgb=dimmed, camera=misstate(goal.camera, rng))


def disagreement(frames: Sequence[Frame], goal: Frame) -> float:
    """Millimetres by which the frames and the goal place a point differently, on average."""
    truth = [camera(-90 + 45 * i) for i in range(8)]

    def placed(frame: Frame, true: Camera) -> np.ndarray:
        return transform_points(frame.camera.T_world_camera @ invert(true.T_world_camera), PLACES)

    there = placed(goal, camera(-90))
    errors = [placed(frame, true) - there for frame, true in zip(frames, truth, strict=True)]
    return 1e3 * float(np.linalg.norm(errors, axis=2).mean())


def spread(frames: Sequence[Frame]) -> float:
    """Millimetres by which frames place a point away from their own mean, on average."""
    placed = [
        transform_points(f.camera.T_world_camera @ invert(camera(-90 + 45 * i).T_world_camera), PLACES)
        for i, f in enumerate(frames)
    ]
    return 1e3 * float(np.linalg.norm(placed - np.mean(placed, axis=0), axis=2).mean())


@pytest.mark.parametrize("name", REGISTRATIONS.names())
def test_registration_changes_nothing_but_poses_and_repeats(name):
    current, goal = scene(0)
    stage = REGISTRATIONS.create(name)
    frames = stage.register(current)
    located = stage.locate(goal, frames)
    assert [f.index for f in frames] == [f.index for f in current]
    for before, after in zip([*current, goal], [*frames, located], strict=True):
        assert after.rgb is before.rgb or np.array_equal(after.rgb, before.rgb)
        assert np.array_equal(after.camera.K, before.camera.K)
    again = REGISTRATIONS.create(name)
    poses = [f.camera.T_world_camera.tobytes() for f in [*frames, located]]
    repeated = again.register(current)
    assert poses == [f.camera.T_world_camera.tobytes() for f in [*repeated, again.locate(goal, repeated)]]


@pytest.mark.parametrize("seed", range(3))
def test_the_table_brings_the_cameras_together(seed):
    current, goal = scene(seed)
    stage = REGISTRATIONS.create("table")
    frames = stage.register(current)
    assert disagreement(frames, stage.locate(goal, frames)) < disagreement(current, goal) / 3


def test_a_goal_can_be_located_among_frames_registered_elsewhere():
    current, goal = scene(1)
    frames = REGISTRATIONS.create("table").register(current)
    located = REGISTRATIONS.create("table").locate(goal, [replace(frame) for frame in frames])
    assert disagreement(frames, located) < disagreement(current, goal) / 3


@pytest.mark.parametrize("seed", range(3))
def test_surfaces_bring_the_frames_together_where_the_table_has_no_texture(seed, monkeypatch):
    monkeypatch.setattr(raycast, "GRAIN", 0.0)
    pytest.importorskip("small_gicp")
    current, _ = scene(seed)
    assert spread(REGISTRATIONS.create("gicp").register(current)) < spread(current) / 2


def test_a_frame_that_shows_no_surface_stays_where_it_is():
    pytest.importorskip("small_gicp")
    current, goal = scene(0)
    blind = replace(current[3], depth=np.zeros_like(current[3].depth))
    stage = REGISTRATIONS.create("gicp")
    frames = stage.register([*current[:3], blind])
    assert np.allclose(frames[3].camera.T_world_camera, blind.camera.T_world_camera, atol=1e-12)
    assert not np.allclose(frames[0].camera.T_world_camera, current[0].camera.T_world_camera, atol=1e-4)
    with pytest.raises(ToolkitError, match="frame 50 has no depth"):
        stage.register([*current[:3], goal])


def test_without_small_gicp_one_sentence_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "small_gicp", None)
    with pytest.raises(ToolkitError, match=r"pip install 'rearrange-toolkit\[icp\]'"):
        REGISTRATIONS.create("gicp").check_ready()


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10_000))
def test_reconciled_poses_agree_on_exact_links(seed):
    """A common motion apart, which no link shows; what the links leave open stays as stated."""
    rng = np.random.default_rng(seed)
    true = [
        make_transform(Rotation.from_rotvec(rng.normal(0, 1, 3)).as_matrix(), rng.normal(0, 1, 3)) for _ in range(4)
    ]
    errors = [
        make_transform(Rotation.from_rotvec(rng.normal(0, 0.004, 3)).as_matrix(), rng.normal(0, 0.004, 3)) for _ in true
    ]
    stated = [pose @ error for pose, error in zip(true, errors, strict=True)]
    information = 1e12 * np.eye(6)
    links = [Link(i, j, invert(true[i]) @ true[j], information) for i, j in [(0, 1), (1, 2), (0, 2)]]
    found = reconcile(stated, links, LOOSE)
    assert np.allclose(found[3], stated[3], atol=1e-12)
    for one in links:
        between = invert(found[one.first]) @ found[one.second]
        assert np.allclose(between, one.T_first_second, atol=1e-6)


def test_a_table_without_texture_spoils_no_pose(monkeypatch):
    monkeypatch.setattr(raycast, "GRAIN", 0.0)
    current = [shoot(i, camera(-90 + 45 * i), []) for i in range(4)]
    for before, after in zip(current, REGISTRATIONS.create("table").register(current), strict=True):
        assert np.allclose(before.camera.T_world_camera, after.camera.T_world_camera, atol=1e-3)


def test_without_depth_there_is_no_table():
    blind = [replace(shoot(0, camera(0), NOW), depth=None)]
    with pytest.raises(ToolkitError, match="no depth"):
        REGISTRATIONS.create("table").register(blind)
    with pytest.raises(ToolkitError, match="there is no frame"):
        REGISTRATIONS.create("table").register([])


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10_000))
def test_adjusted_cameras_agree_on_exact_tracks(seed):
    rng = np.random.default_rng(seed)
    points = np.column_stack([rng.uniform(-0.3, 0.3, (60, 2)), np.zeros(60)])
    T_world_table = make_transform(Rotation.from_rotvec(rng.normal(0, 0.3, 3)).as_matrix(), rng.normal(0, 1, 3))
    azimuths = rng.uniform(-np.pi, np.pi, 3)
    eyes = np.stack([0.7 * np.cos(azimuths), 0.7 * np.sin(azimuths), np.full(3, 0.8)], axis=1)
    true = [Camera(raycast.K, T_world_table @ look_at(eye, np.zeros(3)), 320, 240) for eye in eyes]
    seen = [project(c.K, invert(c.T_world_camera), transform_points(T_world_table, points))[0] for c in true]
    pairs = [(0, 1), (0, 2), (1, 2)]
    tracks = Tracks(
        np.repeat([i for i, _ in pairs], 60),
        np.repeat([j for _, j in pairs], 60),
        np.concatenate([seen[i] for i, _ in pairs]),
        np.concatenate([seen[j] for _, j in pairs]),
    )
    stated = [true[0], *(misstate(c, rng, 0.4, 0.004) for c in true[1:])]
    found = adjust(stated, tracks, T_world_table, [False, True, True], LOOSE)
    assert found[0] is true[0]
    for got, want in zip(found, true, strict=True):
        T = invert(want.T_world_camera) @ got.T_world_camera
        assert np.abs(T[:3, 3]).max() < 2e-4
        assert np.degrees(Rotation.from_matrix(T[:3, :3]).magnitude()) < 0.02
