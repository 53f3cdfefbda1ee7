"""Runs rearrangements in simulation, scene after scene, and writes rows, summary and report (Table II)."""

from __future__ import annotations

from collections.abc import Generator, Mapping
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from toolkit.data.dataset import object_set
from toolkit.data.tabletop import TabletopConfig, TabletopScene, draw_scene
from toolkit.digests import digest
from toolkit.errors import ToolkitError
from toolkit.geometry import invert
from toolkit.harness.cache import Cache
from toolkit.harness.experiment import Cell, Experiment, RearrangeChoice, create_stage, episode_settings, expand
from toolkit.harness.runs import ROWS, SUMMARY, RunOptions, finished, open_run, resolve, writable, write_meta
from toolkit.harness.worker import get_runner, require_ready, workers_for
from toolkit.paths import cache_root
from toolkit.pictures.film import Film, Filmable, record_poses
from toolkit.pictures.recording import has_rerun
from toolkit.progress import Progress
from toolkit.rearrangement.episode import Episode, begun, rearrange
from toolkit.registry import Plugin
from toolkit.results.completion import MoveRow, summarize_completion
from toolkit.results.metrics import PoseError, assign_goal_objects, pose_error, symmetry_of
from toolkit.results.report import write_completion_report
from toolkit.results.rows import append_rows, read_rows_as, write_rows, write_summary
from toolkit.slots import REARRANGE_SLOTS
from toolkit.stages import Executor
from toolkit.types import Failure, Float, TrueObject


@dataclass(frozen=True)
class MoveTask:
    """One scene and the cell to run on it.

    Attributes:
        scene_id: number of the scene in its benchmark.
        cell: all settings.
        cache: where stage outputs are kept, or None.
        film: the MP4 file to film it into, or None.
    """

    scene_id: int
    cell: Cell
    cache: Cache | None
    film: Path | None = None


def run_rearrangement(
    experiment: Experiment, options: RunOptions, progress: Progress | None = None, *, film: bool = False
) -> Path:
    """Rearrange every scene in every cell.

    Args:
        experiment: what to run.
        options: how; nothing there changes a row.
        progress: shows a bar.
        film: film the first scene of the first cell that is still to be done: film.mp4, and film.rrd where rerun is
            installed.

    Returns:
        The run's folder, with rows.jsonl, summary.csv, report.html, meta.json and experiment.resolved.yaml.

    Raises:
        ToolkitError: anything a user can mend: bad settings, captures that are not simulated, missing weights, a
            folder that cannot be written.
    """
    progress = progress or Progress()
    cells = expand(experiment)
    weights = require_ready(cells)
    for cell in cells:
        weights |= _check(cell)
    cache = Cache(cache_root() / "stages") if options.use_cache else None
    resolved = resolve(experiment.name, [cell.resolved() for cell in cells], options.shard)
    scenes = list(filter(options.shard.holds, range(max(cell.dataset["scenes"] for cell in cells))))
    if not scenes:
        raise ToolkitError(f"shard {options.shard} holds no scene: there are fewer scenes than shards")
    with workers_for(experiment, options, progress) as workers:
        with writable("the run folder"):
            run = open_run(experiment.name, resolved, options.out, resume=options.resume, fresh=options.fresh)
            done = finished(run, MoveRow)
        tasks = [
            MoveTask(scene_id, cell, cache)
            for scene_id in scenes
            for cell in cells
            if scene_id < cell.dataset["scenes"] and (cell.name, scene_id) not in done
        ]
        if film and tasks:
            tasks[0] = replace(tasks[0], film=run.absolute() / "film.mp4")
        with writable(f"'{run}'"):
            datasets = {digest(cell.dataset): cell.dataset for cell in cells}
            write_meta(run, weights, list(datasets.values()))
            with progress.step("Rearranging", len(tasks)) as advance:
                for rows in workers.map(run_scene, tasks):
                    append_rows(run / ROWS, rows)
                    advance(1)
    with writable(f"'{run}'"):
        order = {cell.name: i for i, cell in enumerate(cells)}
        rows = read_rows_as(MoveRow, run / ROWS)
        rows.sort(key=lambda row: (order[row.cell], row.scene_id, row.object))
        write_rows(run / ROWS, rows)
        write_summary(run / SUMMARY, summarize_completion(rows))
        write_completion_report(run)
    return run


