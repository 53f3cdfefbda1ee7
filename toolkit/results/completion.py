"""Rows (one per object and cell) and summaries of rearrangements: task completion, Table II of the paper."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydantic import Field

from toolkit.results.rows import Estimate, ObjectRow, by_cell
from toolkit.results.stats import bootstrap_interval
from toolkit.types import Float


class MoveRow(ObjectRow):
    """Where one true object ended, in one cell.

    Errors are those of its true final pose against its true goal; `right_after` says after which rounds it stood right,
    symmetry-aware. `stage` and `reason` say what kept it from its goal. `touching_moves` are those of its moves with a
    contact that was not meant. `rounds`, `forced_buffers`, `scene_moves`, `time_ms`, `motion_s` and `ended` are of the
    whole scene, the same in all its rows; `ended` holds the true (4, 4) model-to-world pose, in the end, of every
    instance on the table.
    """

    rotation_error_deg: float
    translation_error_cm: float
    rotation_error_deg_sym: float
    translation_error_cm_sym: float
    success: bool
    success_sym: bool
    right_after: list[bool]
    stage: str | None = None
    reason: str | None = None
    moves: int
    buffer_moves: int
    touching_moves: int = 0
    rounds: int
    forced_buffers: int
    scene_moves: int
    time_ms: dict[str, float]
    motion_s: float
    ended: dict[int, list[list[float]]]
    weights: dict[str, str] = Field(default_factory=dict[str, str])


@dataclass(frozen=True)
class CompletionSummary:
    """The figures of one cell; `_sym` ones take a model's symmetries into account.

    A scene is complete when all its objects stand within 2 cm and 5 deg of their goals; `one_step` says how it stood
    after the first round, which is what a run with `rounds: 1` ends with. Shares have Wilson intervals,
    means bootstrap intervals over scenes; times are medians over scenes.
    """

    cell: str
    settings: dict[str, Any]
    scenes: int
    objects: int
    completion: Estimate
    completion_sym: Estimate
    completion_sym_one_step: Estimate
    success: Estimate
    success_sym: Estimate
    moves_per_object: Estimate
    moves_per_object_unforced: Estimate | None
    buffer_moves_per_scene: float
    touching_moves: int
    forced_buffers_per_scene: float
    rounds: float
    perception_s: float
    planning_ms: float
    motion_s: float


def summarize_completion(rows: Sequence[MoveRow]) -> list[CompletionSummary]:
    """One summary per cell, in the order the cells first occur."""
    return [_summarize_cell(cell, of_cell) for cell, of_cell in by_cell(rows).items()]


def most_complete(summaries: Sequence[CompletionSummary]) -> CompletionSummary:
    """The cell with the largest share of scenes set right, the first of equals."""
    return max(summaries, key=lambda summary: summary.completion_sym.value)


def telling_scenes(rows: Sequence[MoveRow], count: int, best: int) -> list[int]:
    """Up to `count` scenes of one cell to look at: those with most objects wrong, and the `best` with fewest."""
    wrong: dict[int, int] = {}
    for row in rows:
        wrong[row.scene_id] = wrong.get(row.scene_id, 0) + (not row.success_sym)
    ranked = sorted(wrong, key=lambda scene: (-wrong[scene], scene))
    return ranked if len(ranked) <= count else [*ranked[: count - best], *ranked[-best:]]


def _summarize_cell(cell: str, rows: list[MoveRow]) -> CompletionSummary:
    scenes: dict[int, list[MoveRow]] = {}
    for row in rows:
        scenes.setdefault(row.scene_id, []).append(row)
    firsts = [own[0] for own in scenes.values()]
    unforced = {number: own for number, own in scenes.items() if own[0].forced_buffers == 0}
    return CompletionSummary(
        cell=cell,
        settings=rows[0].settings,
        scenes=len(scenes),
        objects=len(rows),
        completion=Estimate.of_share([all(row.success for row in own) for own in scenes.values()]),
        completion_sym=Estimate.of_share([all(row.success_sym for row in own) for own in scenes.values()]),
        completion_sym_one_step=Estimate.of_share([all(map(_right_in_one_step, own)) for own in scenes.values()]),
        success=Estimate.of_share([row.success for row in rows]),
        success_sym=Estimate.of_share([row.success_sym for row in rows]),
        moves_per_object=_moves_per_object(scenes),
        moves_per_object_unforced=_moves_per_object(unforced) if unforced else None,
        buffer_moves_per_scene=float(np.mean([sum(row.buffer_moves for row in own) for own in scenes.values()])),
        touching_moves=sum(row.touching_moves for row in rows),
        forced_buffers_per_scene=float(np.mean([first.forced_buffers for first in firsts])),
        rounds=float(np.mean([first.rounds for first in firsts])),
        perception_s=float(np.median([first.time_ms["perception"] for first in firsts])) / 1e3,
        planning_ms=float(np.median([first.time_ms["planning"] for first in firsts])),
        motion_s=float(np.median([first.motion_s for first in firsts])),
    )


def _right_in_one_step(row: MoveRow) -> bool:
    return row.right_after[0] if row.right_after else row.success_sym


def _moves_per_object(scenes: dict[int, list[MoveRow]]) -> Estimate:
    moves: Float = np.array([own[0].scene_moves for own in scenes.values()], np.float64)
    objects: Float = np.array([len(own) for own in scenes.values()], np.float64)
    pairs = np.stack([moves, objects], axis=1)

    def ratio(chosen: Float) -> float:
        return float(chosen[:, 0].sum() / chosen[:, 1].sum())

    return Estimate(ratio(pairs), bootstrap_interval(pairs, np.array(list(scenes)), ratio))
