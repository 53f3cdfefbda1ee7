"""Pose estimates of one capture, scored into rows where the truth is known."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from toolkit.errors import ToolkitError
from toolkit.results.metrics import assign_goal_objects, counterparts, pose_error, symmetry_of
from toolkit.results.rows import Row
from toolkit.types import Capture, PoseEstimate, TrueObject


def score(
    capture: Capture,
    estimates: Sequence[PoseEstimate],
    *,
    cell: str = "",
    dataset: str = "",
    settings: Mapping[str, Any] | None = None,
    scene_id: int = 0,
    weights: Mapping[str, str] | None = None,
) -> list[Row]:
    """One row for every object of the goal; one that no estimate answers is a row of status `missed`.

    An object that is not in the current scene is right when it is given no motion, for whatever reason; a motion is a
    false alarm.

    Raises:
        ToolkitError: the capture has no truth, or its goal image no true masks.
    """
    if capture.truth is None or capture.goal.true_masks is None:
        raise ToolkitError(f"capture {capture.name} has no ground truth to score against")
    answers = assign_goal_objects([e.segment for e in estimates], capture.goal.true_masks)
    answered = {i: estimates[position] for i, position in answers.items()}
    motions = {i: e.T_goal_current for i, e in answered.items() if e.T_goal_current is not None}
    rows: list[Row] = []
    goal_only = capture.only_goal
    paired = counterparts(motions, capture.truth, capture.only_current, goal_only)
    for instance_id in sorted(paired):
        estimate, truth = answered.get(instance_id), paired[instance_id]
        model = capture.truth[instance_id].model if instance_id in capture.truth else goal_only[instance_id].model
        rows.append(
            Row(
                cell=cell,
                dataset=dataset,
                settings=dict(settings or {}),
                scene_id=scene_id,
                scene=capture.name,
                object=instance_id,
                object_name=model.name,
                in_current=truth is not None,
                weights=dict(weights or {}),
                symmetry=symmetry_of(model),
                **_answer_fields(estimate, truth),
            )
        )
    return rows


def _answer_fields(estimate: PoseEstimate | None, truth: TrueObject | None) -> dict[str, Any]:
    fields = _said(estimate)
    motion = None if estimate is None else estimate.T_goal_current
    if truth is None:
        right = motion is None
        fields |= {"success": right, "success_sym": right, "success_equivalent": right}
        return fields if right else {**fields, "reason": "it is not in the current scene, but was given a motion"}
    if motion is None:
        return fields
    error = pose_error(motion, truth)
    alike = estimate.equivalents if estimate is not None and estimate.equivalents is not None else ()
    return {
        **fields,
        "rotation_error_deg": error.rotation_error_deg,
        "translation_error_cm": error.translation_error_cm,
        "rotation_error_deg_sym": error.rotation_error_deg_sym,
        "translation_error_cm_sym": error.translation_error_cm_sym,
        "success": error.success,
        "success_sym": error.success_sym,
        "success_equivalent": error.success_sym or any(pose_error(T, truth).success_sym for T in alike),
    }


def _said(estimate: PoseEstimate | None) -> dict[str, Any]:
    """What the pipeline said of an object, whatever is true of it."""
    if estimate is None:
        return {"status": "missed", "stage": "segmenter", "reason": "no goal segment covers the object"}
    failure, motion = estimate.failure, estimate.T_goal_current
    return {
        "status": estimate.status,
        "stage": failure.stage if failure else None,
        "reason": failure.reason if failure else None,
        "T_goal_current": None if motion is None else motion.tolist(),
        "confidence": estimate.confidence,
        "ambiguity": estimate.ambiguity,
        "instance": estimate.instance,
        "matcher_calls": estimate.matcher_calls,
        "correspondences": 0 if estimate.correspondences is None else len(estimate.correspondences),
        "inliers": 0 if estimate.inliers is None else int(estimate.inliers.sum()),
        "time_ms": dict(estimate.time_ms),
        "cached": estimate.cached,
    }
