"""What `perch` makes of a goal image: moved, unmoved, missing and unknown objects, pieces that belong together."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from toolkit.geometry import make_transform
from toolkit.perception.database import Database
from toolkit.perception.explainers.searching.evidence import Evidence, with_known
from toolkit.perception.explainers.searching.scores import Sample, Scorer
from toolkit.perception.explainers.searching.trust import trust
from toolkit.perception.explanation import ExplainTask, Explanation
from toolkit.perception.fusion import Models, united
from toolkit.perception.regions import lift_segment
from toolkit.plugin_kit.conformance.raycast import NOW, THEN, Box, camera, shoot
from toolkit.stages import EXPLAINERS
from toolkit.types import Frame, Region, Segment


def ring(boxes: Sequence[Box]) -> list[Frame]:
    return [shoot(i, camera(-90 + 72 * i), boxes, print_contrast=0.5) for i in range(5)]


def goal_of(boxes: Sequence[Box]) -> Frame:
    return shoot(50, camera(-90), boxes, depth=False, print_contrast=0.5)


def models_of(frames: Sequence[Frame]) -> Models:
    """Instance i - 1 is object i."""
    lifted = [
        (lift_segment(frame, Segment(mask, instance=k - 1)), k - 1)
        for frame in frames
        for k, mask in (frame.true_masks or {}).items()
    ]
    regions = [(region, instance) for region, instance in lifted if isinstance(region, Region)]
    instances = np.array([instance for _, instance in regions], np.int64)
    return Models(
        Database(tuple(frames), tuple(r for r, _ in regions), instances, np.zeros((len(regions), 1), np.float32))
    )


def explain(now: Sequence[Box], then: Sequence[Box], segments: Sequence[Segment] = ()) -> tuple[Frame, Explanation]:
    goal = goal_of(then)
    explanation = EXPLAINERS.create("perch").explain(ExplainTask(goal, tuple(segments), models_of(ring(now))))
    assert explanation is not None
    return goal, explanation


def iou(a: np.ndarray, b: np.ndarray) -> float:
    return float((a & b).sum() / (a | b).sum())


def shifts(now: Sequence[Box], then: Sequence[Box]) -> list[np.ndarray]:
    return [
        make_transform(np.eye(3), np.subtract(there, here)) for (here, _), (there, _) in zip(now, then, strict=True)
    ]


def test_what_was_moved_is_found_where_it_stands() -> None:
    goal, explanation = explain(NOW, THEN)
    assert goal.true_masks is not None
    assert {p.instance for p in explanation.placements} == {0, 1, 2}
    for placement in explanation.placements:
        assert iou(placement.segment.mask, goal.true_masks[placement.instance + 1]) > 0.7
        here = np.append(NOW[placement.instance][0][:2], [0.02, 1])
        gap = (placement.T_goal_current - shifts(NOW, THEN)[placement.instance]) @ here
        assert np.linalg.norm(gap) < 0.02


def test_what_stands_still_is_told_so() -> None:
    _, explanation = explain(NOW, NOW)
    assert {p.instance for p in explanation.placements} == {0, 1, 2}
    for placement in explanation.placements:
        assert np.allclose(placement.T_goal_current, np.eye(4), atol=0.05)


def test_what_is_not_in_the_goal_is_not_placed() -> None:
    _, explanation = explain(NOW, [THEN[0], ((0.1, 0.1, -1.0), (0.1,) * 3), THEN[2]])
    assert {p.instance for p in explanation.placements} == {0, 2}


def test_what_no_model_explains_is_unknown() -> None:
    then: list[Box] = [*THEN, ((0.3, -0.3, 0), (0.09, 0.09, 0.09))]
    goal = goal_of(then)
    assert goal.true_masks is not None
    segments = [Segment(mask) for mask in goal.true_masks.values()]
    _, explanation = explain(NOW, then, segments)
    assert {p.instance for p in explanation.placements} == {0, 1, 2}
    assert [iou(s.mask, goal.true_masks[4]) > 0.9 for s in explanation.unknown] == [True]


def test_objects_that_overlap_in_the_image_part_where_their_models_say() -> None:
    then: list[Box] = [((0.0, 0.05, 0), NOW[0][1]), THEN[1], ((0.01, -0.05, 0), NOW[2][1])]
    goal, explanation = explain(NOW, then)
    assert goal.true_masks is not None
    found = {p.instance: p.segment.mask for p in explanation.placements}
    assert iou(found[0], goal.true_masks[1]) > 0.7 and iou(found[2], goal.true_masks[3]) > 0.7


def test_pieces_that_move_alike_are_one_object() -> None:
    shift = np.array([-0.25, 0.2, 0.0])
    now: list[Box] = [((0.1, 0.0, 0), (0.12, 0.06, 0.05)), ((0.1, 0.0, 0.05), (0.05, 0.05, 0.05))]
    then: list[Box] = [(tuple((base + shift).tolist()), size) for base, size in now]  # type: ignore[misc]
    _, explanation = explain(now, then)
    assert explanation.joined == ((0, 1),)
    (placement,) = explanation.placements
    assert np.linalg.norm((placement.T_goal_current - make_transform(np.eye(3), shift)) @ [0.1, 0, 0.05, 1]) < 0.02


def test_pieces_that_move_apart_are_two() -> None:
    now: list[Box] = [((0.1, 0.0, 0), (0.12, 0.06, 0.05)), ((0.19, 0.0, 0.0), (0.05, 0.05, 0.05))]
    then: list[Box] = [((-0.2, 0.1, 0), (0.12, 0.06, 0.05)), ((0.2, 0.2, 0.0), (0.05, 0.05, 0.05))]
    _, explanation = explain(now, then)
    assert explanation.joined == ()
    assert {p.instance for p in explanation.placements} == {0, 1}


def test_what_is_known_to_stand_in_front_hides_the_rest() -> None:
    sample = Sample(np.zeros((1, 3)), np.array([[0.0, 0.0, 1.0]]), np.zeros((1, 3)), np.ones(1))
    image = np.full((9, 9), 4.0, np.float32)
    free = np.full((9, 9), np.inf, np.float32)
    goal = Evidence(np.zeros((9, 9, 3), np.float32), image, free, np.array([[8.0, 0, 4], [0, 8, 4], [0, 0, 1]]), 1)
    above = make_transform(np.diag([1.0, -1, -1]), np.array([0, 0, 1.0]))

    def gain(evidence: Evidence) -> float:
        return float(Scorer(evidence, above).score(sample, np.zeros(1), np.zeros((1, 3)))[0])

    assert gain(goal) == pytest.approx(4.0)
    assert gain(with_known(goal, image, np.full((9, 9), 1.1))) == pytest.approx(4.0)
    assert gain(with_known(goal, image, np.full((9, 9), 0.9))) == 0.0
    assert gain(with_known(goal, np.full((9, 9), 0.5), free)) == pytest.approx(0.5)


def test_models_that_are_one_keep_their_points_and_views() -> None:
    one, other, _ = models_of(ring(NOW)).all()
    both = united([one, other])
    assert len(both.points) == len(one.points) + len(other.points) == len(both.seen_by)
    assert both.seen_by.shape[1] == len(one.patches) + len(other.patches) == len(both.patches)
    assert (both.seen_by.sum(axis=1) == np.concatenate([one.seen_by, other.seen_by], axis=0).sum(axis=1)).all()
    np.testing.assert_allclose(both.normals_at(np.arange(5)), one.normals_at(np.arange(5)), atol=1e-5)


@pytest.mark.parametrize("name", ["agreement", "visible", "alone", "lead", "whole"])
def test_better_evidence_is_trusted_more(name: str) -> None:
    _, explanation = explain(NOW, THEN)
    for placement in explanation.placements:
        judged = dict(placement.judged)
        assert all(0 <= value <= 1 for key, value in judged.items() if key != "lead")
        assert trust(judged | {name: 0.0}) <= trust(judged | {name: 1.0})
