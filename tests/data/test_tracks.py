"""Every track: the same bytes whoever builds it, truths that score as truths, scenes that could be photographed."""

from __future__ import annotations

import hashlib
from itertools import combinations

import numpy as np
import pytest
from scipy.optimize import linprog

from toolkit.data.bop import load_capture
from toolkit.data.conditions import Conditions, ConditionSettings, draw_conditions
from toolkit.data.dataset import build_dataset
from toolkit.data.layout import resting_poses
from toolkit.data.objects import load_object_set
from toolkit.data.scene import TabletopConfig, draw_scene
from toolkit.data.tabletop import Studio
from toolkit.geometry import observation_vector, transform_points
from toolkit.parallel import open_workers
from toolkit.results.scoring import score
from toolkit.sim.compound import convex_pieces
from toolkit.sim.world import Light, World
from toolkit.types import Failure, PoseEstimate, Segment

TRACKS = ("clean", "d435", "realsense", "kinect", "crowded", "wild")
SMALL = {"scenes": 1, "min_objects": 5, "max_objects": 5, "views": 2, "supersample": 1, "seed": 2}


def files(folder):
    return {p.relative_to(folder): hashlib.sha256(p.read_bytes()).hexdigest() for p in folder.rglob("*") if p.is_file()}


@pytest.fixture(scope="module")
def built(cache, tmp_path_factory):
    """Captures by track and further settings, each built once."""
    known = {}

    def build(track, **settings):
        key = (track, *sorted(settings.items()))
        if key not in known:
            config = TabletopConfig(track=track, **{**SMALL, **settings})
            known[key] = build_dataset(config, tmp_path_factory.mktemp("tracks") / "set", cache) / "000000"
        return known[key]

    return build


def drawn(cache, number=0, **settings):
    config = TabletopConfig(**{**SMALL, "scenes": number + 1, **settings})
    return draw_scene(config, load_object_set("procedural", cache), number, cache)


@pytest.mark.parametrize("track", ["realsense", "kinect", "crowded", "wild"])
def test_a_scene_is_the_same_whoever_builds_it(built, cache, tmp_path, track):
    config = TabletopConfig(track=track, **{**SMALL, "scenes": 2})
    with open_workers(2) as workers:
        together = build_dataset(config, tmp_path / "together", cache, workers)
    assert files(together / "000000") == files(built(track))
    assert files(together / "000000") != files(together / "000001")


def test_settings_at_what_the_track_has_change_nothing(built):
    assert files(built("clean", **{k: v for k, v in vars(Conditions()).items() if k != "most_views"})) == files(
        built("clean")
    )


def test_a_track_is_its_settings(built):
    assert files(built("clean", crowding=0.7)) == files(built("crowded"))


def answers(capture, motion_for_absent=None):
    """The truth as estimates; objects that are not there now get this motion."""
    estimates = []
    for number, (instance, mask) in enumerate(sorted(capture.goal.true_masks.items())):
        T = capture.truth[instance].T_goal_current if instance in capture.truth else motion_for_absent
        failure = Failure("retriever", "nothing looks like it") if T is None else None
        estimates.append(PoseEstimate(number, Segment(mask), instance, T, failure, confidence=0.9))
    return estimates


@pytest.mark.parametrize("track", TRACKS)
def test_truth_fed_as_estimate_is_all_right(built, track):
    capture = load_capture(built(track))
    rows = score(capture, answers(capture))
    assert len(rows) == len(capture.truth) + len(capture.only_goal) >= 1
    assert all(row.success and row.success_sym for row in rows)


def test_a_motion_for_what_is_not_there_is_a_false_alarm(built):
    capture = load_capture(built("clean", one_sided=0.7))
    assert capture.only_goal and capture.only_current and capture.truth
    assert all(row.success_sym for row in score(capture, answers(capture)))
    rows = score(capture, answers(capture, motion_for_absent=np.eye(4)))
    assert {row.object for row in rows if not row.success_sym} == set(capture.only_goal)
    assert {row.object for row in rows if not row.in_current} == set(capture.only_goal)
    # Nobody said anything: what is not there was not found, as it should be.
    assert {row.object for row in score(capture, []) if row.success_sym} == set(capture.only_goal)


def test_one_sided_objects_are_seen_on_their_side_only(built):
    capture = load_capture(built("clean", one_sided=0.7))
    in_goal = set(capture.goal.true_masks)
    in_current = {i for frame in capture.current for i in frame.true_masks}
    assert in_goal == set(capture.truth) | set(capture.only_goal)
    assert in_current == set(capture.truth) | set(capture.only_current)


