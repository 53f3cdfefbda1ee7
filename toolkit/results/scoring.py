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
    """One row for every true object; one that no estimate answers is a row of status `missed`.

    Raises:
        ToolkitError: the capture has no truth, or its goal image no true masks.
    """
    if capture.truth is None or capture.goal.true_masks is None:
        raise ToolkitError(f"capture {capture.name} has no ground truth to score against")
    answers = assign_goal_objects([e.segment for e in estimates], capture.goal.true_masks)
    answered = {i: estimates[position] for i, position in answers.items()}
    motions = {i: e.T_goal_current for i, e in answered.items() if e.T_goal_current is not None}
    rows: list[Row] = []
    for instance_id, truth in sorted(counterparts(motions, capture.truth).items()):
        estimate = answered.get(instance_id)
        rows.append(
            Row(
                cell=cell,
                dataset=dataset,
                settings=dict(settings or {}),
                scene_id=scene_id,
                scene=capture.name,
                object=instance_id,
                object_name=truth.model.name,
                weights=dict(weights or {}),
                symmetry=symmetry_of(truth.model),
                **_answer_fields(estimate, truth),
            )
        )
    return rows


def _answer_fields(estimate: PoseEstimate | None, truth: TrueObject) -> dict[str, Any]:
    if estimate is None:
        return {"status": "missed", "stage": "segmenter", "reason": "no goal segment covers the object"}
    fields: dict[str, Any] = {
        "status": estimate.status,
        "confidence": estimate.confidence,
        "ambiguity": estimate.ambiguity,
        "instance": estimate.instance,
        "matcher_calls": estimate.matcher_calls,
        "correspondences": 0 if estimate.correspondences is None else len(estimate.correspondences),
        "inliers": 0 if estimate.inliers is None else int(estimate.inliers.sum()),
        "time_ms": dict(estimate.time_ms),
        "cached": estimate.cached,
    }
    if estimate.failure is not None:
        return {**fields, "stage": estimate.failure.stage, "reason": estimate.failure.reason}
    assert estimate.T_goal_current is not None
    error = pose_error(estimate.T_goal_current, truth)
    return {
        **fields,
        "rotation_error_deg": error.rotation_error_deg,
        "translation_error_cm": error.translation_error_cm,
        "rotation_error_deg_sym": error.rotation_error_deg_sym,
        "translation_error_cm_sym": error.translation_error_cm_sym,
        "success": error.success,
        "success_sym": error.success_sym,
        "success_equivalent": error.success_sym
        or any(
            pose_error(T, truth).success_sym for T in (() if estimate.equivalents is None else estimate.equivalents)
        ),
        "T_goal_current": estimate.T_goal_current.tolist(),
    }
