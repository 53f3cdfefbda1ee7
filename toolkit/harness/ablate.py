"""`toolkit ablate`: the motions of every scene's objects, estimated in every cell and scored."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console

from toolkit.data.bop import capture_digest, load_capture
from toolkit.data.source import Dataset, open_capture, open_dataset, require_source
from toolkit.digests import digest
from toolkit.errors import ToolkitError
from toolkit.harness.experiment import Cell
from toolkit.harness.kinds import Job, RunKind, SceneTask, Work
from toolkit.harness.worker import get_runner, make_runner, require_ready
from toolkit.paths import cache_root
from toolkit.pictures.poses import write_object
from toolkit.results.about import About
from toolkit.results.comparisons import Comparison, compare_cells, print_tables, remainder
from toolkit.results.folder import ROWS
from toolkit.results.rows import CellSummary, Row, best_cell, read_rows, summarize, worst_rows
from toolkit.results.tables import motion_table
from toolkit.types import Capture

WORST_CASES = 8
"""Objects shown as pictures in the report."""


@dataclass(frozen=True)
class CaptureTask(SceneTask):
    """A scene that lies in a capture folder.

    Attributes:
        capture: the folder.
    """

    capture: Path


class Ablation(RunKind[Row, CaptureTask]):
    """Estimates motions; the cells that share a dataset share its captures, and a scene is decoded once for all."""

    doing = "Evaluating"
    row = Row

    def check(self, cell: Cell) -> dict[str, str]:
        """As `RunKind.check`."""
        if cell.rearrange is not None:
            raise ToolkitError(f"'{cell.name}' moves objects; run it with `toolkit rearrange`")
        require_source(cell.dataset)
        return require_ready([cell])

    def work(self, job: Job) -> Work[CaptureTask]:
        """One task per scene, with the cells that share its dataset and have no rows for it yet."""
        datasets: dict[str, Dataset] = {}
        sharing: dict[str, list[Cell]] = {}
        for cell in job.cells:
            key = digest(cell.dataset)
            if key not in datasets:
                datasets[key] = open_dataset(cell.dataset, cache_root(), job.workers, job.progress, job.shard.holds)
            sharing.setdefault(key, []).append(cell)
        tasks = [
            CaptureTask(scene_id, pending, job.cache, capture)
            for key, dataset in datasets.items()
            for scene_id, capture in dataset.captures.items()
            if (pending := job.pending(sharing[key], scene_id))
        ]
        return Work(tasks, [dataset.made for dataset in datasets.values()])

    def run_scene(self, task: CaptureTask) -> list[Row]:
        """The rows of a scene for every one of the task's cells, from the cache where it has them."""
        capture: Capture | None = None  # decoded when a cell's rows are not in the cache
        content = capture_digest(task.capture)
        rows: list[Row] = []
        for cell in task.cells:
            runner = get_runner(cell, task.cache)
            key = digest([runner.identity, content, task.scene_id])
            stored = task.cache.load(key) if task.cache else None
            if stored is None:
                capture = capture or load_capture(task.capture)
                fresh = runner.rows(capture, task.scene_id)
                if task.cache:
                    task.cache.store(key, {"rows": np.array([row.model_dump_json() for row in fresh], dtype=np.str_)})
                rows += fresh
            else:
                served = [Row.model_validate_json(line) for line in stored["rows"].tolist()]
                rows += [row.model_copy(update={"cached": True}) for row in served]
        return rows

    def summarize(self, rows: Sequence[Row]) -> list[CellSummary]:
        """Errors, success and times of every cell."""
        return summarize(rows)

    def compare(self, rows: Sequence[Row], reference: str) -> list[Comparison]:
        """As `RunKind.compare`, on the same goal objects."""
        return compare_cells(rows, reference)

    def print(self, run: Path, console: Console) -> None:
        """Print the motions' table, the cells against the reference, and what an attribution leaves."""
        rows = read_rows(run / ROWS)
        summaries = summarize(rows)
        print_tables(motion_table(summaries), compare_cells(rows, About.read(run).reference), console)
        if left := remainder(summaries):
            console.print(left, highlight=False)

    def illustrate(self, job: Job, rows: Sequence[Row]) -> None:
        """Pictures of the worst objects of the best cell: that is where the next improvement lies."""
        name = best_cell(rows)
        best = next(cell for cell in job.cells if cell.name == name)
        worst = worst_rows([row for row in rows if row.cell == name], WORST_CASES)
        if not worst:
            return
        runner = make_runner(best, job.cache)
        with job.progress.step("Drawing the worst cases", len(worst)) as advance:
            for scene_id in dict.fromkeys(row.scene_id for row in worst):
                capture = load_capture(open_capture(best.dataset, cache_root(), scene_id))
                scene = runner.pipeline.scene(runner.pipeline.build_database(capture.current))
                estimates = scene.estimate(capture.goal)
                for row in (row for row in worst if row.scene_id == scene_id):
                    write_object(job.run, capture, scene.database, estimates, row)
                    advance(1)

    def write_page(self, run: Path) -> Path:
        """As `RunKind.write_page`."""
        from toolkit.results.report import write_report  # here, since it loads what draws

        return write_report(run)
