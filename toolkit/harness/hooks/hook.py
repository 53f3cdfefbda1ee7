"""What a hook is told of a run, in the process that was started. Nothing it does changes a row."""

from __future__ import annotations

from abc import ABC
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from toolkit.results.rows import ObjectRow


@dataclass(frozen=True)
class Start:
    """A run that begins, or is gone on with.

    Attributes:
        run: its folder.
        experiment: the experiment's name.
        title: the experiment's, or its name.
        settings: all that decides the rows, as experiment.resolved.yaml has it.
        tasks: pairs of scene and cell that are still to be done.
    """

    run: Path
    experiment: str
    title: str
    settings: Mapping[str, Any]
    tasks: int


class RunHook(ABC):  # noqa: B024
    """Follows a run. Every method may be left out; what one raises is said, and the run goes on without the hook."""

    def begin(self, start: Start) -> None:  # noqa: B027
        """The folder is made, and no row is there that was not there before."""

    def rows(self, rows: Sequence[ObjectRow]) -> None:  # noqa: B027
        """A scene is done in one cell or several, and its rows are on the disk."""

    def table(self, lines: Sequence[Mapping[str, Any]]) -> None:  # noqa: B027
        """All rows are there: the lines of summary.csv, one per cell, each with `cell`."""

    def end(self, run: Path | None) -> None:  # noqa: B027
        """The report is written, or, where `run` is None, the run was stopped or has failed."""