def test_unmoved_objects_stand_where_they_are_to_go(cache):
    scene = drawn(cache, unmoved=1.0, poses="stable")
    for truth in scene.truth.values():
        np.testing.assert_allclose(truth.T_goal_current, np.eye(4), atol=1e-12)
    some = [drawn(cache, number, unmoved=0.5, max_objects=9, min_objects=9) for number in range(4)]
    stays = [np.allclose(t.T_goal_current, np.eye(4)) for scene in some for t in scene.truth.values()]
    assert 0.2 < np.mean(stays) < 0.8


def cut(a, b):
    """Whether two convex point sets have a point in common: a linear programme, sharing nothing with the generator."""
    n, m = len(a), len(b)
    equal = np.zeros((5, n + m))
    equal[:3, :n], equal[:3, n:] = a.T, -b.T
    equal[3, :n], equal[4, n:] = 1, 1
    return linprog(np.zeros(n + m), A_eq=equal, b_eq=[0, 0, 0, 1, 1], method="highs").status == 0


def shrunk(points, by=2e-4):
    middle = points.mean(axis=0)
    reach = np.linalg.norm(points - middle, axis=1).max()
    return middle + (points - middle) * (1 - by / reach)


@pytest.mark.parametrize("number", range(3))
@pytest.mark.parametrize("unmoved", [0.0, 0.5])
def test_crowded_objects_touch_and_do_not_cut_into_each_other(cache, number, unmoved):
    scene = drawn(cache, number, crowding=1.0, max_objects=7, min_objects=7, unmoved=unmoved)
    for poses in (scene.current, scene.goal):
        solids = [
            [shrunk(transform_points(T, np.asarray(piece.vertices))) for piece in convex_pieces(asset.hulls)]
            for asset, T in zip(scene.assets, poses, strict=True)
        ]
        for a, b in combinations(solids, 2):
            near = [
                (p, q)
                for p in a
                for q in b
                if (p.min(axis=0) <= q.max(axis=0)).all() and (q.min(axis=0) <= p.max(axis=0)).all()
            ]
            assert not any(cut(p, q) for p, q in near)


def test_crowded_objects_are_closer_than_others(cache):
    def nearest(crowding):
        gaps = []
        for number in range(4):
            scene = drawn(cache, number, crowding=crowding, max_objects=6, min_objects=6, radius_m=0.4)
            middles = np.array([transform_points(t.T_world_goal, t.model.center) for t in scene.truth.values()])
            radii = np.array([resting_poses(a)[0].radius for a in scene.assets])
            apart = np.linalg.norm((middles[:, None] - middles)[..., :2], axis=-1) - radii[:, None] - radii
            gaps += (apart + 9 * np.eye(len(apart))).min(axis=1).tolist()
        return np.array(gaps)

    # Discs around long objects overlap when these stand side by side; those that stand apart are a centimetre apart.
    assert np.mean(nearest(1.0) < 0.0) > np.mean(nearest(0.0) < 0.0) + 0.3


@pytest.mark.parametrize("track", ["crowded", "wild"])
def test_every_object_is_seen_in_the_goal_and_in_a_frame(built, track):
    capture = load_capture(built(track, crowding=0.9, hands=1.0))
    in_goal = {*capture.truth, *capture.only_goal}
    assert set(capture.goal.true_masks) == in_goal
    assert all(capture.goal.true_masks[i].sum() > 40 for i in in_goal)
    for i in (*capture.truth, *capture.only_current):
        assert max(frame.true_masks[i].sum() for frame in capture.current if i in frame.true_masks) > 40


def test_masks_are_those_of_a_z_buffer_over_objects_rendered_alone(cache):
    scene = drawn(cache, crowding=1.0, max_objects=6, min_objects=6)
    with Studio(scene, cache) as studio:
        frame = studio.current(scene.current)[0]
    with World(scene.config.renderer) as world:
        bodies = world.add_visuals([(asset.mesh, asset.texture) for asset in scene.assets])
        alone = []
        for body, pose in zip(bodies, scene.current, strict=True):
            world.move_all(
                bodies, [np.array([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, -50], [0, 0, 0, 1.0]])] * len(bodies)
            )
            world.client.place(body, pose)
            depth = world.render(scene.cameras[0], Light())[1]
            alone.append(np.where(depth > 0, depth, np.inf))
    nearest = np.argmin(alone, axis=0)
    covered = np.isfinite(np.min(alone, axis=0))
    hidden = sum(np.isfinite(depth).sum() for depth in alone) - covered.sum()
    assert hidden > 100, "nothing is occluded here"
    for i in range(len(bodies)):
        expected = covered & (nearest == i)
        wrong = (expected ^ frame.true_masks[i]).sum()
        assert wrong <= 0.02 * expected.sum() + 8


