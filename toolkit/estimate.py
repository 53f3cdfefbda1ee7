"""Captures from disk -> poses.json and pictures; scored rows where the truth is present."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rich.table import Table

from toolkit.data.bop import load_capture
from toolkit.data.dataset import read_dataset
from toolkit.evaluate import score, write_poses
from toolkit.experiment import Cell
from toolkit.files import write_text
from toolkit.progress import Progress
from toolkit.results import Row, summarize, write_rows, write_summary
from toolkit.runs import ROWS, writable
from toolkit.types import Capture, PoseEstimate
from toolkit.worker import CellRunner, make_runner, require_ready


def estimate_folder(capture: Path, cell: Cell, out: Path) -> list[PoseEstimate]:
    """Estimate one capture folder; writes OUT/poses.json, masks and pictures.

    Raises:
        ToolkitError: the capture cannot be read, a stage lacks something, or OUT cannot be written.
    """
    require_ready([cell])
    return _estimate(load_capture(capture), make_runner(cell, cache=None), out)


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
            capture = load_capture(folder)
            estimates = _estimate(capture, runner, out / capture.name)
            if capture.truth is not None and capture.goal.true_masks is not None:
                rows += score(capture, estimates, cell=cell.name, scene_id=scene_id, weights=runner.weights)
            advance(1)
    if rows:
        with writable(f"'{out}'"):
            write_rows(out / ROWS, rows)
            write_summary(out / "summary.csv", summarize(rows))
    return rows


def poses_table(estimates: Sequence[PoseEstimate]) -> Table:
    """The estimates as a table for the terminal."""
    table = Table("object", "status", "instance", "inliers", "moves by (cm)", "turns by (deg)", "why")
    for estimate in estimates:
        moved = _motion_cells(estimate)
        reason = f"{estimate.failure.stage}: {estimate.failure.reason}" if estimate.failure else ""
        inliers = "" if estimate.inliers is None else str(int(estimate.inliers.sum()))
        instance = "" if estimate.instance is None else str(estimate.instance)
        table.add_row(str(estimate.goal_object), estimate.status, instance, inliers, *moved, reason)
    return table


def _motion_cells(estimate: PoseEstimate) -> tuple[str, str]:
    return ("", "")


def _estimate(capture: Capture, runner: CellRunner, out: Path) -> list[PoseEstimate]:
    database = runner.pipeline.build_database(capture.current)
    estimates = runner.pipeline.estimate(database, capture.goal)
    with writable(f"'{out}'"):
        write_poses(out, capture, database, estimates)
    return estimates


__all__ = ["estimate_folder", "evaluate_folder", "poses_table", "write_text"]
