"""The kit's checks, and graphs of which the right pairing is known."""

import gc

import numpy as np
import pytest
from toolkit_nerp_scene_graph import (
    NerpSceneGraph,
    NerpSceneGraphConfig,
    Pairs,
    compare_silhouettes,
    match,
    softassign,
)

from toolkit.errors import ToolkitError
from toolkit.geometry import invert, look_at, project, rotation_z
from toolkit.perception.assignment import contenders, instance_similarity
from toolkit.perception.fusion import FusedModel, RefineTask
from toolkit.plugin_kit.conformance import Conforms
from toolkit.plugin_kit.conformance.scene import crops, goal_frame, refine_task, segments_of
from toolkit.stages import DESCRIPTORS
from toolkit.types import Camera, Frame, Segment

SIZE = 240
GRAPH = NerpSceneGraphConfig(base="none")


class TestNerpSceneGraph(Conforms):
    plugin = NerpSceneGraph


def box(width, depth, height):
    """(N, 3) points of a box's surface, resting on the table."""
    grid = np.stack(np.meshgrid(*[np.linspace(-1, 1, 21)] * 3), axis=-1).reshape(-1, 3)
    surface = grid[np.abs(grid).max(axis=1) == 1]
    return (surface * [width, depth, height] / 2 + [0, 0, height / 2]).astype(np.float32)


def model(points):
    colors = np.full((len(points), 3), 128, np.float32)
    return FusedModel(points, colors, np.ones((len(points), 1), bool), ())


def shot(points, eye=(0.0, -0.7, 0.7), target=(0.0, 0.0, 0.0)):
    """A frame without depth, and the mask of the points in it."""
    K = np.array([[300.0, 0, SIZE / 2], [0, 300.0, SIZE / 2], [0, 0, 1]])
    camera = Camera(K, look_at(np.array(eye), np.array(target)), SIZE, SIZE)
    pixels, _ = project(K, invert(camera.T_world_camera), points)
    x, y = np.rint(pixels).astype(int).T
    mask = np.zeros((SIZE, SIZE), bool)
    mask[y, x] = True
    return Frame(0, np.zeros((SIZE, SIZE, 3), np.uint8), camera), Segment(mask)


def moved(points, yaw, x, y):
    return points @ rotation_z(yaw)[:3, :3].T + [x, y, 0]


def test_the_same_box_fits_wherever_it_was_put():
    book, can = box(0.16, 0.10, 0.03), box(0.05, 0.05, 0.18)
    for yaw, x, y in ((0.4, 0.15, 0.1), (2.0, -0.2, -0.1)):
        goal, segment = shot(moved(book, yaw, x, y))
        fit, size = compare_silhouettes(goal, [segment], [model(book), model(can)], yaws=36)
        assert fit[0, 0] < 0.05 and fit[0, 1] > 0.15
        assert abs(size[0, 0]) < 0.03


def test_a_size_is_told_by_one_image():
    small, large = box(0.10, 0.06, 0.06), box(0.15, 0.09, 0.09)
    goal, segment = shot(moved(small, 0.7, 0.1, 0.0))
    fit, size = compare_silhouettes(goal, [segment], [model(small), model(large)], yaws=36)
    assert fit[0, 0] < 0.03 < 0.3 < fit[0, 1]
    assert size[0, 1] == pytest.approx(np.log(1 / 1.5), abs=0.05)


def test_an_object_above_the_horizon_fits_nothing():
    high = box(0.1, 0.1, 0.1) + np.array([0, 1.0, 1.5], np.float32)
    goal, segment = shot(high, eye=(0.0, -0.7, 0.7), target=(0.0, 1.0, 1.5))
    fit, size = compare_silhouettes(goal, [segment], [model(box(0.1, 0.1, 0.1))], yaws=36)
    assert np.isinf(fit).all() and (size == 0).all()
    assert np.isfinite(match(Pairs(np.ones((1, 1)), fit, np.zeros((1, 1, 4))))).all()