def test_frames_on_an_arc_are_near_each_other_and_one_is_enough(cache):
    scene = drawn(cache, arc_deg=30, views=4)
    looks = [observation_vector(camera.T_world_camera, np.zeros((1, 3))) for camera in scene.cameras]
    azimuths = np.degrees([np.arctan2(look[1], look[0]) for look in looks])
    np.testing.assert_allclose(azimuths, [-105, -95, -85, -75], atol=1e-6)
    assert len(drawn(cache, arc_deg=30, views=1).cameras) == 1


def test_one_current_frame_makes_a_capture(built):
    capture = load_capture(built("wild", views=1))
    assert len(capture.current) == 1 and set(capture.truth) <= set(capture.current[0].true_masks)


def test_another_goal_camera_has_other_intrinsics_and_sees_every_object(cache):
    scenes = [drawn(cache, number, goal_camera="other") for number in range(6)]
    sizes = {(scene.goal_camera.width, scene.goal_camera.height) for scene in scenes}
    assert len(sizes) > 2
    for scene in scenes:
        assert scene.goal_camera.K[0, 0] != scene.cameras[0].K[0, 0]


def test_a_hand_reaches_into_the_pictures_and_into_no_object(built, cache):
    bare, reached = load_capture(built("clean")), load_capture(built("clean", hands=1.0))
    for without, frame in zip([bare.goal, *bare.current], [reached.goal, *reached.current], strict=True):
        assert (without.rgb != frame.rgb).any(axis=-1).mean() > 0.005
        for i, mask in without.true_masks.items():
            assert frame.true_masks[i].sum() > 0.3 * mask.sum()
    for without, frame in zip(bare.current, reached.current, strict=True):
        nearer = without.depth - frame.depth > 0.01
        assert nearer.mean() > 0.005


def test_a_room_fills_the_pictures_behind_the_table(built):
    bare, room = load_capture(built("clean")), load_capture(built("clean", background=True))
    for without, frame in zip(bare.current, room.current, strict=True):
        assert (without.depth == 0).mean() > 0.05
        assert (frame.depth == 0).mean() == 0
        beyond = frame.depth[without.depth == 0]
        assert beyond.std() > 0.1


def test_flat_things_do_not_hide_objects_and_some_come_or_go(built, cache):
    bare, flat = load_capture(built("clean")), load_capture(built("clean", clutter=12))
    assert (bare.goal.rgb != flat.goal.rgb).any(axis=-1).mean() > 0.01
    for i, mask in bare.goal.true_masks.items():
        assert (mask ^ flat.goal.true_masks[i]).sum() <= 0.1 * mask.sum()
    for without, frame in zip(bare.current, flat.current, strict=True):
        assert 0 < np.abs(without.depth - frame.depth).max() < 0.002


def test_a_smaller_table_shows_its_edge_and_holds_the_objects(cache):
    for number, shape in enumerate(("rectangle", "round", "any", "any")):
        scene = drawn(cache, number, table_shape=shape)
        for asset, T in zip(scene.assets, scene.current, strict=True):
            for piece in convex_pieces(asset.hulls):
                assert scene.table.holds(transform_points(T, np.asarray(piece.vertices))[:, :2])
        assert not scene.table.holds(scene.table.outline() * 1.01 + 0.01 * np.sign(scene.table.outline()))


def test_wild_scenes_differ_in_every_setting_and_obey_those_that_are_set():
    drawn = [draw_conditions(ConditionSettings(track="wild"), np.random.default_rng(i)) for i in range(60)]
    for name in vars(Conditions()):
        if name not in ("table", "table_shape", "crowding_in"):
            assert len({getattr(conditions, name) for conditions in drawn}) > 1, name
    fixed = [draw_conditions(ConditionSettings(track="wild", gloss=0.5), np.random.default_rng(i)) for i in range(5)]
    assert {conditions.gloss for conditions in fixed} == {0.5}
