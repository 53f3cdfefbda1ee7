"""Pictures of correspondences, whatever the sizes of the images."""

from __future__ import annotations

import numpy as np
import pytest

from toolkit.pictures.drawing import INLIER, correspondences

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
