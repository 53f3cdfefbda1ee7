"""Plan an arm's motions between collision-free poses over a cluttered table; prints Markdown.

Planners are shown points all over the objects' surfaces. Times are processor time; what a planner does once per scene
stands apart. PyBullet judges every path by the objects' own shapes.

python experiments/benchmarks/motion.py --pairs 500
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from contextlib import closing
from typing import Any, cast

import numpy as np
import trimesh
from rich.console import Console
from rich.progress import track

from toolkit.data.objects import load_object_set
from toolkit.data.tabletop import TabletopConfig, TabletopScene, draw_scene
from toolkit.geometry import make_transform, transform_points
from toolkit.paths import cache_root
from toolkit.rearrangement.executors.arm import ArmConfig, base_pose
from toolkit.rearrangement.moves import MotionProblem
from toolkit.rearrangement.paths import densify, length
from toolkit.results.stats import wilson_interval
from toolkit.sim.bullet import silence
from toolkit.sim.clearance import Clearance
from toolkit.sim.client import Client
from toolkit.sim.compound import add_compound
from toolkit.sim.robot import Robot
from toolkit.sim.robots import RobotModel, find_robot
from toolkit.stages import MOTION_PLANNERS, MotionPlanner
from toolkit.types import Failure, Float

PAIRS_A_SCENE = 10
REACH_M = (0.35, 0.7)
POINTS, LOWEST_M = 20000, 0.002
JUDGED_RAD = 0.02
"""Way between two poses that the judge looks at: half of what lies between those that planners check."""


def main() -> None:
    """Run the benchmark and print its table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robot", default="gen3", help="gen3, panda, or a robot's folder")
    parser.add_argument("--objects", default="procedural")
    parser.add_argument("--pairs", type=int, default=500)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()

    base, robot = base_pose(ArmConfig()), find_robot(options.robot)
    config = TabletopConfig(objects=options.objects, min_objects=8, max_objects=9, seed=options.seed)
    objects = load_object_set(options.objects, cache_root())
    planners = {name: MOTION_PLANNERS.create(name) for name in MOTION_PLANNERS.names()}
    times: dict[str, list[float]] = {name: [] for name in planners}
    lengths: dict[str, list[float]] = {name: [] for name in planners}
    first: dict[str, list[float]] = {name: [] for name in planners}
    straight: list[float] = []
    touching: Counter[str] = Counter()
    reasons: Counter[tuple[str, str]] = Counter()
    scenes = range(-(-options.pairs // PAIRS_A_SCENE))
    for number in track(scenes, console=Console(stderr=True)):
        scene = draw_scene(config, objects, number, cache_root())
        rng = np.random.default_rng([options.seed, number])
        count = min(PAIRS_A_SCENE, options.pairs - number * PAIRS_A_SCENE)
        with closing(Client()) as client:
            judge = Judge(client, robot, base, scene)
            clearance = Clearance(judge.robot, ArmConfig().margin_m)
            clearance.see(np.zeros((0, 3)), surfaces(scene))
            pairs = [(free_pose(clearance, base, rng), free_pose(clearance, base, rng)) for _ in range(count)]
            lines = [float(np.linalg.norm(goal - start)) for start, goal in pairs]
            straight += lines
            problems = [problem_of(clearance, *ends) for ends in ((np.array(robot.home),) * 2, *pairs)]
            for name, planner in planners.items():
                spent, answers = zip(*(timed(planner, problem, i) for i, problem in enumerate(problems)), strict=True)
                first[name].append(spent[0])
                times[name] += spent[1:]
                for path, line in zip(answers[1:], lines, strict=True):
                    if isinstance(path, Failure):
                        reasons[name, path.reason] += 1
                    else:
                        lengths[name].append(length(path) / line)
                        touching[name] += any(map(judge.touches, densify(path, JUDGED_RAD)))
    print(f"{options.robot}, {len(straight)} pairs, hands 2 to 30 cm over tables of 8 to 9 objects\n")
    print("| motion | found | 95 % interval | touch | median ms | 95th percentile ms | length / line | once, ms |")
    print("| --- | --- | --- | --- | --- | --- | --- | --- |")
    for name in planners:
        low, high = wilson_interval(len(lengths[name]), len(straight))
        print(
            f"| {name} | {len(lengths[name])} of {len(straight)} | {low:.1%} to {high:.1%} | {touching[name]} | "
            f"{np.median(times[name]):.1f} | {np.percentile(times[name], 95):.1f} | "
            f"{np.mean(lengths[name]):.3f} | {np.median(first[name]):.0f} |"
        )
    for (name, reason), count in reasons.most_common():
        print(f"- {name}, {count}: {reason}")


class Judge:
    """The robot among a scene's true shapes, in a client of PyBullet."""

    def __init__(self, client: Client, model: RobotModel, base: Float, scene: TabletopScene) -> None:
        self._client = client
        self.robot = Robot(client, model, base)
        self._bodies = [client.add_plane()]
        for link in self.robot.base_links:
            client.ignore(self.robot.body, self._bodies[0], link)
        for asset, pose in zip(scene.assets, scene.current, strict=True):
            with silence():
                # A mass, because PyBullet looks for no contacts between bodies without one.
                self._bodies.append(int(client.createMultiBody(1, add_compound(client, asset.hulls))))
            client.place(self._bodies[-1], pose)

    def touches(self, q: Float) -> bool:
        """Say whether the arm cuts into the table or an object at (J,) joint angles."""
        self.robot.set(q)
        self._client.performCollisionDetection()
        contacts = self._client.contacts(self.robot.body)
        return any(contact.distance < 0 and contact.other in self._bodies for contact in contacts)


def surfaces(scene: TabletopScene) -> Float:
    """(N, 3) points all over the objects, above the table."""
    clouds: list[Float] = []
    for asset, pose in zip(scene.assets, scene.current, strict=True):
        mesh = cast(Any, trimesh.load(asset.mesh, force="mesh"))
        clouds.append(transform_points(pose, np.asarray(trimesh.sample.sample_surface(mesh, POINTS, seed=0)[0])))
    points = np.concatenate(clouds)
    return points[points[:, 2] > LOWEST_M]


def problem_of(clearance: Clearance, start: Float, goal: Float) -> MotionProblem:
    """From one pose to another, among things as arranged."""
    chain = clearance.robot.chain
    return MotionProblem(start, goal, chain.lower, chain.upper, clearance.free, clearance.world())


def timed(planner: MotionPlanner, problem: MotionProblem, seed: int) -> tuple[float, Float | Failure]:
    """Milliseconds of processor time that a planner takes, and its answer."""
    begun = time.process_time()
    answer = planner.plan(problem, seed)
    return 1e3 * (time.process_time() - begun), answer


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
