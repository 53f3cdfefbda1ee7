"""Pictures of correspondences, whatever the sizes of the images."""

from __future__ import annotations

import numpy as np
import pytest

from toolkit.pictures.drawing import INLIER, OUTLIER, correspondences, overlay, with_legend, zoomed
from toolkit.types import Camera, Frame

SIZES = {"as large": (480, 640), "half": (240, 320), "portrait": (1920, 1080), "odd": (333, 101), "tiny": (2, 3)}


@pytest.mark.parametrize("goal", SIZES)
@pytest.mark.parametrize("frames", [["as large"], ["half", "portrait"], ["odd", "as large", "tiny", "half"]])
def test_images_of_any_size_stand_side_by_side(goal, frames):
    images = {i: np.full((*SIZES[size], 3), 60 + i, np.uint8) for i, size in enumerate(frames)}
    frame_of = np.repeat(np.arange(len(frames)), 2)
    height, width = SIZES[goal]
    xy = np.zeros((len(frame_of), 2))
    picture = correspondences(
        np.full((height, width, 3), 50, np.uint8), xy, images, frame_of, xy, np.ones(len(frame_of), bool)
    )
    assert picture.shape[0] == height and picture.shape[1] > width


def test_a_line_ends_where_its_pixel_is_after_scaling():
    goal, frame = np.zeros((400, 300, 3), np.uint8), np.zeros((200, 100, 3), np.uint8)
    picture = correspondences(
        goal, np.array([[150.0, 200.0]]), {0: frame}, np.zeros(1, int), np.array([[50.0, 150.0]]), np.ones(1, bool)
    )
    drawn = np.argwhere(picture[:, 300:, 1] > INLIER[1] // 2)
    # Twice as large, at the right of the goal; the circle around the end is two pixels wide.
    assert np.abs(drawn - [300.5, 100.5]).max(axis=1).min() <= 2 and (drawn[:, 1] < 104).all()


@pytest.mark.parametrize("factor", [2, 3])
def test_labels_are_as_large_a_part_of_a_large_picture(factor):
    def written(scale):
        width, height = 640 * scale, 480 * scale
        K = np.array([[600.0 * scale, 0, width / 2], [0, 600.0 * scale, height / 2], [0, 0, 1]])
        goal = Frame(0, np.zeros((height, width, 3), np.uint8), Camera(K, np.eye(4), width, height))
        mask = np.zeros((height, width), bool)
        mask[200 * scale : 280 * scale, 280 * scale : 360 * scale] = True
        picture = overlay(goal, [], [("3: #1 withheld", mask, (255, 0, 0))])
        # What is drawn above the object is its label.
        return np.ptp(np.argwhere(picture[: 198 * scale].any(axis=2)), axis=0)

    np.testing.assert_allclose(written(factor) / factor, written(1), rtol=0.1)


PLATE = (24, 24, 28)
"""What labels stand on."""


def outlined(*places):
    """The goal image with a square of 12 px at each place (x, y), in its colour; the first has no label."""
    goal = Frame(0, np.zeros((240, 320, 3), np.uint8), Camera(np.diag([300.0, 300, 1]), np.eye(4), 320, 240))
    squares = []
    for i, (x, y) in enumerate(places):
        mask = np.zeros((240, 320), bool)
        mask[y : y + 12, x : x + 12] = True
        squares.append((f"{i}: unknown" * (i > 0), mask, (255 - i, 0, 0)))
    return overlay(goal, [], squares)


@pytest.mark.parametrize("neighbour", [(160, 80), (160, 128), (130, 80)])
def test_a_label_covers_neither_its_neighbours_nor_what_it_names(neighbour):
    picture = outlined(neighbour, (160, 104))
    for x, y in (neighbour, (160, 104)):
        assert not (picture[y : y + 12, x : x + 12] == PLATE).all(axis=2).any()


def test_labels_of_things_in_a_heap_do_not_cover_each_other():
    picture = outlined((20, 20), *((150 + 3 * i, 100 + 2 * i) for i in range(5)))
    one, all_of_them = ((p == PLATE).all(axis=2).sum() for p in (outlined((20, 20), (150, 100)), picture))
    assert all_of_them > 0.9 * 5 * one


@pytest.mark.parametrize("size", [(240, 320), (1080, 1920), (1920, 1080)])
def test_a_long_sentence_is_folded_beneath_a_picture(size):
    picture = np.zeros((*size, 3), np.uint8)
    sentence = " ".join(["the current frames contradict each other"] * 4)
    lines = [with_legend(picture, [(text, (255, 255, 255))])[size[0] :] for text in ("one", sentence)]
    assert lines[1].shape[0] > lines[0].shape[0]
    # Nothing is cut: the last columns stay empty.
    assert (lines[1][:, -4:] == lines[1][0, 0]).all()


def test_zooming_in_keeps_points_on_what_they_mark():
    picture = np.zeros((240, 320, 3), np.uint8)
    xy = np.array([[200.0, 100.0], [220.0, 112.0]])
    picture[100, 200] = picture[112, 220] = 255
    larger, moved = zoomed(picture, xy)
    assert larger.shape == picture.shape and np.linalg.norm(moved[1] - moved[0]) > 4 * np.linalg.norm(xy[1] - xy[0])
    assert all(larger[y, x, 0] > 128 for x, y in np.rint(moved).astype(int))


def test_without_a_pose_no_match_is_an_inlier():
    blank = np.zeros((100, 100, 3), np.uint8)
    xy = np.array([[60.0, 60.0]])
    picture = correspondences(blank, xy, {0: blank}, np.zeros(1, int), xy, None)
    assert (picture[..., 0] == OUTLIER[0]).any() and not (picture == INLIER).all(axis=2).any()
