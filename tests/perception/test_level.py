"""The world may lie as it likes: what is measured of the table decides, and motions come back in the user's world."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from usual import usual_stages

from toolkit.geometry import invert, make_transform, project, transform_points
from toolkit.perception.database import Database
from toolkit.perception.level import measure_level
from toolkit.perception.pipeline import Pipeline, PipelineSettings
from toolkit.plugin_kit.conformance.raycast import NOW, camera, shoot
from toolkit.plugin_kit.conformance.scene import current_frames, dark_frame, goal_frame, true_motion
from toolkit.stages import ASSOCIATORS, PNP, REFINERS, SEGMENTERS

_SAME = 1e-6
"""Metres and radians. Between worlds, poses of frames differ in their last bits only, and no stage draws by chance."""


@st.composite
def worlds(draw):
    """(4, 4) into any rigid world, upright or leaning a little too; its origin is as far away as a room is wide."""
    first, second = (draw(st.floats(-180, 180)) for _ in range(2))
    R = Rotation.from_euler("zxz", [first, draw(st.floats(0, 180)), second], degrees=True).as_matrix()
    return make_transform(R, np.array([draw(st.floats(-5, 5)) for _ in range(3)]))


@lru_cache
def pipeline() -> Pipeline:
    """A pipeline whose every stage takes the table for level."""
    stages = usual_stages(
        segmenter=SEGMENTERS.create("oracle"),
        goal_segmenter=SEGMENTERS.create("oracle"),
        associator=ASSOCIATORS.create("oracle"),
        pnp=PNP.create("jax_joint"),
        refiner=REFINERS.create("render_compare"),
    )
    return Pipeline(stages, PipelineSettings(assignment="truth"))


def motions_in(world):
    """The estimates from a scene in another world, taken back to the upright one."""
    database = pipeline().build_database([frame.moved(world) for frame in current_frames()])
    return [e.in_world(invert(world)) for e in pipeline().estimate(database, goal_frame().moved(world))]


@lru_cache
def upright():
    return motions_in(np.eye(4))


def test_the_upright_world_has_right_answers():
    for number, estimate in enumerate(upright(), start=1):
        np.testing.assert_allclose(estimate.T_goal_current, true_motion(number), atol=0.01)


@settings(deadline=None, max_examples=5, phases=[Phase.explicit, Phase.generate])
@given(worlds())
def test_any_world_gives_the_motions_of_the_upright_one(world):
    for estimate, want in zip(motions_in(world), upright(), strict=True):
        np.testing.assert_allclose(estimate.T_goal_current, want.T_goal_current, atol=_SAME)
        np.testing.assert_allclose(estimate.equivalents, want.equivalents, atol=_SAME)
        np.testing.assert_allclose(estimate.covariance, want.covariance, rtol=1e-4, atol=1e-10)
        np.testing.assert_allclose(estimate.confidence, want.confidence, atol=_SAME)
        assert (estimate.ambiguity, estimate.instance) == (want.ambiguity, want.instance)


@settings(deadline=None, max_examples=30)
@given(worlds())
def test_the_table_is_level_in_its_own_frame_and_that_is_one_frame(world):
    T = measure_level([frame.moved(world) for frame in current_frames()])
    # The world of the ray-cast scene is the table's own: its first camera looks along y, at the origin.
    np.testing.assert_allclose(invert(world) @ T, np.eye(4), atol=2e-6)


def test_without_a_table_the_world_is_taken_as_it_is():
    assert measure_level([dark_frame()]) is None
    assert pipeline().build_database([dark_frame()]).level.T_world_level.tolist() == np.eye(4).tolist()


def test_a_camera_that_looks_straight_down_has_a_frame_of_its_own():
    eye = make_transform(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 1.2]))
    frame = shoot(0, replace(camera(-90), T_world_camera=eye), NOW)
    world = make_transform(Rotation.from_euler("xy", [40, 20], degrees=True).as_matrix(), np.ones(3))
    T = measure_level([frame.moved(world)])
    np.testing.assert_allclose(invert(world) @ T, np.eye(4), atol=2e-6)


def test_database_and_estimates_are_in_the_users_world():
    world = make_transform(Rotation.from_euler("xyz", [70, 20, 10], degrees=True).as_matrix(), np.array([1, 2, 3]))
    goal = goal_frame().moved(world)
    database = pipeline().build_database([frame.moved(world) for frame in current_frames()])
    straight = pipeline().build_database(current_frames())
    for region, same in zip(database.regions, straight.regions, strict=True):
        np.testing.assert_allclose(region.points, transform_points(world, same.points), atol=1e-5)
    for estimate, same in zip(pipeline().estimate(database, goal), upright(), strict=True):
        seen = [
            project(view.K, invert(view.T_world_camera), one.move(one.correspondences.points))[0]
            for one, view in ((estimate, goal.camera), (same, goal_frame().camera))
        ]
        np.testing.assert_allclose(*seen, atol=0.2)
        np.testing.assert_allclose(estimate.correspondences.camera.T_world_camera, goal.camera.T_world_camera)


def test_a_saved_database_keeps_both_frames(tmp_path):
    world = make_transform(Rotation.from_euler("x", 30, degrees=True).as_matrix(), np.zeros(3))
    database = pipeline().build_database([frame.moved(world) for frame in current_frames()])
    database.save(tmp_path / "h.npz")
    loaded = Database.load(tmp_path / "h.npz")
    for a, b in zip(loaded.regions, database.regions, strict=True):
        assert a.points.tobytes() == b.points.tobytes()
    assert loaded.T_world_level.tobytes() == database.T_world_level.tobytes()
    joined = loaded.joined([[0, 1]])
    assert joined.instances.tolist() == joined.level.instances.tolist()
    assert set(joined.instances) == {0, 2}
