"""What every refiner must do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from toolkit.geometry import invert, rotation_angle, transform_points
from toolkit.perception.fusion import RefineTask, Start
from toolkit.plugin_kit.conformance.kit import Check, Subject, require, require_array, require_same_twice
from toolkit.plugin_kit.conformance.raycast import HEIGHT, WIDTH
from toolkit.plugin_kit.conformance.scene import refine_task, true_motion
from toolkit.types import Failure, Float, Refined, Segment

_OBJECTS = (1, 3)


def answers_are_motions_failures_or_nothing(subject: Subject) -> str:
    """refine(): Refined, Failure with stage and reason, or None; verify(): a finite number or None."""
    answers: list[str] = []
    for object_id in _OBJECTS:
        for starts in ((), _true_start(object_id)):
            task = refine_task(object_id, starts)
            answer = subject.make().refine(task)
            _require_answer(answer)
            answers.append("None" if answer is None else type(answer).__name__)
            score = subject.make().verify(task)
            require(score is None or np.isfinite(score), f"verify() must give a finite number or None, got {score}")
    return ", ".join(dict.fromkeys(answers))


def what_it_is_sure_of_is_right(subject: Subject) -> None:
    """Started at the truth, an answer of confidence 0.5 or more is within 5 deg and 2 cm (metres)."""
    for object_id in _OBJECTS:
        task = refine_task(object_id, _true_start(object_id))
        answer = subject.make().refine(task)
        if isinstance(answer, Refined) and answer.confidence >= 0.5:
            turn, shift = _off(answer.T_goal_current, object_id, task)
            require(turn < 5 and shift < 2, f"a true start is moved by {turn:.1f} deg and {shift:.1f} cm, and believed")


def the_answer_is_the_first_of_its_equivalents(subject: Subject) -> None:
    """(E, 4, 4) equivalents, the first the motion itself; a symmetric (6, 6) covariance."""
    for object_id in _OBJECTS:
        answer = subject.make().refine(refine_task(object_id, _true_start(object_id)))
        if isinstance(answer, Refined):
            require_array(answer.equivalents, (None, 4, 4), np.float64, "the equivalents")
            require(
                np.allclose(answer.equivalents[0], answer.T_goal_current), "the first equivalent must be the motion"
            )
            covariance = answer.covariance
            require(covariance.shape == (6, 6), f"the covariance must be (6, 6), got {covariance.shape}")
            require(np.allclose(covariance, covariance.T), "the covariance must be symmetric")


def one_pixel_is_no_crash(subject: Subject) -> None:
    """An object of which the goal image shows one pixel."""
    mask = np.zeros((HEIGHT, WIDTH), bool)
    mask[HEIGHT // 2, WIDTH // 2] = True
    task = replace(refine_task(1), segment=Segment(mask))
    _require_answer(subject.make().refine(task))


def the_same_input_gives_the_same_bytes(subject: Subject) -> None:
    """New instances agree, whatever the global random generators are at."""
    require_same_twice(lambda: subject.make().refine(refine_task(1, _true_start(1))), "the answer")


def _true_start(object_id: int) -> tuple[Start, ...]:
    return (Start(true_motion(object_id)),)


def _off(T: Float, object_id: int, task: RefineTask) -> tuple[float, float]:
    """How far a motion is from the truth, deg and cm, at the object's centre."""
    model = task.models.get(task.instance)
    require(not isinstance(model, Failure), "the scene's boxes have models")
    assert not isinstance(model, Failure)
    truth = true_motion(object_id)
    shift = transform_points(T, model.center) - transform_points(truth, model.center)
    return float(np.degrees(rotation_angle((T @ invert(truth))[:3, :3]))), 100 * float(np.linalg.norm(shift))


def _require_answer(answer: object) -> None:
    fits = answer is None or isinstance(answer, Refined | Failure)
    require(fits, f"refine() must give Refined, Failure or None, got {type(answer).__name__}")
    if isinstance(answer, Failure):
        require(answer.stage == "refiner" and answer.reason, "a Failure must name stage 'refiner' and a reason")


CHECKS: tuple[Check, ...] = (
    answers_are_motions_failures_or_nothing,
    what_it_is_sure_of_is_right,
    the_answer_is_the_first_of_its_equivalents,
    one_pixel_is_no_crash,
    the_same_input_gives_the_same_bytes,
)
