"""Pictures of rearranged scenes: what is right is green, what is wrong red, and white where it belongs."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from made_rows import make_move_rows

from toolkit.data.objects import load_object_set
from toolkit.data.tabletop import TabletopConfig, draw_scene
from toolkit.pictures.rearranged import rearranged_picture, write_scene
from toolkit.types import Camera, Frame

GREEN, RED, WHITE = (40, 200, 90), (240, 80, 60), (225, 225, 225)


def frame(places):
    """A black frame of 240x320 with a square mask around every (x, y)."""
    masks = {number: np.zeros((240, 320), bool) for number in places}
    for number, (x, y) in places.items():
        masks[number][y - 12 : y + 12, x - 12 : x + 12] = True
    camera = Camera(np.array([[300.0, 0, 160], [0, 300, 120], [0, 0, 1]]), np.eye(4), 320, 240)
    return Frame(0, np.zeros((240, 320, 3), np.uint8), camera, None, masks)


def near(picture, color, x, y):
    """Whether the outline of a square at a pixel of the large picture, which begins at column 160, has a colour."""
    around = picture[y - 14 : y + 14, 160 + x - 14 : 160 + x + 14]
    return bool((around == color).all(axis=2).any())


def covered(one, other, color):
    """Share of the pixels of about a colour in one picture that are beside such ones in another."""
    like = [(np.abs(picture - color).max(axis=2) < 50).astype(np.uint8) for picture in (one, other)]
    return cv2.dilate(like[1], np.ones((7, 7), np.uint8))[like[0] == 1].mean()


def test_right_is_green_and_wrong_is_red_with_its_true_place_in_white():
    rows = [row.model_copy(update={"object_name": ""}) for row in make_move_rows("a", 1.0)[:2]]
    rows[1] = rows[1].model_copy(update={"success_sym": False})
    goal, before = frame({0: (60, 60), 1: (200, 60)}), frame({0: (60, 200), 1: (200, 200)})
    after = frame({0: (60, 60), 1: (200, 150)})
    picture = rearranged_picture(goal, before, after, rows)
    assert picture.shape[1] == 160 + 320 and picture.shape[0] > 240
    assert near(picture, GREEN, 60, 60) and not near(picture, WHITE, 60, 60)
    assert near(picture, RED, 200, 150) and near(picture, WHITE, 200, 60)
    # An object that nobody sees any more is not drawn; where it belongs is.
    gone = rearranged_picture(goal, before, replace(after, true_masks={0: after.true_masks[0]}), rows)
    assert not near(gone, RED, 200, 150) and near(gone, WHITE, 200, 60)


@pytest.mark.parametrize("track", ["clean", "d435"])
def test_a_scene_is_shown_as_it_ended(track, cache, tmp_path):
    config = TabletopConfig(
        track=track, scenes=1, min_objects=2, max_objects=2, views=1, renderer="tiny", supersample=1, seed=3
    )
    scene = draw_scene(config, load_object_set("procedural", cache), 0, cache)
    done, undone = (dict(enumerate(T.tolist() for T in poses)) for poses in (scene.goal, scene.current))
    for ended, right in ((done, True), (undone, False)):
        rows = [
            row.model_copy(update={"ended": ended, "success_sym": right, "object_name": f"thing {row.object}"})
            for row in make_move_rows("a", 1.0)[:2]
        ]
        write_scene(tmp_path, scene, rows, cache)
        caption = (tmp_path / "pictures" / "000000.txt").read_text()
        assert caption.startswith("Scene 0, right: thing 0, thing 1 (a)" if right else "Scene 0, wrong: thing 0 (")
        picture = cv2.imread(str(tmp_path / "pictures" / "000000.png"))[..., ::-1].astype(float)
        after = cv2.resize(picture[:480, 320:], (320, 240), interpolation=cv2.INTER_AREA)
        goal, before = picture[:240, :320], picture[240:480, :320]
        color = GREEN if right else RED
        stayed, came = covered(before, after, color), covered(goal, after, color)
        assert max(stayed, came) > 0.9 and min(stayed, came) < 0.6 and (came > stayed) == right
