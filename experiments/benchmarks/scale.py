"""How time and memory grow: with frames, objects, vectors in an index, scenes and workers; prints Markdown.

python experiments/benchmarks/scale.py
python experiments/benchmarks/scale.py --frames 8 --frames 64 --objects 1 --objects 9 --scenes 4

Of a scene's database and its goal objects: processor time on one thread, and by how much the process grows beyond what
a small scene took, each size in a process of its own that has estimated that before. `slope` is the exponent between a
line and the one before it: 1 where twice as much takes twice as long. Of runs: wall time, so that they say something
only on idle cores.
"""

from __future__ import annotations

import argparse
import math
import multiprocessing
import resource
import tempfile
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from pnp import machine, table

from toolkit.data.bop import load_capture
from toolkit.data.source import open_dataset, resolve_settings
from toolkit.harness.ablate import Ablation
from toolkit.harness.drive import drive
from toolkit.harness.experiment import load_experiment, only_cell
from toolkit.harness.runs import RunOptions
from toolkit.harness.session import Session
from toolkit.parallel import cores
from toolkit.paths import cache_root
from toolkit.perception.stages import INDEXES
from toolkit.progress import Progress

SIZES = (100, 1000, 10_000, 100_000, 1_000_000)
"""Vectors in an index; a scene has as many as its frames show objects."""

WIDTH = 512
"""Numbers in a vector, as MixVPR's."""


def scene(views: int, objects: int) -> Path:
    """A capture folder with so many frames and objects."""
    config = {"scenes": 1, "views": views, "min_objects": objects, "max_objects": objects}
    return open_dataset(resolve_settings(config, 0), cache_root(), progress=Progress()).captures[0]


def measure(folder: Path, small: Path) -> list[float]:
    """Seconds for the database and per goal object, and the MB by which the process grew; after a small scene."""
    cv2.setNumThreads(1)
    torch.set_num_threads(1)
    session = Session()
    for path in (small, folder):
        capture = load_capture(path)
        size, start = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.process_time()
        session.database(capture.current)
        built = time.process_time()
        found = session.estimate(capture.goal)
        times = [built - start, (time.process_time() - built) / max(len(found), 1)]
    return [*times, (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - size) / 1e3]


def alone(work: Callable[..., list[float]], *arguments: object) -> list[float]:
    """What some work gives in a process of its own."""
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        return pool.submit(work, *arguments).result()


def with_slopes(sizes: Sequence[int], times: Sequence[float]) -> list[str]:
    """Exponents between one size and the next."""
    pairs = zip(zip(sizes, times, strict=True), zip(sizes[1:], times[1:], strict=True), strict=False)
    return ["", *(f"{math.log(t / s) / math.log(b / a):.2f}" for (a, s), (b, t) in pairs)]


def search(name: str, size: int) -> tuple[float, float]:
    """Milliseconds to build an index, and to ask it for the ten best of eight queries; medians of several."""
    rng = np.random.default_rng(0)
    vectors, queries = (rng.standard_normal((n, WIDTH), np.float32) for n in (size, 8))
    index: Any = INDEXES.create(name)

    def clock(work: Callable[[], Any]) -> float:
        times: list[float] = []
        for _ in range(3 if size > 10_000 else 20):
            start = time.perf_counter()
            work()
            times.append(1e3 * (time.perf_counter() - start))
        return float(np.median(times))

    return clock(lambda: index.build(vectors)), clock(lambda: index.search(queries, 10))


def run_seconds(scenes: int, workers: int, backend: str) -> float:
    """Wall time of the quick experiment with one cell, without a cache; its scenes are there already."""
    cell = {"dataset.scenes": [scenes], "dataset.rotation_deg": [180], "pipeline.views": ["all"]}
    experiment = load_experiment("quick", cell)
    open_dataset(only_cell(experiment).dataset, cache_root(), progress=Progress())
    with tempfile.TemporaryDirectory() as folder:
        start = time.perf_counter()
        drive(
            Ablation(),
            experiment,
            RunOptions(out=Path(folder) / "run", workers=workers, backend=backend, use_cache=False),
        )
        return time.perf_counter() - start


def main() -> None:
    """Run the benchmark and print its tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, action="append", help="8, 16, 32, 64 and 128 when left out")
    parser.add_argument("--objects", type=int, action="append", help="1, 3, 6, 12 and 24 when left out")
    parser.add_argument("--scenes", type=int, default=16, help="of the longest run")
    options = parser.parse_args()

    print(f"{machine()}\n")
    small = scene(8, 3)
    columns = ["database, s", "slope", "goal object, s", "grows by, MB"]
    for what, sizes, folder in (
        ("frames", options.frames or [8, 16, 32, 64, 128], lambda size: scene(size, 5)),
        ("objects", options.objects or [1, 3, 6, 12, 24], lambda size: scene(8, size)),
    ):
        database, goal, memory = zip(*(alone(measure, folder(size), small) for size in sizes), strict=True)
        lines = [
            [str(n), f"{d:.2f}", slope, f"{g:.2f}", f"{m:.0f}"]
            for n, d, slope, g, m in zip(sizes, database, with_slopes(sizes, database), goal, memory, strict=True)
        ]
        print(table([what, *columns], lines))

    names = INDEXES.names()
    lines = [[str(size), *(f"{value:.3f}" for name in names for value in search(name, size))] for size in SIZES]
    print(table(["vectors", *(f"{name} {what}, ms" for name in names for what in ("build", "search"))], lines))

    backends = ["loky", *(["dask"] if find_spec("distributed") else [])]
    first = run_seconds(options.scenes // 4, 1, "loky"), run_seconds(options.scenes, 1, "loky")
    lines = [["1", "loky", *(f"{seconds:.1f}" for seconds in first), "", ""]]
    for backend in backends:
        both = [run_seconds(scenes, cores(), backend) for scenes in (options.scenes // 4, options.scenes)]
        efficiency = [f"{one / seconds / cores():.0%}" for one, seconds in zip(first, both, strict=True)]
        lines.append([str(cores()), backend, *(f"{seconds:.1f}" for seconds in both), *efficiency])
    sizes = [f"{scenes} scenes" for scenes in (options.scenes // 4, options.scenes)]
    header = ["workers", "backend", *(f"{size}, s" for size in sizes), *(f"efficiency, {size}" for size in sizes)]
    print(table(header, lines))


if __name__ == "__main__":
    main()
