"""Every segmenter on small ray-cast scenes whose masks are known exactly."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from toolkit.errors import ToolkitError
from toolkit.perception.segmenters.cutting.split import neck_cuts
from toolkit.perception.tabletop.appearance import render_table, scan_table
from toolkit.perception.tabletop.plane import pixel_rays
from toolkit.plugin_kit.conformance import raycast
from toolkit.plugin_kit.conformance.raycast import HEIGHT, NOW, THEN, WIDTH, Box, camera, shoot
from toolkit.stages import SEGMENTERS, Segmenter
from toolkit.types import Frame

NAMES = [name for name in SEGMENTERS.names() if name != "grounded_sam"]
"""What random weights cannot show is asked of these; grounded_sam has test_grounded_sam.py."""


def ring(boxes: Sequence[Box], noise: float = 0.0) -> list[Frame]:
    return [shoot(i, camera(-90 + 72 * i), boxes, noise) for i in range(5)]


def around(frame: Frame, boxes: Sequence[Box], noise: float = 0.0) -> list[Frame]:
    """The current frames, the image among them if it is one."""
    return [*ring(boxes, noise), *([] if frame.depth is None else [frame])]


def image_for(name: str, boxes: Sequence[Box], noise: float = 0.0) -> Frame:
    """What a segmenter is meant for: table_appearance a goal without depth, the others an RGB-D frame."""
    return shoot(50, camera(-90), boxes, noise, depth=name != "table_appearance")


def create(name: str) -> Segmenter:
    """The segmenter, or a skipped test where its weights cannot be fetched."""
    try:
        SEGMENTERS.get(name)().check_ready()
    except ToolkitError as error:
        if "cannot be fetched" not in str(error):
            raise
        pytest.skip(str(error))
    return SEGMENTERS.create(name)


def ious(frame: Frame, segments: Sequence) -> list[float]:
    """The best IoU of every true object."""
    assert frame.true_masks is not None
    found = [s.mask for s in segments]
    return [max((float((m & s).sum() / (m | s).sum()) for s in found), default=0) for m in frame.true_masks.values()]


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("noise", [0.0, 0.002])
def test_contract(name: str, noise: float) -> None:
    """Disjoint non-empty masks of the image's size, the true objects, the same twice."""
    frame = image_for(name, THEN, noise)
    current = around(frame, NOW if frame.depth is None else THEN, noise)
    segments = create(name).segment(frame, current)
    assert sum(s.mask.astype(int) for s in segments).max() == 1
    assert all(s.mask.shape == (HEIGHT, WIDTH) and s.mask.any() for s in segments)
    assert len(segments) == len(THEN)
    assert min(ious(frame, segments)) > 0.8
    again = create(name).segment(frame, current)
    assert all(np.array_equal(a.mask, b.mask) for a, b in zip(segments, again, strict=True))


@pytest.mark.parametrize("name", NAMES)
def test_empty_table_has_no_segment(name: str) -> None:
    frame = image_for(name, [])
    assert create(name).segment(frame, around(frame, [])) == []


def test_goal_without_object_has_no_segment() -> None:
    goal = image_for("table_appearance", [])
    assert create("table_appearance").segment(goal, ring(NOW)) == []


@pytest.mark.parametrize("name", NAMES)
def test_single_object(name: str) -> None:
    frame = image_for(name, THEN[:1])
    segments = create(name).segment(frame, around(frame, NOW[:1] if frame.depth is None else THEN[:1]))
    assert len(segments) == 1
    assert ious(frame, segments)[0] > 0.85


@pytest.mark.parametrize("name", ["depth_plane", "table_appearance"])
def test_no_depth_anywhere_is_a_users_mistake(name: str) -> None:
    blind = [Frame(f.index, f.rgb, f.camera, np.zeros((HEIGHT, WIDTH), np.float32)) for f in ring(NOW)]
    with pytest.raises(ToolkitError, match="depth"):
        create(name).segment(blind[0], blind)


def test_oracle_needs_truth() -> None:
    frame = Frame(0, np.zeros((HEIGHT, WIDTH, 3), np.uint8), camera(0))
    with pytest.raises(ToolkitError, match="true masks"):
        SEGMENTERS.create("oracle").segment(frame, [])


def test_what_lies_beside_the_table_is_no_object() -> None:
    beside: list[Box] = [*NOW, ((0.0, 0.75, 0.0), (0.2, 0.1, 0.1))]
    frame = shoot(0, camera(-90), beside)
    assert frame.true_masks is not None and frame.true_masks[4].sum() > 500
    segments = SEGMENTERS.create("depth_plane").segment(frame, [frame])
    assert len(segments) == 3
    assert not any((s.mask & frame.true_masks[4]).any() for s in segments)


