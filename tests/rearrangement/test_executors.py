"""Executors: what was asked for happens, nothing is touched on the way, and what goes wrong has a name."""

from __future__ import annotations

import json

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from toolkit.data.layout import resting_poses
from toolkit.data.objects import load_object_set
from toolkit.data.tabletop import TabletopConfig, draw_scene
from toolkit.errors import ToolkitError
from toolkit.geometry import invert, make_transform, rotation_angle, rotation_z, transform_points
from toolkit.rearrangement.executors.handling.resting import settle
from toolkit.rearrangement.executors.kinematic import Kinematic, KinematicConfig
from toolkit.rearrangement.executors.replay import Recorder, Replay, ReplayConfig
from toolkit.rearrangement.moves import PickPlace
from toolkit.sim.solids import Solids

CONFIG = TabletopConfig(scenes=1, min_objects=4, max_objects=4, views=2, seed=1, renderer="tiny", supersample=1)


@pytest.fixture(scope="module")
def scene(cache):
    return draw_scene(CONFIG, load_object_set("procedural", cache), 0, cache)


@pytest.fixture
def executor(scene):
    kinematic = Kinematic()
    kinematic.begin(scene)
    yield kinematic
    kinematic.close()


def vertices(scene, executor, number):
    mesh = trimesh.load(scene.assets[number].mesh, force="mesh")
    return transform_points(executor.state()[number], np.asarray(mesh.vertices))


def request(scene, executor, number, T_place_pick):
    others = [vertices(scene, executor, i) for i in range(len(scene.assets)) if i != number]
    return PickPlace(vertices(scene, executor, number), T_place_pick, np.concatenate(others))


def shift(x, y, z=0.0):
    return make_transform(np.eye(3), np.array([x, y, z]))


def free_corner(scene, executor, number):
    """A motion to a corner of the table, which the scenes leave free."""
    return shift(*(0.5 - executor.state()[number][:2, 3]))


def test_an_object_ends_where_it_was_to_be_put(scene, executor):
    T = free_corner(scene, executor, 0) @ rotation_z(0.0)
    before = executor.state()
    outcome = executor.pick_place(request(scene, executor, 0, T))
    assert outcome.failure is None and outcome.object == 0 and outcome.seconds > 1
    np.testing.assert_allclose(executor.state()[0], T @ before[0], atol=1e-12)
    for other in (1, 2, 3):
        np.testing.assert_array_equal(executor.state()[other], before[other])


def test_what_it_sees_is_where_things_are(scene, executor):
    goal_masks = executor.begin(scene).true_masks
    executor.pick_place(request(scene, executor, 0, free_corner(scene, executor, 0)))
    frames = executor.observe()
    assert len(frames) == 2 and set(goal_masks) == {0, 1, 2, 3}
    frame = frames[0]
    y, x = np.nonzero(frame.true_masks[0])
    camera = frame.camera
    rays = (np.stack([x, y], axis=1) - camera.K[:2, 2]) / np.diag(camera.K)[:2]
    points = np.concatenate([rays, np.ones((len(x), 1))], axis=1) * frame.depth[y, x, None]
    seen = transform_points(camera.T_world_camera, points)
    low, high = (f(vertices(scene, executor, 0), axis=0) for f in (np.min, np.max))
    assert ((seen > low - 0.005) & (seen < high + 0.005)).all()


def test_the_first_frames_are_the_benchmark_s(scene, executor, cache, tmp_path):
    from toolkit.data.bop import load_capture
    from toolkit.data.tabletop import build_scene

    build_scene(CONFIG, load_object_set("procedural", cache), 0, tmp_path / "capture", cache)
    capture = load_capture(tmp_path / "capture")
    for mine, stored in zip(executor.observe(), capture.current, strict=True):
        np.testing.assert_array_equal(mine.rgb, stored.rgb)
        np.testing.assert_allclose(mine.depth, stored.depth, atol=1e-4)


def test_a_place_that_is_taken_is_a_failure_and_nothing_has_moved(scene, executor):
    before = executor.state()
    onto = shift(*(before[1] - before[0])[:2, 3])
    outcome = executor.pick_place(request(scene, executor, 0, onto))
    assert outcome.failure.reason == "lowering object 0 would hit object 1"
    for number, pose in before.items():
        np.testing.assert_array_equal(executor.state()[number], pose)


def test_no_motion_touches_anything_else(scene, executor):
    """Over 100 moves to places all over the table, checked at every step by their own closest points."""
    solids = Solids([asset.hulls for asset in scene.assets])
    deepest = 0.0
    rng = np.random.default_rng(0)
    done = 0
    for turn in range(100):
        moving = turn % 4
        place = shift(*(rng.uniform(-0.45, 0.45, 2) - executor.state()[moving][:2, 3]))
        asked = request(scene, executor, moving, place)
        before = executor.state()
        steps = []
        executor.on_step = lambda steps=steps: steps.append(executor.state())
        outcome = executor.pick_place(asked)
        if outcome.failure is None:
            done += 1
            for state in steps[::10] + steps[-1:]:
                for number, pose in state.items():
                    solids.place(number, pose)
                deepest = min(deepest, *(solids.gap(moving, other) for other in range(4) if other != moving))
        else:
            assert "would hit" in outcome.failure.reason
            np.testing.assert_array_equal(executor.state()[moving], before[moving])
    solids.close()
    assert done > 30
    assert deepest >= -0.001


