"""Objects of which one side has been seen: the view that shows the other is worth most, unless something hides it."""

from types import SimpleNamespace

import numpy as np
import pytest
from toolkit_active_view import ActiveViewConfig, doubt, gains, look_actively, shown, visible_share

from toolkit.errors import ToolkitError
from toolkit.geometry import invert, look_at, observation_vector, project
from toolkit.perception.database import Database
from toolkit.types import Camera, Failure, Frame, PoseEstimate, Region, Segment

SIZE = 160
RING = 8
K = np.array([[150.0, 0, 79.5], [0, 150.0, 79.5], [0, 0, 1]])


def camera(number):
    """One of eight around the table; the first is where the goal is seen from."""
    azimuth = 2 * np.pi * number / RING - np.pi / 2
    return Camera(K, look_at(np.array([0.7 * np.cos(azimuth), 0.7 * np.sin(azimuth), 0.7]), np.zeros(3)), SIZE, SIZE)


CAMERAS = [camera(number) for number in range(RING)]


def ball(x, y, radius=0.05):
    """(400, 3) points of a sphere on the table."""
    rng = np.random.default_rng(0)
    directions = rng.normal(size=(400, 3))
    return radius * directions / np.linalg.norm(directions, axis=1, keepdims=True) + [x, y, radius]


def mask_of(seen_from, points):
    pixels, _ = project(seen_from.K, invert(seen_from.T_world_camera), points)
    x, y = np.clip(np.rint(pixels).astype(int), 0, SIZE - 1).T
    mask = np.zeros((SIZE, SIZE), bool)
    mask[y, x] = True
    return mask


def frame(number, *, depth=True):
    image = np.zeros((SIZE, SIZE, 3), np.uint8)
    return Frame(number, image, CAMERAS[number], np.ones((SIZE, SIZE), np.float32) if depth else None)


GOAL = frame(0, depth=False)


def database(objects, views):
    """Every object seen in every one of the views."""
    regions, instances = [], []
    for view in views:
        for instance, points in enumerate(objects):
            T = CAMERAS[view].T_world_camera
            # Which pixels the points come from makes no difference here.
            pixels = np.stack([np.arange(len(points)) % SIZE, np.arange(len(points)) // SIZE], axis=1).astype(np.int32)
            segment = Segment(np.ones((SIZE, SIZE), bool))
            regions.append(
                Region(
                    view, segment, points.astype(np.float32), pixels, observation_vector(T, points.astype(np.float32))
                )
            )
            instances.append(instance)
    frames = tuple(frame(view) for view in views)
    return Database(frames, tuple(regions), np.array(instances), np.ones((len(regions), 1), np.float32))


def estimate(number, points, confidence, instance=None):
    segment = Segment(mask_of(CAMERAS[0], points))
    if confidence is None:
        return PoseEstimate(number, segment, instance, None, Failure("refiner", "not found"))
    return PoseEstimate(number, segment, instance, np.eye(4), confidence=confidence)


def test_the_other_side_is_worth_most():
    points = ball(0, 0)
    known = database([points], [0])
    expected = gains(known, GOAL, [estimate(0, points, 0.2, 0)], CAMERAS)
    assert expected.argmax() == 4 and expected[0] == pytest.approx(0, abs=1e-6)
    np.testing.assert_allclose(expected[1:4], expected[:4:-1], rtol=0.05)
    assert expected[1] < expected[2] < expected[3] < expected[4]


def test_what_has_been_seen_adds_nothing():
    points = ball(0, 0)
    known = database([points], [0, 4])
    expected = gains(known, GOAL, [estimate(0, points, 0.2, 0)], CAMERAS)
    assert expected[[0, 4]] == pytest.approx(0, abs=1e-6)
    assert expected.argmax() in (2, 6)


def test_gain_is_in_proportion_to_doubt():
    points = ball(0, 0)
    known = database([points], [0])
    some, all_of_it = (gains(known, GOAL, [estimate(0, points, sure, 0)], CAMERAS) for sure in (0.75, None))
    np.testing.assert_allclose(4 * some, all_of_it)
    assert gains(known, GOAL, [estimate(0, points, 1.0, 0)], CAMERAS).max() == 0


def test_the_view_follows_the_object_in_doubt():
    """The first object has been seen from behind as well; the second has not."""
    left, right = ball(-0.2, 0), ball(0.2, 0)
    both, one = database([left, right], [0]), database([left], [4])
    known = Database(
        (*both.frames, *one.frames),
        (*both.regions, *one.regions),
        np.array([0, 1, 0]),
        np.ones((3, 1), np.float32),
    )
    doubted = [estimate(0, left, 0.9, 0), estimate(1, right, 0.1, 1)]
    assert gains(known, GOAL, doubted, CAMERAS).argmax() in (3, 4, 5)
    doubted = [estimate(0, left, 0.1, 0), estimate(1, right, 1.0, 1)]
    assert gains(known, GOAL, doubted, CAMERAS).argmax() in (1, 2, 6, 7)


def test_a_view_that_something_blocks_is_worth_less():
    points, wall = ball(0, 0), ball(0, 0.2, 0.15)
    free = gains(database([points], [0]), GOAL, [estimate(0, points, None, 0)], CAMERAS)
    blocked = gains(database([points, wall], [0]), GOAL, [estimate(0, points, None, 0)], CAMERAS)
    assert blocked[4] < 0.2 * free[4] and blocked[2] > 0.9 * free[2]


def test_what_is_out_of_the_picture_is_not_visible():
    assert visible_share(CAMERAS[0], ball(0, 0), []) == 1.0
    assert visible_share(CAMERAS[0], ball(2, 0), []) == 0.0


def test_an_object_never_seen_is_looked_for_from_elsewhere():
    points = ball(0, 0)
    expected = gains(database([points], [0]), GOAL, [estimate(0, points, None)], CAMERAS)
    assert expected.argmax() == 4


def test_shown_is_the_best_view_s_foreshortening():
    sides = np.array([[1.0, 0, 0], [0, 1, 0], [-1, 0, 0]])
    views = np.array([[0.6, 0.8, 0], [1, 0, 0]])
    np.testing.assert_allclose(shown(sides, views), [1, 0.8, 0])
    np.testing.assert_allclose(shown(sides, np.zeros((0, 3))), 0)


def test_a_motion_without_confidence_is_a_users_mistake():
    with pytest.raises(ToolkitError, match="confidence"):
        doubt(PoseEstimate(0, Segment(np.ones((2, 2), bool)), 0, np.eye(4)))


class KnownPipeline:
    """Sure of an object once it has been seen from behind."""

    def __init__(self, points):
        self.points = points

    def build_database(self, frames):
        return database([self.points], [frame.index for frame in frames])

    def scene(self, seen):
        behind = any(region.frame_index in (3, 4, 5) for region in seen.regions)
        return SimpleNamespace(
            database=seen, estimate=lambda goal: [estimate(0, self.points, 0.95 if behind else 0.3, 0)]
        )


def test_looking_ends_when_all_is_sure_or_the_budget_is_spent():
    pipeline = KnownPipeline(ball(0, 0))
    looked = look_actively(pipeline, frame, GOAL, CAMERAS)
    assert looked.order == (0, 4) and [f.index for f in looked.frames] == [0, 4]
    assert looked.estimates[0].confidence == 0.95
    assert look_actively(pipeline, frame, GOAL, CAMERAS, settings=ActiveViewConfig(budget=1)).order == (0,)
    every = look_actively(pipeline, frame, GOAL, CAMERAS, settings=ActiveViewConfig(sure=0.99)).order
    assert sorted(every) == list(range(RING))
