"""Time the parts of render_compare on real objects, and how they grow with hypotheses and views; prints Markdown.

toolkit dataset build captures --scenes 4 --seed 0
python experiments/benchmarks/refiners.py captures
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import track

from toolkit.data.bop import load_capture
from toolkit.data.dataset import read_dataset
from toolkit.experiment import create_stage, expand, load_experiment, own_settings
from toolkit.fusion import FusedModel, fuse
from toolkit.pipeline import Pipeline, Stages
from toolkit.refiners.cloud import Cloud
from toolkit.refiners.compare import Search, compare
from toolkit.refiners.goal import LEVELS_PX, view_goal
from toolkit.refiners.render_compare import RenderCompare
from toolkit.slots import SLOTS
from toolkit.types import Segment

ORACLES = {"pipeline.segmenter": ["oracle"], "pipeline.goal_segmenter": ["oracle"], "pipeline.associator": ["oracle"]}


def timed(call: Callable[[], Any], repeats: int) -> float:
    """Median milliseconds of `repeats` calls, after one that may compile."""
    call()
    times: list[float] = []
    for _ in range(repeats):
        start = time.perf_counter()
        call()
        times.append(1e3 * (time.perf_counter() - start))
    return float(np.median(times))


def main() -> None:
    """Run the benchmark and print its table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dataset", type=Path)
    parser.add_argument("--repeats", type=int, default=5)
    options = parser.parse_args()

    cell = expand(load_experiment("estimate", ORACLES))[0]
    stages = Stages(**{slot: create_stage(cell.pipeline, slot) for slot in SLOTS})
    pipeline = Pipeline(stages, own_settings(cell.pipeline))
    usual = RenderCompare().search()
    variants: dict[str, Search] = {"render_compare": usual}
    variants |= {f"{n} yaws": RenderCompare(RenderCompare.Config(yaws=n)).search() for n in (18, 36, 144)}
    variants |= {f"{n} refined": replace(usual, kept=n) for n in (5, 20)}
    variants |= {f"{n} patches": replace(usual, patches=n) for n in (1, 4)}
    variants["prior none"] = RenderCompare(RenderCompare.Config(prior="none")).search()
    times: dict[str, list[float]] = {name: [] for name in ("fuse", "cut out the goal", *variants)}
    for folder in track(read_dataset(options.dataset), console=Console(stderr=True)):
        capture = load_capture(folder)
        database = pipeline.build_database(capture.current)
        segments = [Segment(mask) for mask in (capture.goal.true_masks or {}).values()]
        for instance, segment in enumerate(segments[: int(database.instances.max()) + 1]):
            model = fuse(database, instance)
            if not isinstance(model, FusedModel):
                continue

            cut = partial(view_goal, capture.goal, segment, [s for s in segments if s is not segment])
            cloud, goal = Cloud(model, LEVELS_PX, np.zeros(3)), cut()
            times["fuse"].append(timed(partial(fuse, database, instance), options.repeats))
            times["cut out the goal"].append(timed(cut, options.repeats))
            for name, search in variants.items():
                times[name].append(timed(partial(compare, cloud, goal, (), search), options.repeats))
    print("| what | median, ms | p90, ms | against render_compare |\n| --- | --- | --- | --- |")
    reference = np.median(times["render_compare"])
    for name, own in times.items():
        print(f"| {name} | {np.median(own):.0f} | {np.quantile(own, 0.9):.0f} | {np.median(own) / reference:.2f} |")


if __name__ == "__main__":
    main()
