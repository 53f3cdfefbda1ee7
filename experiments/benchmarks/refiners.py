"""Time an object's way through the pipeline, and how it grows with points, hypotheses and views; prints Markdown.

toolkit dataset build captures --scenes 4 --seed 0
python experiments/benchmarks/refiners.py captures
"""

from __future__ import annotations

import argparse
import time
from collections import defaultdict
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
from rich.console import Console
from rich.progress import track

from toolkit.data.bop import load_capture
from toolkit.data.dataset import read_dataset
from toolkit.harness.experiment import expand, load_experiment
from toolkit.harness.worker import make_runner
from toolkit.perception.database import Database
from toolkit.perception.fusion import FusedModel, fuse
from toolkit.perception.pipeline import Pipeline
from toolkit.perception.refiners import cloud
from toolkit.perception.refiners.comparing.compare import compare
from toolkit.perception.refiners.comparing.goal import LEVELS_PX, view_goal
from toolkit.perception.refiners.render_compare import RenderCompare, RenderCompareConfig
from toolkit.types import Frame, Segment


def timed(call: Callable[[], Any], repeats: int) -> float:
    """Median milliseconds of `repeats` calls, after one that may compile."""
    call()
    times: list[float] = []
    for _ in range(repeats):
        start = time.perf_counter()
        call()
        times.append(1e3 * (time.perf_counter() - start))
    return float(np.median(times))


def whole_objects(
    pipeline: Pipeline, database: Database, goal: Frame, repeats: int, times: dict[str, list[float]]
) -> None:
    """Add what every goal object costs from its mask to its motion, all routes included, and what each stage of it.

    The first estimate pays for compilation and for what is kept with the database; how much that is, is told apart.
    """
    pipeline.estimate(database, goal)
    again = replace(database)
    pipeline.meter.take()
    first = [sum(estimate.time_ms.values()) for estimate in pipeline.estimate(again, goal)]
    runs = [[dict(estimate.time_ms) for estimate in pipeline.estimate(again, goal)] for _ in range(repeats)]
    for paid, own in zip(first, zip(*runs, strict=True), strict=True):
        median = float(np.median([sum(run.values()) for run in own]))
        times["one object, every route"].append(median)
        for stage in ("descriptor", "matcher", "pnp", "refiner"):
            times[f"of that, {stage}"].append(float(np.median([run[stage] for run in own])))
        times["once per database, for each object"].append(paid - median)


def of_views(database: Database, views: int) -> Database:
    """The database as fewer views, evenly spaced, would have made it."""
    chosen = {database.frames[len(database.frames) * i // views].index for i in range(views)}
    rows = [row for row, region in enumerate(database.regions) if region.frame_index in chosen]
    regions = tuple(database.regions[row] for row in rows)
    return replace(
        database, regions=regions, instances=database.instances[rows], descriptors=database.descriptors[rows]
    )


def main() -> None:
    """Run the benchmark and print its table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dataset", type=Path)
    parser.add_argument("--repeats", type=int, default=5)
    options = parser.parse_args()

    cell = expand(load_experiment("render_compare"))[0]
    pipeline = make_runner(cell, None).pipeline
    names = ["render_compare", *(f"{n} yaws" for n in (18, 36, 144)), "prior none"]
    settings = [{}, *({"yaws": n} for n in (18, 36, 144)), {"prior": "none"}]
    refiners = [RenderCompare(RenderCompareConfig.model_validate(chosen)) for chosen in settings]
    times: dict[str, list[float]] = defaultdict(list)
    for folder in track(read_dataset(options.dataset), console=Console(stderr=True)):
        capture = load_capture(folder)
        database = pipeline.build_database(capture.current)
        whole_objects(pipeline, database, capture.goal, options.repeats, times)
        segments = [Segment(mask) for mask in (capture.goal.true_masks or {}).values()]
        for instance, segment in enumerate(segments[: int(database.instances.max()) + 1]):
            for views in (2, 4, 8):
                few = of_views(database, views)
                times[f"fuse {views} views"].append(timed(partial(fuse, few, instance), options.repeats))
            model = fuse(database, instance)
            if not isinstance(model, FusedModel):
                continue
            cut = partial(view_goal, capture.goal, segment, [s for s in segments if s is not segment])
            goal = cut()
            times["cut out the goal"].append(timed(cut, options.repeats))
            for points in (256, 4096, cloud.SHAPE_POINTS):
                with mock.patch.object(cloud, "SHAPE_POINTS", points):
                    sampled = cloud.Cloud(model, LEVELS_PX, np.zeros(3))
                usual = refiners[0].search(sampled)
                search = partial(compare, sampled, goal, (), usual)
                times[f"render_compare with {points} points"].append(timed(search, options.repeats))
            variants = dict(zip(names, (refiner.search(sampled) for refiner in refiners), strict=True))
            variants |= {f"{n} refined": replace(usual, kept=n) for n in (5, 20)}
            variants |= {f"{n} views compared": replace(usual, patches=n) for n in (1, 4)}
            for name, search in variants.items():
                times[name].append(timed(partial(compare, sampled, goal, (), search), options.repeats))
    print("| what | median, ms | p90, ms | against render_compare |\n| --- | --- | --- | --- |")
    reference = np.median(times["render_compare"])
    for name, own in times.items():
        print(f"| {name} | {np.median(own):.0f} | {np.quantile(own, 0.9):.0f} | {np.median(own) / reference:.2f} |")


if __name__ == "__main__":
    main()