def test_wide_objects_absent_objects_and_places_off_the_table_have_names(scene, executor):
    asked = request(scene, executor, 0, free_corner(scene, executor, 0))
    narrow = Kinematic(KinematicConfig(gripper_width_m=0.01))
    narrow.begin(scene)
    assert "cm wide, the gripper opens 1.0 cm" in narrow.pick_place(asked).failure.reason
    narrow.close()
    nothing = PickPlace(asked.points + np.array([0, 0, 1.0]), asked.T_place_pick, asked.others)
    assert "there is no object" in executor.pick_place(nothing).failure.reason
    off = PickPlace(asked.points, shift(2.0, 0), asked.others)
    assert "beyond the table's edge" in executor.pick_place(off).failure.reason


def test_released_objects_come_to_rest_flat_on_the_table(cache):
    rng = np.random.default_rng(0)
    for asset in load_object_set("procedural", cache).assets[::9]:
        rests = resting_poses(asset)
        points = np.concatenate([np.asarray(trimesh.load(hull, force="mesh").vertices) for hull in asset.hulls])
        upright = shift(0.1, -0.2) @ rotation_z(1.0) @ rests[0].T_rest_model
        np.testing.assert_allclose(settle(upright, rests), upright, atol=1e-12)
        tilt = make_transform(Rotation.from_rotvec(0.1 * rng.normal(size=3)).as_matrix(), np.array([0, 0, 0.03]))
        settled = settle(tilt @ upright, rests)
        assert transform_points(settled, points)[:, 2].min() == pytest.approx(0, abs=1e-9)
        tip = settled @ invert(tilt @ upright)
        assert rotation_angle(tip[:3, :3]) < 0.6
        assert any(np.allclose(settled[2, :3], rest.T_rest_model[2, :3], atol=1e-9) for rest in rests)


def test_a_recording_plays_back_what_happened(scene, tmp_path):
    kinematic = Kinematic()
    recorder = Recorder(kinematic, tmp_path / "recording", scene.truth)
    goal = recorder.begin(scene)
    first = recorder.observe()
    moves = [request(scene, kinematic, 0, free_corner(scene, kinematic, 0))]
    outcomes = [recorder.pick_place(moves[0])]
    onto = shift(*(kinematic.state()[2] - kinematic.state()[1])[:2, 3])
    moves.append(request(scene, kinematic, 1, onto))
    outcomes.append(recorder.pick_place(moves[1]))
    last = recorder.observe()
    recorder.close()

    replay = Replay(ReplayConfig(folder=tmp_path / "recording"))
    np.testing.assert_array_equal(replay.begin(None).rgb, goal.rgb)
    np.testing.assert_array_equal(replay.observe()[0].rgb, first[0].rgb)
    assert [replay.pick_place(move) for move in moves] == outcomes
    assert outcomes[1].failure is not None
    np.testing.assert_array_equal(replay.observe()[1].rgb, last[1].rgb)
    assert replay.state() is None
    assert "no further move" in replay.pick_place(moves[0]).failure.reason
    with pytest.raises(ToolkitError, match="holds 2 observations"):
        replay.observe()


def test_recordings_without_what_was_added_later_play_back_and_damaged_ones_are_named(scene, tmp_path):
    kinematic = Kinematic()
    recorder = Recorder(kinematic, tmp_path)
    recorder.begin(scene)
    recorder.observe()
    asked = request(scene, kinematic, 0, free_corner(scene, kinematic, 0))
    outcome = recorder.pick_place(asked)
    recorder.close()

    log = tmp_path / "moves.json"
    (move,) = json.loads(log.read_text())
    replay = Replay(ReplayConfig(folder=tmp_path))
    log.write_text(json.dumps([{key: value for key, value in move.items() if key not in ("picks", "T_moved")}]))
    replay.begin(None)
    assert replay.pick_place(asked) == outcome and outcome.picks == 1
    damaged = (3, {}, ["a"], [{}], [move | {"picks": None}], [move | {"pick": [0, 0]}], [move | {"T_place_pick": {}}])
    for entries in damaged:
        log.write_text(json.dumps(entries))
        with pytest.raises(ToolkitError, match="' is no list of recorded moves: "):
            replay.begin(None)
    log.write_text("[")
    with pytest.raises(ToolkitError, match="' is not readable JSON"):
        replay.begin(None)


def test_a_replay_refuses_another_move(scene, tmp_path):
    kinematic = Kinematic()
    recorder = Recorder(kinematic, tmp_path / "recording")
    recorder.begin(scene)
    recorder.observe()
    asked = request(scene, kinematic, 0, free_corner(scene, kinematic, 0))
    recorder.pick_place(asked)
    recorder.close()
    replay = Replay(ReplayConfig(folder=tmp_path / "recording"))
    replay.begin(None)
    other = PickPlace(asked.points, shift(0.03, 0) @ asked.T_place_pick, asked.others)
    assert replay.pick_place(other).failure.reason == "the recorded move lies 3.0 cm from the one asked for"
    with pytest.raises(ToolkitError, match="is no recording"):
        Replay(ReplayConfig(folder=tmp_path)).begin(None)
