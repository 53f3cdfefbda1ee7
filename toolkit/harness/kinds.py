"""What sets one kind of run apart from another; all else is the same road, `toolkit.harness.drive`."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Generic, TypeVar

from rich.console import Console

from toolkit.harness.cache import Cache
from toolkit.harness.experiment import Cell
from toolkit.harness.runs import Shard
from toolkit.parallel import Workers
from toolkit.progress import Progress
from toolkit.results.comparisons import Comparison
from toolkit.results.rows import RowT


@dataclass(frozen=True)
class SceneTask:
    """One scene and the cells to run on it: the unit of work that travels to a process.

    Attributes:
        scene_id: number of the scene in its dataset.
        cells: the cells that have no rows for it yet.
        cache: where stage outputs and rows are kept, or None.
    """

    scene_id: int
    cells: tuple[Cell, ...]
    cache: Cache | None


TaskT = TypeVar("TaskT", bound=SceneTask)


@dataclass(frozen=True)
class Job:
    """What a kind of run makes its tasks of.

    Attributes:
        run: the run's folder.
        cells: all cells.
        shard: the scenes to run.
        done: (cell, scene) pairs that have their rows already.
        cache: handed on to the tasks.
        workers: who may help to make scenes.
        progress: shows a bar meanwhile.
    """

    run: Path
    cells: Sequence[Cell]
    shard: Shard
    done: set[tuple[str, int]]
    cache: Cache | None
    workers: Workers
    progress: Progress

    def pending(self, cells: Sequence[Cell], scene_id: int) -> tuple[Cell, ...]:
        """Those of the cells that have no rows for a scene yet."""
        return tuple(cell for cell in cells if (cell.name, scene_id) not in self.done)


@dataclass(frozen=True)
class Work(Generic[TaskT]):
    """What is to be done.

    Attributes:
        tasks: in the order in which they are begun.
        datasets: how every dataset was made, for meta.json.
    """

    tasks: list[TaskT]
    datasets: list[dict[str, Any]]


class RunKind(ABC, Generic[RowT, TaskT]):
    """One kind of run. It travels to worker processes with its tasks.

    Attributes:
        doing: what it does with a scene, for a bar.
        row: what its rows are.
    """

    doing: ClassVar[str]
    row: type[RowT]

    @abstractmethod
    def check(self, cell: Cell) -> dict[str, str]:
        """Find what would stop a worker, before any work starts.

        Returns:
            sha256 by name of the weights the cell uses.

        Raises:
            ToolkitError: the cell is of another kind; a stage cannot be made, or lacks something such as a checkpoint.
        """

    @abstractmethod
    def work(self, job: Job) -> Work[TaskT]:
        """The tasks that are still to be done, their scenes made."""

    @abstractmethod
    def run_scene(self, task: TaskT) -> list[RowT]:
        """The rows of one scene in every cell of the task.

        Raises:
            ToolkitError: the scene cannot be read, or a stage refuses its input.
        """

    @abstractmethod
    def summarize(self, rows: Sequence[RowT]) -> Sequence[object]:
        """One dataclass of figures per cell, in the order the cells first occur."""

    def compare(self, rows: Sequence[RowT], reference: str) -> Sequence[Comparison]:
        """The cells against the reference; a kind whose rows are not right or wrong compares nothing."""
        return ()

    @abstractmethod
    def print(self, run: Path, console: Console) -> None:
        """Print the run's tables."""

    def illustrate(self, job: Job, rows: Sequence[RowT]) -> None:
        """Draw the pictures of the report; a kind that has none draws nothing."""

    @abstractmethod
    def write_page(self, run: Path) -> Path:
        """Write the run's report.html, and its tables and plots beside it, from its rows; returns the page.

        Raises:
            ToolkitError: the run has no rows.
        """
