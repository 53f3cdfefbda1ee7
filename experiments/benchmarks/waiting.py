"""What a person waits for: motions by several roads, warm, and `toolkit estimate` from a cold shell; prints Markdown.

toolkit dataset build captures --scenes 6 --seed 0
python experiments/benchmarks/waiting.py captures

Processor time on one thread, in milliseconds, as median over the captures: what else the machine does counts little.
Every capture is estimated once before the clock starts. `database` is a scene's, masks included; `goal object` is the
first goal's time over its objects; `again` is the same of a further goal, when the scene's features and models are
kept.
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from pnp import machine, table

from toolkit.data.bop import load_capture
from toolkit.data.dataset import read_dataset
from toolkit.harness.experiment import load_experiment, only_cell
from toolkit.harness.session import Session
from toolkit.types import Capture

_TRUE = {"segmenter": "oracle", "goal_segmenter": "oracle", "associator": "oracle", "explainer": "none"}
_PAPER = {"segmenter": "depth_plane", "associator": "kmeans", "explainer": "none"}
ROADS: dict[str, dict[str, str]] = {
    "automatic masks, explained": {},
    "automatic masks, the paper's road": _PAPER,
    "true masks": _TRUE,
    "true masks, no refiner": {**_TRUE, "refiner": "none"},
}
_TURNS = ("first time", "second time")


def clock(work: Callable[[], Any]) -> tuple[Any, float]:
    """What some work gives, and its milliseconds of processor time."""
    start = time.process_time()
    result = work()
    return result, 1e3 * (time.process_time() - start)


def session_of(choices: dict[str, str], **settings: str) -> Session:
    """The pipeline of `toolkit estimate` with other stages by slot, and settings by path (`matcher.device`)."""
    overrides = {f"pipeline.{slot}.name": [name] for slot, name in choices.items()}
    overrides |= {f"pipeline.{path}": [value] for path, value in settings.items()}
    return Session(only_cell(load_experiment("estimate", overrides)))


def road(choices: dict[str, str], captures: Sequence[Capture]) -> list[list[float]]:
    """Of every capture: milliseconds for the database, per goal object, and per object of a further goal."""
    session = session_of(choices)
    lines: list[list[float]] = []
    for warm in (False, True):
        for capture in captures:
            _, database = clock(lambda capture=capture: session.database(capture.current))
            found, goal = clock(lambda capture=capture: session.estimate(capture.goal))
            _, again = clock(lambda capture=capture: session.estimate(capture.goal))
            if warm:
                lines.append([database, goal / max(len(found), 1), again / max(len(found), 1)])
    return lines


def cold(capture: Path) -> list[float]:
    """Milliseconds of processor time of `toolkit estimate` in a process of its own, with an empty cache and again."""
    start = "import sys; sys.argv[0] = 'toolkit'; from toolkit.cli.commands import main; main()"
    times: list[float] = []
    with tempfile.TemporaryDirectory() as folder:
        for turn in _TURNS:
            before = resource.getrusage(resource.RUSAGE_CHILDREN)
            subprocess.run(
                [sys.executable, "-c", start, "estimate", str(capture), "--out", str(Path(folder) / turn)],
                env={**os.environ, "TOOLKIT_CACHE": str(Path(folder) / "cache"), "OMP_NUM_THREADS": "1"},
                stdout=subprocess.DEVNULL,
                check=True,
            )
            after = resource.getrusage(resource.RUSAGE_CHILDREN)
            times.append(1e3 * (after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime))
    return times


def main() -> None:
    """Run the benchmark and print its tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dataset", type=Path, help="folder of capture folders, with truth")
    parser.add_argument("--scenes", type=int, default=6, help="how many captures, from the first")
    options = parser.parse_args()

    cv2.setNumThreads(1)
    torch.set_num_threads(1)
    folders = read_dataset(options.dataset)[: options.scenes]
    captures = [load_capture(folder) for folder in folders]
    objects = [len(capture.goal.true_masks or {}) for capture in captures]
    print(f"{len(captures)} captures, {sum(objects)} goal objects; {machine()}\n")
    lines = [
        [name, *(f"{value:.0f}" for value in np.median(road(choices, captures), axis=0))]
        for name, choices in ROADS.items()
    ]
    print(table(["road", "database, ms", "goal object, ms", "again, ms"], lines))
    size = int(np.argsort(objects)[len(objects) // 2])
    header = [f"toolkit estimate, {objects[size]} objects", "processor time, ms"]
    print(table(header, [[turn, f"{value:.0f}"] for turn, value in zip(_TURNS, cold(folders[size]), strict=True)]))


if __name__ == "__main__":
    main()
