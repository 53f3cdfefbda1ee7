"""Time by stage."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Generator
from contextlib import contextmanager
from time import perf_counter


class Meter:
    """Adds up milliseconds by stage, and remembers whether a cache served any of them.

    A cached output counts with the time that its computation once took, so that cells which share work stay comparable.
    """

    def __init__(self) -> None:
        self.times_ms: dict[str, float] = defaultdict(float)
        self.cached = False

    @contextmanager
    def stage(self, name: str) -> Generator[None]:
        """Add the time spent inside the block to stage `name`."""
        start = perf_counter()
        try:
            yield
        finally:
            self.times_ms[name] += (perf_counter() - start) * 1e3

    def served(self, name: str, time_ms: float) -> None:
        """Add the stored cost of an output that came from a cache."""
        self.times_ms[name] += time_ms
        self.cached = True

    def take(self) -> tuple[dict[str, float], bool]:
        """Return the times so far and whether any was served from a cache, and start again from nothing."""
        taken = dict(self.times_ms), self.cached
        self.times_ms.clear()
        self.cached = False
        return taken
