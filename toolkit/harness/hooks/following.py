"""Several hooks as one, none of which can lose a run."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from types import TracebackType
from typing import Any

from toolkit.harness.hooks import HOOKS
from toolkit.harness.hooks.hook import RunHook, Start
from toolkit.progress import Progress
from toolkit.registry import Plugin
from toolkit.results.rows import ObjectRow


class Following(RunHook, AbstractContextManager["Following"]):
    """Tells every hook what happens, and leaves out from then on one that raises; ends them with the `with` block.

    Args:
        names: of the hooks.
        progress: where it is said that one failed.

    Raises:
        ToolkitError: there is no such hook, or it lacks what it needs.
    """

    def __init__(self, names: Sequence[str], progress: Progress) -> None:
        self._hooks = {name: HOOKS.create(name) for name in names}
        self._progress = progress
        self._run: Path | None = None
        for hook in self._hooks.values():
            if isinstance(hook, Plugin):
                hook.check_ready()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._run is not None:
            self.end(self._run if kind is None else None)

    def begin(self, start: Start) -> None:
        self._run = start.run
        self._tell(lambda hook: hook.begin(start))

    def rows(self, rows: Sequence[ObjectRow]) -> None:
        self._tell(lambda hook: hook.rows(rows))

    def table(self, lines: Sequence[Mapping[str, Any]]) -> None:
        self._tell(lambda hook: hook.table(lines))

    def end(self, run: Path | None) -> None:
        self._tell(lambda hook: hook.end(run))

    def _tell(self, what: Callable[[RunHook], None]) -> None:
        for name, hook in list(self._hooks.items()):
            try:
                what(hook)
            except Exception as error:
                # A service may raise anything; the rows are worth more than its copy of them.
                del self._hooks[name]
                said = " ".join(f"{type(error).__name__}: {error}".split())
                self._progress.say(f"hook '{name}' failed and is told no more; the run goes on: {said}")