def _check(cell: Cell) -> dict[str, str]:
    """Everything a worker would stumble over, before any work starts; returns the sha256 of the weights by name."""
    if "path" in cell.dataset:
        raise ToolkitError("captures of the past cannot be rearranged: leave dataset.path out to simulate scenes")
    stages: list[Plugin] = [create_stage(_choice(cell), slot) for slot in REARRANGE_SLOTS]
    for stage in stages:
        stage.check_ready()
    config = _config(cell)
    # The first scene shows whether the objects are there and the table holds them.
    draw_scene(config, object_set(config.objects, cache_root()), 0, cache_root())
    return {name: sha256 for stage in stages for name, sha256 in stage.digests().items()}


def _choice(cell: Cell) -> RearrangeChoice:
    assert cell.rearrange is not None
    return cell.rearrange


def _config(cell: Cell) -> TabletopConfig:
    return TabletopConfig.model_validate(cell.dataset)


def run_scene(task: MoveTask) -> list[MoveRow]:
    """Rearrange one scene and measure where everything ended.

    Raises:
        ToolkitError: a stage refuses its input.
    """
    config = _config(task.cell)
    scene = draw_scene(config, object_set(config.objects, cache_root()), task.scene_id, cache_root())
    runner = get_runner(task.cell, task.cache)
    choice = _choice(task.cell)
    planner, executor = (create_stage(choice, slot) for slot in ("planner", "executor"))
    weights = {**runner.weights, **planner.digests(), **executor.digests()}
    seed = int(np.random.SeedSequence([task.cell.seed, task.scene_id]).generate_state(1)[0])
    with begun(executor, scene) as goal, _filmed(executor, task.film, scene):
        episode = rearrange(goal, runner.pipeline, planner, executor, episode_settings(choice), seed)
        state = executor.state()
    if state is None:
        raise ToolkitError(f"executor '{choice.executor.name}' knows no true poses to measure against")
    return _score(task, scene, episode, state, weights)


@contextmanager
def _filmed(executor: Executor, path: Path | None, scene: TabletopScene) -> Generator[None]:
    if path is None:
        yield
        return
    if not isinstance(executor, Filmable):
        raise ToolkitError("this executor cannot be filmed; leave --film out")
    poses = record_poses(executor, scene, path.with_suffix(".rrd")) if has_rerun() else nullcontext()
    with poses as on_frame, Film(executor, path, on_frame=on_frame):
        yield


def _score(
    task: MoveTask, scene: TabletopScene, episode: Episode, state: Mapping[int, Float], weights: dict[str, str]
) -> list[MoveRow]:
    """One row a true object: its true final pose against its true goal."""
    estimates = episode.sight.estimates if episode.sight is not None else ()
    answers = assign_goal_objects([e.segment for e in estimates], episode.goal.true_masks or {})
    rows: list[MoveRow] = []
    for number, truth in scene.truth.items():
        error = _error(state, truth)
        failure = _why(number, answers.get(number), episode, error)
        rows.append(
            MoveRow(
                cell=task.cell.name,
                scene_id=task.scene_id,
                settings=task.cell.settings,
                dataset=digest(task.cell.dataset)[:16],
                scene=f"{task.scene_id:06d}",
                object=number,
                object_name=truth.model.name,
                symmetry=symmetry_of(truth.model),
                **vars(error),
                success=error.success,
                success_sym=error.success_sym,
                right_after=[_error(earlier, truth).success_sym for earlier in episode.states],
                stage=failure.stage if failure else None,
                reason=failure.reason if failure else None,
                moves=episode.moves[number],
                buffer_moves=episode.buffer_moves[number],
                rounds=episode.rounds,
                forced_buffers=episode.forced_buffers,
                scene_moves=episode.moves.total(),
                time_ms=episode.time_ms,
                motion_s=episode.motion_s,
                weights=weights,
            )
        )
    return rows


def _error(state: Mapping[int, Float], truth: TrueObject) -> PoseError:
    """How far a true object stands from its true goal."""
    return pose_error(state[truth.instance_id] @ invert(truth.T_world_current), truth)


def _why(number: int, goal_object: int | None, episode: Episode, error: PoseError) -> Failure | None:
    """What kept an object from its goal; None where it stands there."""
    if error.success_sym:
        return None
    if episode.broken is not None:
        return episode.broken
    if goal_object is None:
        return Failure("segmenter", "no goal segment covers the object")
    if goal_object in episode.failures:
        return episode.failures[goal_object]
    if episode.moved_for.get(goal_object, number) not in (number, None):
        return Failure("retriever", "another object was taken for it")
    return Failure("pose", "it was put more than 5 deg or 2 cm off")