def test_light_that_changes_is_not_an_object() -> None:
    goal = image_for("table_appearance", THEN)
    slope = np.linspace(0.75, 1.1, WIDTH)[None, :, None]
    lit = Frame(goal.index, (goal.rgb * slope).clip(0, 255).astype(np.uint8), goal.camera, None, goal.true_masks)
    segments = SEGMENTERS.create("table_appearance").segment(lit, ring(NOW))
    assert len(segments) == len(THEN)
    assert min(ious(goal, segments)) > 0.8


def in_shadow(frame: Frame, strength: float) -> Frame:
    """The frame with a soft-edged disc of the table, 24 cm across, in a shadow that nothing in sight casts."""
    T = frame.camera.T_world_camera
    rays = pixel_rays(frame).astype(np.float64) @ T[:3, :3].T
    ground = T[:3, 3] - T[2, 3] / rays[..., 2:] * rays
    distance = np.hypot(ground[..., 0] + 0.25, ground[..., 1] - 0.25)
    shade = 1 - strength * ((0.125 - distance) / 0.01).clip(0, 1)
    assert frame.true_masks is not None
    on_object = np.any([np.zeros((HEIGHT, WIDTH), bool), *frame.true_masks.values()], axis=0)
    shade[on_object] = 1
    rgb = np.rint(frame.rgb * shade[..., None]).astype(np.uint8)
    return Frame(frame.index, rgb, frame.camera, frame.depth, frame.true_masks)


@pytest.mark.parametrize("name", ["table_appearance"])
@pytest.mark.parametrize("strength", [0.15, 0.35])
@pytest.mark.parametrize("where", ["current", "goal"])
def test_a_shadow_is_not_an_object(name: str, strength: float, where: str) -> None:
    current, goal = ring(NOW), image_for(name, THEN)
    if where == "goal":
        goal = in_shadow(goal, strength)
    else:
        current = [in_shadow(frame, strength) for frame in current]
    segments = create(name).segment(goal, current)
    assert len(segments) == len(THEN)
    assert min(ious(goal, segments)) > 0.8


def test_an_object_of_the_tables_colour_is_no_shadow(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(raycast, "COLOURS", np.array([[119, 98, 70], [40, 60, 190], [136, 112, 80]], np.uint8))
    goal = image_for("table_appearance", THEN)
    segments = SEGMENTERS.create("table_appearance").segment(goal, ring(NOW))
    assert len(segments) == len(THEN)
    assert min(ious(goal, segments)) > 0.7


def test_touching_objects_are_split_by_what_the_current_scene_knows() -> None:
    touching: list[Box] = [
        ((-0.04, 0, 0), (0.08, 0.12, 0.1)),
        ((0.1, -0.3, 0), (0.2, 0.03, 0.01)),
        ((0.035, 0, 0), (0.07,) * 3),
    ]
    goal = image_for("table_appearance", touching)
    apart = SEGMENTERS.create("table_appearance").segment(goal, ring(NOW))
    together = SEGMENTERS.create("table_appearance", {"split": False}).segment(goal, ring(NOW))
    assert (len(together), len(apart)) == (2, 3)
    assert min(ious(goal, apart)) > 0.8


def test_a_segmenter_of_current_frames_refuses_a_goal() -> None:
    with pytest.raises(ToolkitError, match="goal_segmenter"):
        SEGMENTERS.create("multiview").segment(image_for("table_appearance", THEN), ring(NOW))


def test_the_map_shows_the_empty_table() -> None:
    view = render_table(scan_table(ring(NOW)), camera(-60))
    empty = shoot(0, camera(-60), [])
    assert view.seen.mean() > 0.5
    assert np.abs(view.rgb.astype(int) - empty.rgb)[view.seen].mean() < 2
    assert ((view.table == (empty.depth > 0)).mean()) > 0.99


def test_a_neck_parts_two_discs() -> None:
    y, x = np.mgrid[:80, :120]
    left, right = (x - 40) ** 2 + (y - 40) ** 2 < 22**2, (x - 78) ** 2 + (y - 40) ** 2 < 20**2
    parts = list(neck_cuts(left | right))
    assert max(float((p & right).sum() / (p | right).sum()) for p in parts) > 0.9
    assert list(neck_cuts(left)) == []


def test_own_masks_are_given_back_and_followed_where_their_numbers_say_so() -> None:
    frame = ring(NOW)[0]
    loose, named = (SEGMENTERS.create("masks", {"instances": on}).segment(frame, []) for on in (False, True))
    assert [s.instance for s in loose] == [None] * 3 and [s.instance for s in named] == [1, 2, 3]
    assert frame.own_masks is not None
    for segments in (loose, named):
        np.testing.assert_array_equal([s.mask for s in segments], list(frame.own_masks.values()))


def test_without_own_masks_a_sentence_says_where_they_belong() -> None:
    with pytest.raises(ToolkitError, match=r"frame 0 has none; put them into mask_visib/"):
        SEGMENTERS.create("masks").segment(replace(ring(NOW)[0], own_masks=None), [])
