"""What the framework adds to the stages' time in an experiment; prints Markdown.

`stages` is the time inside the stages as the rows state it (`time_ms`): with the cropping of what they get, the lifting
of what they return, and the cache around them. `own code` is the part inside methods of the stages' classes. The rest
is the framework's: reading captures, scoring, rows, pictures, summary, report. One process; scenes are built, and
everything is imported, before the clock starts.

python experiments/benchmarks/overhead.py quick --scenes 20
"""

from __future__ import annotations

import argparse
import cProfile
import os
import pstats
import sys
import tempfile
import time
from collections.abc import Callable, Generator
from contextlib import AbstractContextManager, contextmanager
from functools import wraps
from pathlib import Path
from typing import Any

from rich.console import Console

from toolkit.data.source import open_dataset
from toolkit.harness.ablate import Ablation
from toolkit.harness.drive import drive
from toolkit.harness.experiment import Experiment, create_stage, expand, load_experiment
from toolkit.harness.runs import RunOptions
from toolkit.paths import cache_root
from toolkit.perception.meter import Meter
from toolkit.progress import Progress
from toolkit.slots import SLOTS


class Clock:
    """Seconds spent inside what it watches; where one thing calls another, the time counts once."""

    def __init__(self) -> None:
        self.seconds = 0.0
        self._depth = 0

    @contextmanager
    def running(self) -> Generator[None]:
        """Count the time inside the block."""
        self._depth += 1
        start = time.perf_counter()
        try:
            yield
        finally:
            self._depth -= 1
            if self._depth == 0:
                self.seconds += time.perf_counter() - start

    def watch(self, kind: type[Any]) -> None:
        """Count every public method of a stage's class."""
        for name in dir(kind):
            method = getattr(kind, name)
            if not name.startswith("_") and name not in {"Config", "check_ready", "digests"} and callable(method):
                setattr(kind, name, self._timed(method))

    def _timed(self, method: Callable[..., Any]) -> Callable[..., Any]:
        @wraps(method)
        def timed(*arguments: Any, **named: Any) -> Any:
            with self.running():
                return method(*arguments, **named)

        return timed


MODES = {"without cache": False, "cache, empty": True, "cache, full": True}
"""What a run finds, and whether it uses it; in this order, as each leaves what the next one needs."""


def measure(experiment: Experiment, clocks: tuple[Clock, Clock], folder: Path, *, use_cache: bool) -> list[float]:
    """Seconds of a run in this process: wall, and what each clock counted of them."""
    for clock in clocks:
        clock.seconds = 0.0
    start = time.perf_counter()
    drive(Ablation(), experiment, RunOptions(out=folder, use_cache=use_cache))
    return [time.perf_counter() - start, *(clock.seconds for clock in clocks)]


@contextmanager
def _both(block: AbstractContextManager[None], clock: Clock) -> Generator[None]:
    with clock.running(), block:
        yield


def main() -> None:
    """Build the scenes, run three times, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("experiment", nargs="?", default="quick")
    parser.add_argument("--scenes", type=int, default=20)
    parser.add_argument("--profile", choices=MODES, help="print where this one spends its time, too")
    options = parser.parse_args()
    experiment = load_experiment(options.experiment, {"dataset.scenes": [options.scenes]})
    cells = expand(experiment)
    stages, own = clocks = Clock(), Clock()
    metered = Meter.stage
    Meter.stage = lambda meter, name: _both(metered(meter, name), stages)
    for kind in {type(create_stage(cell.pipeline, slot)) for cell in cells for slot in SLOTS}:
        own.watch(kind)
    for cell in cells:
        open_dataset(cell.dataset, cache_root(), progress=Progress(Console(stderr=True)))
    with tempfile.TemporaryDirectory() as temporary:
        root, kept = Path(temporary), cache_root()
        os.environ["TOOLKIT_CACHE"] = str(root / "cache")
        (root / "cache").mkdir()
        for name in ("datasets", "objects", "weights"):
            (root / "cache" / name).symlink_to(kept / name)
        # What is imported, and the fonts of plots, on first use.
        measure(load_experiment(options.experiment, {"dataset.scenes": [1]}), clocks, root / "first", use_cache=False)
        print(f"{options.experiment}, {options.scenes} scenes, {len(cells)} cells, one process\n")
        print("| run | wall, s | stages, s | own code, s | framework, s | % of wall |\n|" + 6 * " --- |")
        for mode, use_cache in MODES.items():
            profile = cProfile.Profile() if mode == options.profile else None
            if profile:
                profile.enable()
            wall, inside, code = measure(experiment, clocks, root / mode, use_cache=use_cache)
            rest = wall - inside
            print(f"| {mode} | {wall:.1f} | {inside:.1f} | {code:.1f} | {rest:.1f} | {rest / wall:.1%} |", flush=True)
            if profile:
                profile.disable()
                pstats.Stats(profile, stream=sys.stderr).sort_stats("cumulative").print_stats(90)


if __name__ == "__main__":
    main()
