"""`toolkit rearrange`: scenes set right in simulation, and where every object ended (Table II)."""

from __future__ import annotations

from collections.abc import Generator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from rich.console import Console

from toolkit.data.dataset import object_set
from toolkit.data.source import count_scenes
from toolkit.data.tabletop import TabletopConfig, TabletopScene, draw_scene
from toolkit.digests import digest
from toolkit.errors import ToolkitError
from toolkit.geometry import invert
from toolkit.harness.experiment import Cell, create_stage, episode_settings
from toolkit.harness.kinds import Job, RunKind, SceneTask, Work
from toolkit.harness.worker import get_runner, require_ready
from toolkit.paths import cache_root
from toolkit.pictures.film import Film, Filmable, record_poses
from toolkit.pictures.rearranged import write_scene
from toolkit.pictures.recording import has_rerun
from toolkit.rearrangement.episode import Episode, begun, rearrange
from toolkit.registry import Plugin
from toolkit.results.about import About
from toolkit.results.comparisons import Comparison, compare_cells, print_tables
from toolkit.results.completion import (
    CompletionSummary,
    MoveRow,
    most_complete,
    summarize_completion,
    telling_scenes,
)
from toolkit.results.folder import ROWS
from toolkit.results.metrics import PoseError, assign_goal_objects, pose_error, symmetry_of
from toolkit.results.rows import read_rows_as
from toolkit.results.tables import completion_table
from toolkit.slots import REARRANGE_SLOTS
from toolkit.stages import Executor
from toolkit.types import Failure, Float, TrueObject

SHOWN_SCENES, SHOWN_BEST = 8, 2
"""Scenes shown as pictures in the report: the worst, and so many of the best."""


@dataclass(frozen=True)
class MoveTask(SceneTask):
    """A scene that is simulated, and the one cell to set it right in.

    Attributes:
        film: the MP4 file to film it into, or None.
    """

    film: Path | None = None


@dataclass(frozen=True)
class Rearrangement(RunKind[MoveRow, MoveTask]):
    """Rearranges scenes in simulation. Every scene and cell is a task of its own, since each takes long.

    Attributes:
        film: film the first scene of the first cell that is still to be done: film.mp4, and film.rrd where rerun is
            installed.
    """

    film: bool = False

    doing = "Rearranging"
    row = MoveRow

    def check(self, cell: Cell) -> dict[str, str]:
        """As `RunKind.check`; the captures must be simulated, and the table hold the objects."""
        if cell.rearrange is None:
            raise ToolkitError(f"'{cell.name}' moves no object; run it with `toolkit ablate`")
        if "path" in cell.dataset:
            raise ToolkitError("captures of the past cannot be rearranged: leave dataset.path out to simulate scenes")
        weights = require_ready([cell])
        for slot in REARRANGE_SLOTS:
            stage: Plugin = create_stage(cell.rearrange, slot)
            stage.check_ready()
            weights |= stage.digests()
        # The first scene shows whether the objects are there and the table holds them.
        _draw(cell, 0)
        return weights

    def work(self, job: Job) -> Work[MoveTask]:
        """One task per scene and cell; a scene is drawn where it is set right."""
        scenes = filter(job.shard.holds, range(max(map(_scenes, job.cells))))
        pairs = [(scene_id, cell) for scene_id in scenes for cell in job.pending(job.cells, scene_id)]
        tasks = [MoveTask(scene_id, (cell,), job.cache) for scene_id, cell in pairs if scene_id < _scenes(cell)]
        if self.film and tasks:
            tasks[0] = replace(tasks[0], film=job.run.absolute() / "film.mp4")
        return Work(tasks, list({digest(cell.dataset): cell.dataset for cell in job.cells}.values()))

    def run_scene(self, task: MoveTask) -> list[MoveRow]:
        """Rearrange one scene and measure where everything ended."""
        (cell,) = task.cells
        assert cell.rearrange is not None
        scene = _draw(cell, task.scene_id)
        runner = get_runner(cell, task.cache)
        planner, executor = (create_stage(cell.rearrange, slot) for slot in ("planner", "executor"))
        weights = {**runner.weights, **planner.digests(), **executor.digests()}
        seed = int(np.random.SeedSequence([cell.seed, task.scene_id]).generate_state(1)[0])
        with begun(executor, scene) as goal, _filmed(executor, task.film, scene):
            episode = rearrange(goal, runner.pipeline, planner, executor, episode_settings(cell.rearrange), seed)
            state = executor.state()
        if state is None:
            raise ToolkitError(f"executor '{cell.rearrange.executor.name}' knows no true poses to measure against")
        return _score(cell, task.scene_id, scene, episode, state, weights)

    def summarize(self, rows: Sequence[MoveRow]) -> list[CompletionSummary]:
        """Completion, moves and times of every cell."""
        return summarize_completion(rows)

    def compare(self, rows: Sequence[MoveRow], reference: str) -> list[Comparison]:
        """As `RunKind.compare`, on the same objects."""
        return compare_cells(rows, reference)

    def print(self, run: Path, console: Console) -> None:
        """Print the table of completion, and the cells against the reference."""
        rows = read_rows_as(MoveRow, run / ROWS)
        table = completion_table(summarize_completion(rows))
        print_tables(table, compare_cells(rows, About.read(run).reference), console)

    def illustrate(self, job: Job, rows: Sequence[MoveRow]) -> None:
        """Pictures of scenes of the best cell, before and after: the worst, and some of the best."""
        name = most_complete(summarize_completion(rows)).cell
        best = next(cell for cell in job.cells if cell.name == name)
        own = [row for row in rows if row.cell == name]
        scenes = telling_scenes(own, SHOWN_SCENES, SHOWN_BEST)
        with job.progress.step("Drawing scenes", len(scenes)) as advance:
            for scene_id in scenes:
                of_scene = [row for row in own if row.scene_id == scene_id]
                write_scene(job.run, _draw(best, scene_id), of_scene, cache_root())
                advance(1)

    def write_page(self, run: Path) -> Path:
        """As `RunKind.write_page`."""
        from toolkit.results.report import write_completion_report  # here, since it loads what draws

        return write_completion_report(run)


def _scenes(cell: Cell) -> int:
    return count_scenes(cell.dataset)


def _draw(cell: Cell, scene_id: int) -> TabletopScene:
    config = TabletopConfig.model_validate(cell.dataset)
    return draw_scene(config, object_set(config.objects, cache_root()), scene_id, cache_root())


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
    cell: Cell,
    scene_id: int,
    scene: TabletopScene,
    episode: Episode,
    state: Mapping[int, Float],
    weights: dict[str, str],
) -> list[MoveRow]:
    """One row per true object: its true final pose against its true goal."""
    estimates = episode.sight.estimates if episode.sight is not None else ()
    answers = assign_goal_objects([e.segment for e in estimates], episode.goal.true_masks or {})
    ended = {number: np.asarray(pose).tolist() for number, pose in state.items()}
    rows: list[MoveRow] = []
    for number, truth in scene.truth.items():
        error = _error(state, truth)
        failure = _why(number, answers.get(number), episode, error)
        rows.append(
            MoveRow(
                cell=cell.name,
                scene_id=scene_id,
                settings=cell.settings,
                dataset=digest(cell.dataset)[:16],
                scene=f"{scene_id:06d}",
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
                touching_moves=episode.touching_moves[number],
                rounds=episode.rounds,
                forced_buffers=episode.forced_buffers,
                scene_moves=episode.moves.total(),
                time_ms=episode.time_ms,
                motion_s=episode.motion_s,
                ended=ended,
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
    return Failure("pose", "it was put down off its goal")
