"""What every explainer must do."""

from __future__ import annotations

import numpy as np

from toolkit.geometry import transform_points
from toolkit.perception.database import Database
from toolkit.perception.explanation import ExplainTask, Explanation
from toolkit.perception.fusion import FusedModel, Models
from toolkit.plugin_kit.conformance.kit import Check, Subject, require, require_same_twice
from toolkit.plugin_kit.conformance.scene import current_frames, goal_frame, regions, segments_of, true_motion

_MOST_CM = 3.0


def answers_are_explanations_or_nothing(subject: Subject) -> str:
    """explain(): an Explanation, or None where the goal segmenter's masks are to stand."""
    explanation = subject.make().explain(_task())
    require(
        explanation is None or isinstance(explanation, Explanation),
        f"explain() must give an Explanation or None, got {type(explanation).__name__}",
    )
    if explanation is None:
        return "None"
    return f"{len(explanation.placements)} placed, {len(explanation.unknown)} unknown"


def every_instance_is_placed_once_at_most(subject: Subject) -> None:
    """Instances are of the database, none twice, and their segments are disjoint and as large as the image."""
    task = _task()
    explanation = subject.make().explain(task)
    if explanation is None:
        return
    placed = [placement.instance for placement in explanation.placements]
    require(len(set(placed)) == len(placed), f"an instance is placed twice: {placed}")
    require(set(placed) <= set(task.models.usable()), f"placed are {placed}, which are not all in the database")
    masks = [placement.segment.mask for placement in explanation.placements]
    size = task.goal.rgb.shape[:2]
    require(all(mask.shape == size for mask in masks), f"segments must be {size}")
    require(not masks or int(np.sum(masks, axis=0).max()) <= 1, "the segments of two placements overlap")


def what_it_trusts_is_right(subject: Subject) -> None:
    """A placement of trust 0.5 or more is within 3 cm of the truth; turns are the refiner's to tell."""
    task = _task()
    explanation = subject.make().explain(task)
    for placement in () if explanation is None else explanation.placements:
        if placement.trust < 0.5:
            continue
        model, truth = task.models.get(placement.instance), true_motion(placement.instance + 1)
        assert isinstance(model, FusedModel)
        gap = transform_points(placement.T_goal_current, model.center) - transform_points(truth, model.center)
        shift = 100 * float(np.linalg.norm(gap))
        require(shift < _MOST_CM, f"instance {placement.instance} is {shift:.1f} cm off, and trusted")


def nothing_in_the_current_scene_is_no_crash(subject: Subject) -> None:
    """A database without regions: whatever the goal shows is unknown."""
    empty = Database(current_frames(), (), np.zeros(0, np.int64), np.zeros((0, 1), np.float32))
    segments = tuple(segments_of(goal_frame()))
    explanation = subject.make().explain(ExplainTask(goal_frame(), segments, Models(empty)))
    require(explanation is None or not explanation.placements, "there is nothing to place")
    require(
        explanation is None or len(explanation.unknown) == len(segments), "every segment of the goal must be unknown"
    )


def the_same_input_gives_the_same_bytes(subject: Subject) -> None:
    """New instances agree, whatever the global random generators are at."""
    require_same_twice(lambda: subject.make().explain(_task()), "the explanation")


def _task() -> ExplainTask:
    found, instances = regions()
    database = Database(current_frames(), found, instances, np.zeros((len(found), 1), np.float32))
    return ExplainTask(goal_frame(), tuple(segments_of(goal_frame())), Models(database))


CHECKS: tuple[Check, ...] = (
    answers_are_explanations_or_nothing,
    every_instance_is_placed_once_at_most,
    what_it_trusts_is_right,
    nothing_in_the_current_scene_is_no_crash,
    the_same_input_gives_the_same_bytes,
)
