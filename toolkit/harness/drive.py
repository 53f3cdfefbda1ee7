"""The one road every run takes: check, open a folder, run the scenes, and write rows, summary and report."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

from toolkit.data.source import count_scenes
from toolkit.errors import ToolkitError
from toolkit.harness.ablate import Ablation
from toolkit.harness.cache import Cache
from toolkit.harness.experiment import Experiment, expand
from toolkit.harness.hooks.following import Following
from toolkit.harness.hooks.hook import Start
from toolkit.harness.kinds import Job, RunKind, TaskT
from toolkit.harness.rearrange import Rearrangement
from toolkit.harness.runs import (
    RunOptions,
    finished,
    in_order,
    open_run,
    read_resolved,
    resolve,
    run_place,
    writable,
    write_meta,
)
from toolkit.harness.worker import workers_for
from toolkit.paths import cache_root
from toolkit.progress import Progress
from toolkit.results.folder import ROWS, SUMMARY
from toolkit.results.rows import RowT, append_rows, read_rows_as, summary_lines, write_rows, write_summary


def drive(
    kind: RunKind[RowT, TaskT], experiment: Experiment, options: RunOptions, progress: Progress | None = None
) -> Path:
    """Run every cell of an experiment on its scenes.

    Args:
        kind: what is done with a scene, e.g. `Ablation()`.
        experiment: what to run.
        options: how the run is carried out; nothing in them changes a row.
        progress: shows a bar.

    Returns:
        The run's folder, with rows.jsonl, summary.csv, report.html, meta.json and experiment.resolved.yaml.

    Raises:
        ToolkitError: anything a user can mend: an experiment of another kind, bad settings, missing weights, a folder
            that cannot be written.
    """
    progress = progress or Progress()
    cells = expand(experiment)
    weights = {name: sha256 for cell in cells for name, sha256 in kind.check(cell).items()}
    if not any(map(options.shard.holds, range(max(count_scenes(cell.dataset) for cell in cells)))):
        raise ToolkitError(f"shard {options.shard} holds no scene: there are fewer scenes than shards")
    cache = Cache(cache_root() / "stages") if options.use_cache else None
    resolved = resolve(experiment.name, [cell.resolved() for cell in cells], options.shard)
    with Following(options.log, progress) as hooks:
        with workers_for(experiment, options, progress) as workers:
            with writable(f"'{run_place(experiment.name, options.out)}'"):
                run = open_run(experiment.name, resolved, options.out, resume=options.resume, fresh=options.fresh)
                done = finished(run, kind.row)
            job = Job(run, cells, options.shard, done, cache, workers, progress)
            work = kind.work(job)
            with writable(f"'{run}'"):
                about = experiment.model_dump(include={"title", "description", "reference"})
                write_meta(run, about, weights, work.datasets)
                count = sum(len(task.cells) for task in work.tasks)
                hooks.begin(Start(run, experiment.name, experiment.title or experiment.name, resolved, count))
                with progress.step(kind.doing, count) as advance:
                    for cells_done, rows in workers.map(partial(_run_scene, kind), work.tasks):
                        append_rows(run / ROWS, rows)
                        hooks.rows(rows)
                        advance(cells_done)
        with writable(f"'{run}'"):
            rows = in_order(read_rows_as(kind.row, run / ROWS), [cell.name for cell in cells])
            write_rows(run / ROWS, rows)
            lines = summary_lines(kind.summarize(rows), kind.compare(rows, experiment.reference))
            write_summary(run / SUMMARY, lines)
            hooks.table(lines)
            kind.illustrate(job, rows)
            with progress.step("Writing the report", 1) as advance:
                kind.write_page(run)
                advance(1)
    return run


def _run_scene(kind: RunKind[RowT, TaskT], task: TaskT) -> tuple[int, list[RowT]]:
    """How many cells the task was of, and their rows."""
    return len(task.cells), kind.run_scene(task)


def kind_of(run: Path) -> RunKind[Any, Any]:
    """The kind of a run, by the cells it wrote down.

    Raises:
        ToolkitError: what it wrote down cannot be read.
    """
    cells: list[Mapping[str, Any]] = read_resolved(run).get("cells") or []
    return Rearrangement() if any("rearrange" in cell for cell in cells) else Ablation()
