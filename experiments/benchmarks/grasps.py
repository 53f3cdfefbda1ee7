"""Lift every object of simulated scenes with its best grasp, found on the fused cloud; prints Markdown.

python experiments/benchmarks/grasps.py --scenes 10
python experiments/benchmarks/grasps.py --scenes 10 --grasp contact_graspnet
"""

from __future__ import annotations

import argparse
import time
from collections import Counter, defaultdict

import numpy as np
from lift import lifted_height
from rich.console import Console
from rich.progress import track

from toolkit.data.objects import load_object_set
from toolkit.data.tabletop import TabletopConfig, draw_scene
from toolkit.harness.experiment import expand, load_experiment
from toolkit.harness.worker import make_runner
from toolkit.paths import cache_root
from toolkit.perception.fusion import FusedModel, fuse
from toolkit.rearrangement.episode import begun
from toolkit.rearrangement.executors.kinematic import Kinematic
from toolkit.rearrangement.moves import GraspRequest
from toolkit.results.stats import wilson_interval
from toolkit.sim.robots import ROBOTS
from toolkit.stages import GRASPERS
from toolkit.types import Failure

ORACLES = {"pipeline.segmenter": ["oracle"], "pipeline.associator": ["oracle"]}
APPROACH_M = 0.08
LIFTED_M = 0.02
"""An object whose lowest point ends higher than this is held."""


def main() -> None:
    """Run the benchmark and print its table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--grasp", default="antipodal", choices=GRASPERS.names())
    parser.add_argument("--objects", default="procedural")
    parser.add_argument("--scenes", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()

    cell = expand(load_experiment("rearrange", ORACLES))[0]
    pipeline = make_runner(cell, None).pipeline
    grasper = GRASPERS.create(options.grasp)
    gripper = ROBOTS["gen3"].gripper
    config = TabletopConfig(objects=options.objects, scenes=options.scenes, seed=options.seed)
    objects = load_object_set(options.objects, cache_root())
    outcomes: dict[str, list[bool | None]] = defaultdict(list)
    reasons: Counter[str] = Counter()
    times: list[float] = []
    for number in track(range(options.scenes), console=Console(stderr=True)):
        scene = draw_scene(config, objects, number, cache_root())
        executor = Kinematic()
        with begun(executor, scene):
            database = pipeline.build_database(executor.observe())
        models = [fuse(database, instance) for instance in range(int(database.instances.max()) + 1)]
        clouds = [model.points for model in models if isinstance(model, FusedModel)]
        if len(clouds) < len(scene.assets):  # one is hidden from all views
            continue
        for i, asset in enumerate(scene.assets):
            others = np.concatenate([np.zeros((0, 3)), *(cloud for j, cloud in enumerate(clouds) if j != i)])
            start = time.perf_counter()
            found = grasper.grasp(GraspRequest(clouds[i], np.eye(4), others, gripper, APPROACH_M), options.seed)
            times.append(1e3 * (time.perf_counter() - start))
            if isinstance(found, Failure):
                reasons[found.reason] += 1
                outcomes[asset.category].append(None)
                continue
            height = lifted_height(asset.hulls, asset.mass_kg, scene.current[i], found[0], gripper)
            outcomes[asset.category].append(height > LIFTED_M)
    print("| category | objects | with a grasp | lifted | 95 % interval |\n| --- | --- | --- | --- | --- |")
    everything = [outcome for own in outcomes.values() for outcome in own]
    for category, own in [*sorted(outcomes.items()), ("all", everything)]:
        tried = [outcome for outcome in own if outcome is not None]
        low, high = wilson_interval(sum(tried), len(tried))
        print(f"| {category} | {len(own)} | {len(tried)} | {sum(tried)} | {low:.0%} to {high:.0%} |")
    print(f"\nMedian {np.median(times):.0f} ms a search. Without a grasp:")
    for reason, count in reasons.most_common():
        print(f"- {count}: {reason}")


if __name__ == "__main__":
    main()