def in_another_light(likeness_weight):
    """Four objects in shades of grey under a light that makes each look like the next brighter one."""
    now = 10.0 * np.arange(4)
    change = np.zeros((4, 4, 4))
    change[..., 1] = (now + 10)[:, None] - now[None]
    likeness = 1 - likeness_weight * (1 - np.exp(-0.5 * (change[..., 1] / 10) ** 2))
    return Pairs(likeness, np.zeros((4, 4)), change)


def test_edges_see_through_a_change_of_light():
    pairs = in_another_light(0.4)
    alone = match(pairs, GRAPH.model_copy(update={"rounds": 0}))
    together = match(pairs, GRAPH)
    assert (alone.argmax(axis=1)[:3] == [1, 2, 3]).all()
    assert (together.argmax(axis=1) == np.arange(4)).all()


def test_what_only_the_nodes_tell_is_kept():
    likeness = np.where(np.eye(3, dtype=bool), 0.9, 0.6)
    beliefs = match(Pairs(likeness, np.zeros((3, 3)), np.zeros((3, 3, 4))))
    assert (beliefs.argmax(axis=1) == np.arange(3)).all()


@pytest.mark.parametrize("shape", [(1, 1), (3, 3), (2, 5), (5, 2)])
def test_no_instance_is_believed_to_be_two_objects(shape):
    beliefs = softassign(np.random.default_rng(0).normal(0, 5, shape))
    assert beliefs.min() >= 0
    assert beliefs.sum(axis=0).max() < 1.01 and beliefs.sum(axis=1).max() < 1.01
    assert beliefs.sum(axis=int(shape[0] <= shape[1])).min() > 0.99


def test_the_order_of_objects_and_instances_does_not_matter():
    pairs, order, other = in_another_light(0.4), [2, 0, 3, 1], [1, 3, 0, 2]
    shuffled = Pairs(*(values[order][:, other] for values in (pairs.likeness, pairs.fit, pairs.change)))
    np.testing.assert_allclose(match(shuffled), match(pairs)[order][:, other], atol=1e-9)


def test_every_box_of_the_little_scene_is_believed_to_be_itself():
    plugin, segments = NerpSceneGraph(GRAPH), segments_of(goal_frame())
    models = refine_task(1).models
    beliefs = np.zeros((3, 3))
    for number, instance in np.ndindex(3, 3):
        task = RefineTask.of(goal_frame(), segments, number, instance, models)
        beliefs[number, instance] = plugin.verify(task)
    assert (beliefs.argmax(axis=1) == np.arange(3)).all() and np.diag(beliefs).min() > 0.5


def test_another_goal_is_matched_anew_and_nothing_is_kept_alive():
    plugin, task = NerpSceneGraph(GRAPH), refine_task(1)
    goal = task.goal
    before = plugin.verify(task)
    for _ in range(2):
        dark = Frame(goal.index, np.zeros_like(goal.rgb), goal.camera)
        other = RefineTask(dark, task.segment, task.others, task.instance, task.models)
        assert plugin.verify(other) != before
        del dark, other
        gc.collect()
    assert plugin.verify(task) == before
    assert len(plugin._known[task.models]) == 1


def test_motions_are_the_base_s():
    assert NerpSceneGraph(GRAPH).refine(refine_task(1)) is None
    with pytest.raises(ToolkitError, match="another"):
        NerpSceneGraph(NerpSceneGraphConfig(base="nerp_scene_graph"))


def test_a_descriptor_that_says_next_to_nothing_leaves_every_pair_to_the_graph():
    blind = DESCRIPTORS.create("color_hist", {"bins": 2, "smooth": 4.0})
    rows = blind.describe(crops(blind.crop_size))
    scores = instance_similarity(rows @ rows.T, np.tile(np.arange(3), 2))
    assert contenders(scores).all() and np.ptp(scores) < 1e-3
