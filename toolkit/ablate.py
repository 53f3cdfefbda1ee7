"""Runs the cells of an experiment on the same scenes and writes rows, summary, pictures and report (DESIGN 9)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from toolkit.cache import Cache
from toolkit.data.bop import load_capture
from toolkit.data.source import Dataset, open_dataset
from toolkit.digests import digest
from toolkit.errors import ToolkitError
from toolkit.evaluate import write_case
from toolkit.experiment import Cell, Experiment, expand
from toolkit.parallel import run_parallel
from toolkit.paths import cache_root
from toolkit.progress import Progress
from toolkit.report import write_report
from toolkit.results import Row, append_rows, best_cell, read_rows, summarize, worst_rows, write_rows, write_summary
from toolkit.runs import ROWS, finished, open_run, writable, write_meta
from toolkit.worker import SceneTask, make_runner, require_ready, run_scene, run_scene_in_process

WORST_CASES = 8
"""Objects shown as pictures in the report."""


@dataclass(frozen=True)
class RunOptions:
    """How a run is carried out; nothing here changes a row.

    Attributes:
        out: the run's folder, or None for runs/<name>/<time>/.
        workers: processes.
        backend: joblib backend.
        resume: go on with the finished rows of `out`, or of the newest run with the same settings.
        fresh: start `out` again even where it holds a run.
        use_cache: False computes everything anew and keeps nothing.
        plugin_files: plugin files that are not installed; workers load them too.
    """

    out: Path | None = None
    workers: int = 1
    backend: str = "loky"
    resume: bool = False
    fresh: bool = False
    use_cache: bool = True
    plugin_files: tuple[Path, ...] = ()


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
    weights = require_ready(cells)
    cache = Cache(cache_root() / "stages") if options.use_cache else None
    resolved = {"experiment": experiment.name, "cells": [cell.resolved() for cell in cells]}
    with writable("the run folder"):
        run = open_run(experiment.name, resolved, options.out, resume=options.resume, fresh=options.fresh)
        done = finished(run)
    datasets = _build_datasets(cells, options, progress)
    tasks = _tasks(cells, datasets, done, cache, options)
    with writable(f"'{run}'"):
        write_meta(run, weights, [dataset.made for dataset in datasets.values()])
        with progress.step("Evaluating", sum(len(task.cells) for task in tasks)) as advance:
            for task, rows in _execute(tasks, options):
                append_rows(run / ROWS, rows)
                advance(len(task.cells))
        rows = _in_order(read_rows(run / ROWS), cells)
        write_rows(run / ROWS, rows)
        write_summary(run / "summary.csv", summarize(rows))
        _draw_worst_cases(run, cells, datasets, rows, cache, progress)
        with progress.step("Writing the report", 1) as advance:
            write_report(run)
            advance(1)
    return run


def _dataset_key(cell: Cell) -> str:
    return digest(cell.dataset)


def _build_datasets(cells: Sequence[Cell], options: RunOptions, progress: Progress) -> dict[str, Dataset]:
    """The dataset of every cell, by key; cells with the same settings share one."""
    datasets: dict[str, Dataset] = {}
    for cell in cells:
        key = _dataset_key(cell)
        if key not in datasets:
            datasets[key] = open_dataset(cell.dataset, cache_root(), options.workers, progress)
    return datasets


def _tasks(
    cells: Sequence[Cell],
    datasets: dict[str, Dataset],
    done: set[tuple[str, int]],
    cache: Cache | None,
    options: RunOptions,
) -> list[SceneTask]:
    """One task a scene, with the cells that share its dataset and have no rows for it yet."""
    tasks: list[SceneTask] = []
    for key, dataset in datasets.items():
        group = [cell for cell in cells if _dataset_key(cell) == key]
        for scene_id, capture in enumerate(dataset.captures):
            pending = tuple(cell for cell in group if (cell.name, scene_id) not in done)
            if pending:
                tasks.append(SceneTask(scene_id, capture, pending, cache, options.plugin_files))
    return tasks


def _execute(tasks: Sequence[SceneTask], options: RunOptions) -> Iterator[tuple[SceneTask, list[Row]]]:
    """Rows of every task, as they get done."""
    if options.workers == 1 or len(tasks) < 2:
        yield from ((task, run_scene(task)) for task in tasks)
        return
    yield from run_parallel(run_scene_in_process, ((task,) for task in tasks), options.workers, options.backend)


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
        for row in worst:
            capture = load_capture(captures[row.scene_id])
            database = runner.pipeline.build_database(capture.current)
            write_case(run / "pictures", capture, database, runner.pipeline.estimate(database, capture.goal), row)
            advance(1)
