"""Progress bars with an estimate of the time left, or silence."""

from __future__ import annotations

from collections.abc import Callable, Generator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    SpinnerColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.progress import Progress as RichProgress

Advance = Callable[[int], None]


class Progress:
    """Shows one bar per step on `console`; with None it shows nothing."""

    def __init__(self, console: Console | None = None) -> None:
        self._console = console
        self._waiting: RichProgress | None = None

    @contextmanager
    def waiting(self, title: str) -> Generator[None]:
        """Show that something is being done, and for how long, where no number of steps is known (`now`)."""
        if self._console is None or not self._console.is_terminal:
            yield
            return
        columns = SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn()
        with RichProgress(*columns, console=self._console, transient=True) as self._waiting:
            self._waiting.add_task(title, total=None)
            try:
                yield
            finally:
                self._waiting = None

    def now(self, title: str) -> None:
        """Say what is being done, while waiting."""
        if self._waiting is not None:
            self._waiting.update(self._waiting.task_ids[0], description=title)

    def say(self, text: str) -> None:
        """Print a line above the bar."""
        if self._console is not None:
            self._console.print(text, highlight=False, markup=False, soft_wrap=True)

    @contextmanager
    def step(self, title: str, total: int) -> Generator[Advance]:
        """A bar that advances by the number handed to the yielded function."""
        if self._console is None:
            yield lambda _: None
            return
        columns = (
            TextColumn("{task.description:<24}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TextColumn("left"),
            TimeRemainingColumn(),
        )
        with RichProgress(*columns, console=self._console) as bars:
            bar = bars.add_task(title, total=total)
            yield lambda count: bars.advance(bar, count)
