"""Plan an arm's motions between collision-free poses over a cluttered table; prints Markdown.

python experiments/benchmarks/motion.py --pairs 500
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from contextlib import closing

import numpy as np
from rich.console import Console
from rich.progress import track

from toolkit.data.objects import load_object_set
from toolkit.data.tabletop import TabletopConfig, draw_scene
from toolkit.geometry import make_transform
from toolkit.paths import cache_root
from toolkit.rearrangement.executors.arm import ArmConfig, base_pose
from toolkit.rearrangement.moves import MotionProblem
from toolkit.rearrangement.paths import length
from toolkit.results.stats import wilson_interval
from toolkit.sim.clearance import Clearance
from toolkit.sim.robots import ROBOTS
from toolkit.stages import MOTION_PLANNERS
from toolkit.types import Failure, Float

PAIRS_A_SCENE = 10
REACH_M = (0.35, 0.7)


def main() -> None:
    """Run the benchmark and print its table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robot", choices=sorted(ROBOTS), default="gen3")
    parser.add_argument("--objects", default="procedural")
    parser.add_argument("--pairs", type=int, default=500)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()

    arm = ArmConfig()
    base = base_pose(arm)
    config = TabletopConfig(objects=options.objects, min_objects=8, max_objects=9, seed=options.seed)
    objects = load_object_set(options.objects, cache_root())
    planners = {name: MOTION_PLANNERS.create(name) for name in MOTION_PLANNERS.names()}
    times: dict[str, list[float]] = {name: [] for name in planners}
    lengths: dict[str, list[float]] = {name: [] for name in planners}
    straight: list[float] = []
    reasons: Counter[tuple[str, str]] = Counter()
    scenes = range(-(-options.pairs // PAIRS_A_SCENE))
    for number in track(scenes, console=Console(stderr=True)):
        scene = draw_scene(config, objects, number, cache_root())
        rng = np.random.default_rng([options.seed, number])
        with closing(Clearance(ROBOTS[options.robot], base, [asset.hulls for asset in scene.assets])) as clearance:
            clearance.arrange(scene.current, ROBOTS[options.robot].drive[0])
            for pair in range(min(PAIRS_A_SCENE, options.pairs - number * PAIRS_A_SCENE)):
                start, goal = free_pose(clearance, base, rng), free_pose(clearance, base, rng)
                chain = clearance.robot.chain
                problem = MotionProblem(start, goal, chain.lower, chain.upper, clearance.free, arm.search_s)
                straight.append(float(np.linalg.norm(goal - start)))
                for name, planner in planners.items():
                    begun = time.perf_counter()
                    path = planner.plan(problem, pair)
                    times[name].append(1e3 * (time.perf_counter() - begun))
                    if isinstance(path, Failure):
                        reasons[name, path.reason] += 1
                    else:
                        lengths[name].append(length(path) / straight[-1])
    print(f"{options.robot}, {len(straight)} pairs, hands 2 to 30 cm over tables of 8 to 9 objects\n")
    print("| motion | found | 95 % interval | median ms | 95th percentile ms | median length / straight line |")
    print("| --- | --- | --- | --- | --- | --- |")
    for name in planners:
        low, high = wilson_interval(len(lengths[name]), len(straight))
        print(
            f"| {name} | {len(lengths[name])} of {len(straight)} | {low:.1%} to {high:.1%} | "
            f"{np.median(times[name]):.0f} | "
            f"{np.percentile(times[name], 95):.0f} | {np.median(lengths[name]):.2f} |"
        )
    for (name, reason), count in reasons.most_common():
        print(f"- {name}, {count}: {reason}")


def free_pose(clearance: Clearance, base: Float, rng: np.random.Generator) -> Float:
    """(J,) angles that bring the gripper, pointing down, somewhere over the table and touch nothing."""
    robot = clearance.robot
    home = np.array(robot.model.home)
    while True:
        distance, azimuth, yaw = rng.uniform(*REACH_M), rng.uniform(0.2, np.pi - 0.2), rng.uniform(-np.pi, np.pi)
        place = base[:3, 3] + [distance * np.cos(azimuth), distance * np.sin(azimuth), rng.uniform(0.02, 0.30)]
        c, s = np.cos(yaw), np.sin(yaw)
        tips = make_transform(np.array([[c, s, 0], [s, -c, 0], [0, 0, -1.0]]), place)
        hand = tips @ np.linalg.inv(robot.T_hand_tips(robot.model.gripper.stroke_m))
        for q in robot.chain.solve(hand, home + rng.uniform(-1, 1, (4, len(home)))):
            if clearance.free(q):
                return q


if __name__ == "__main__":
    main()
