"""Captures from disk -> poses.json and pictures; scored rows where the truth is present."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from rich.table import Table

from toolkit.data.bop import load_capture
from toolkit.data.dataset import read_dataset
from toolkit.geometry import rotation_angle
from toolkit.harness.experiment import Cell
from toolkit.harness.runs import writable
from toolkit.harness.worker import CellRunner, make_runner, require_ready
from toolkit.pictures.poses import write_poses
from toolkit.progress import Progress
from toolkit.results.folder import ROWS, SUMMARY
from toolkit.results.rows import Row, summarize, write_rows, write_summary
from toolkit.results.scoring import score
from toolkit.types import Capture, PoseEstimate


def estimate_folder(
    capture: Path, cell: Cell, out: Path, progress: Progress, masks: Path | None = None
) -> list[PoseEstimate]:
    """Estimate one capture folder; writes OUT/poses.json, masks and pictures.

    Args:
        capture: the folder.
        cell: the settings to run.
        out: where it writes to.
        progress: is told what of the capture was not used, or used otherwise than it is stored.
        masks: a folder of a user's own masks, for the segmenter `masks`.

    Raises:
        ToolkitError: the capture cannot be read, a stage lacks something, or OUT cannot be written.
    """
    require_ready([cell])
    return _estimate(_load(capture, progress, masks), make_runner(cell, cache=None), out)


def evaluate_folder(dataset: Path, cell: Cell, out: Path, progress: Progress) -> list[Row]:
    """Estimate every capture of a folder into OUT/<capture>/, and score those with truth into OUT/rows.jsonl.

    Returns:
        The rows; empty where no capture has truth.

    Raises:
        ToolkitError: as `estimate_folder`.
    """
    require_ready([cell])
    runner = make_runner(cell, cache=None)
    captures = read_dataset(dataset)
    rows: list[Row] = []
    with progress.step("Evaluating", len(captures)) as advance:
        for scene_id, folder in enumerate(captures):
            capture = _load(folder, progress)
            estimates = _estimate(capture, runner, out / capture.name)
            if capture.truth is not None and capture.goal.true_masks is not None:
                rows += score(capture, estimates, cell=cell.name, scene_id=scene_id, weights=runner.weights)
                with writable(f"'{out}'"):
                    write_rows(out / ROWS, rows)
            advance(1)
    if rows:
        with writable(f"'{out}'"):
            write_summary(out / SUMMARY, summarize(rows))
    return rows


def poses_table(estimates: Sequence[PoseEstimate]) -> Table:
    """The estimates as a table for the terminal: how far every object's seen points move on average, and turn."""
    table = Table("object", "status", "instance", "inliers", "moves (cm)", "turns (deg)", "why not")
    for estimate in estimates:
        table.add_row(
            str(estimate.goal_object),
            estimate.status,
            "" if estimate.instance is None else str(estimate.instance),
            "" if estimate.inliers is None else str(int(estimate.inliers.sum())),
            *_motion(estimate),
            f"{estimate.failure.stage}: {estimate.failure.reason}" if estimate.failure else "",
        )
    return table


def _motion(estimate: PoseEstimate) -> tuple[str, str]:
    if estimate.T_goal_current is None or estimate.correspondences is None:
        return "", ""
    points = estimate.correspondences.points
    moved = np.linalg.norm(estimate.move(points) - points, axis=1).mean()
    return f"{moved * 100:.1f}", f"{np.degrees(rotation_angle(estimate.T_goal_current[:3, :3])):.1f}"


def _load(folder: Path, progress: Progress, masks: Path | None = None) -> Capture:
    capture = load_capture(folder, masks)
    for note in capture.notes:
        progress.say(f"{capture.name}: {note}")
    return capture


def _estimate(capture: Capture, runner: CellRunner, out: Path) -> list[PoseEstimate]:
    database = runner.pipeline.build_database(capture.current)
    scene = runner.pipeline.scene(database)
    estimates = scene.estimate(capture.goal)
    with writable(f"'{out}'"):
        write_poses(out, capture, scene.database, estimates)
    return estimates
