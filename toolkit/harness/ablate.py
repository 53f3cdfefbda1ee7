"""Runs the cells of an experiment on the same scenes and writes rows, summary, pictures and report."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from toolkit.data.bop import load_capture
from toolkit.data.source import Dataset, open_dataset, require_source
from toolkit.digests import digest
from toolkit.errors import ToolkitError
from toolkit.harness.cache import Cache
from toolkit.harness.experiment import Cell, Experiment, expand
from toolkit.harness.runs import ROWS, SUMMARY, RunOptions, finished, open_run, resolve, writable, write_meta
from toolkit.harness.worker import SceneTask, make_runner, require_ready, run_scene, workers_for
from toolkit.parallel import Workers
from toolkit.paths import cache_root
from toolkit.pictures.poses import write_case
from toolkit.progress import Progress
from toolkit.results.report import write_report
from toolkit.results.rows import (
    Row,
    append_rows,
    best_cell,
    read_rows,
    summarize,
    worst_rows,
    write_rows,
    write_summary,
)

WORST_CASES = 8
"""Objects shown as pictures in the report."""


def run_experiment(experiment: Experiment, options: RunOptions, progress: Progress | None = None) -> Path:
    """Run every cell on the same scenes.

    Returns:
        The run's folder, with rows.jsonl, summary.csv, report.html, meta.json and experiment.resolved.yaml.

    Raises:
        ToolkitError: anything a user can mend: bad settings, missing weights, a folder that cannot be written.
    """
    progress = progress or Progress()
    if experiment.rearrange is not None:
        raise ToolkitError(f"experiment '{experiment.name}' moves objects; run it with `toolkit rearrange`")
    cells = expand(experiment)
    for cell in cells:
        require_source(cell.dataset)
    weights = require_ready(cells)
    cache = Cache(cache_root() / "stages") if options.use_cache else None
    resolved = resolve(experiment.name, [cell.resolved() for cell in cells], options.shard)
    with workers_for(experiment, options, progress) as workers:
        with writable("the run folder"):
            run = open_run(experiment.name, resolved, options.out, resume=options.resume, fresh=options.fresh)
            done = finished(run)
        datasets = _build_datasets(cells, options, workers, progress)
        if not any(dataset.captures for dataset in datasets.values()):
            raise ToolkitError(f"shard {options.shard} holds no scene: there are fewer scenes than shards")
        tasks = _tasks(cells, datasets, done, cache)
        with writable(f"'{run}'"):
            write_meta(run, weights, [dataset.made for dataset in datasets.values()])
            with progress.step("Evaluating", sum(len(task.cells) for task in tasks)) as advance:
                for task, rows in workers.map(run_scene, tasks):
                    append_rows(run / ROWS, rows)
                    advance(len(task.cells))
    with writable(f"'{run}'"):
        rows = _in_order(read_rows(run / ROWS), cells)
        write_rows(run / ROWS, rows)
        write_summary(run / SUMMARY, summarize(rows))
        _draw_worst_cases(run, cells, datasets, rows, cache, progress)
        with progress.step("Writing the report", 1) as advance:
            write_report(run)
            advance(1)
    return run


def _dataset_key(cell: Cell) -> str:
    return digest(cell.dataset)


def _build_datasets(
    cells: Sequence[Cell], options: RunOptions, workers: Workers, progress: Progress
) -> dict[str, Dataset]:
    """The dataset of every cell, by key; cells with the same settings share one."""
    datasets: dict[str, Dataset] = {}
    for cell in cells:
        key = _dataset_key(cell)
        if key not in datasets:
            datasets[key] = open_dataset(cell.dataset, cache_root(), workers, progress, options.shard.holds)
    return datasets


def _tasks(
    cells: Sequence[Cell], datasets: dict[str, Dataset], done: set[tuple[str, int]], cache: Cache | None
) -> list[SceneTask]:
    """One task a scene, with the cells that share its dataset and have no rows for it yet."""
    tasks: list[SceneTask] = []
    for key, dataset in datasets.items():
        group = [cell for cell in cells if _dataset_key(cell) == key]
        for scene_id, capture in dataset.captures.items():
            pending = tuple(cell for cell in group if (cell.name, scene_id) not in done)
            if pending:
                tasks.append(SceneTask(scene_id, capture, pending, cache))
    return tasks


def _in_order(rows: Sequence[Row], cells: Sequence[Cell]) -> list[Row]:
    order = {cell.name: i for i, cell in enumerate(cells)}
    return sorted(rows, key=lambda row: (order[row.cell], row.scene_id, row.object))


def _draw_worst_cases(
    run: Path,
    cells: Sequence[Cell],
    datasets: dict[str, Dataset],
    rows: Sequence[Row],
    cache: Cache | None,
    progress: Progress,
) -> None:
    """Pictures of the worst objects of the best cell: that is where the next improvement lies."""
    name = best_cell(rows)
    best = next(cell for cell in cells if cell.name == name)
    worst = worst_rows([row for row in rows if row.cell == name], WORST_CASES)
    if not worst:
        return
    runner = make_runner(best, cache)
    captures = datasets[_dataset_key(best)].captures
    with progress.step("Drawing the worst cases", len(worst)) as advance:
        for scene_id in dict.fromkeys(row.scene_id for row in worst):
            capture = load_capture(captures[scene_id])
            database = runner.pipeline.build_database(capture.current)
            estimates = runner.pipeline.estimate(database, capture.goal)
            for row in (row for row in worst if row.scene_id == scene_id):
                write_case(run / "pictures", capture, database, estimates, row)
                advance(1)
