"""How well the camera in the hand sees what it holds and has put down, against the simulator; prints Markdown.

Every object of the scenes of the experiment `arm` is taken to its goal and back, by its points from all views and its
true motion: once with what the camera sees, and once with what the simulator measures. "As planned" is how wrong it
would be not to look. A move is right when the object ends within 2 cm and 5 deg of where it was to be.

python experiments/benchmarks/looks.py --scenes 8
"""

from __future__ import annotations

import argparse
from collections import Counter, defaultdict
from collections.abc import Iterator
from contextlib import closing

import numpy as np
from rich.console import Console
from rich.progress import track

from toolkit.data.objects import load_object_set
from toolkit.data.tabletop import TabletopConfig, TabletopScene, draw_scene
from toolkit.geometry import invert, rotation_angle, transform_points
from toolkit.harness.experiment import expand, load_experiment
from toolkit.harness.worker import make_runner
from toolkit.paths import cache_root
from toolkit.perception.pipeline import Pipeline
from toolkit.rearrangement.executors.arm import Arm, ArmConfig
from toolkit.rearrangement.executors.handling.looking import Look
from toolkit.rearrangement.executors.handling.mover import Eye
from toolkit.rearrangement.executors.handling.reach import Reach
from toolkit.rearrangement.hidden import hidden_space
from toolkit.rearrangement.moves import Outcome, PickPlace
from toolkit.rearrangement.plans import Way
from toolkit.results.stats import wilson_interval
from toolkit.types import Failure, Float


class Judge(Eye):
    """A look that is compared with the truth.

    Args:
        arm: keeps what is found.
        number: the object's.
        request: the move.
        look: what is compared.
        plain: says where the hand is.
    """

    def __init__(self, arm: Judged, number: int, request: PickPlace, look: Eye, plain: Look) -> None:
        self._arm, self._number, self._request, self._look, self._plain = arm, number, request, look, plain
        self._before = arm.state()[number]

    def expected(self) -> Float:
        return self._look.expected()

    def in_hand(self, expected: Float) -> Float | Failure:
        hand = invert(self._plain.expected())
        seen = self._look.in_hand(expected)
        self._note("in the hand", hand @ expected, seen if isinstance(seen, Failure) else hand @ seen)
        return seen

    def adapted(self, way: Way, in_hand: Float) -> Way | Failure:
        return self._look.adapted(way, in_hand)

    def placed(self, expected: Float) -> Float | Failure:
        seen = self._look.placed(expected)
        self._note("put down", expected, seen)
        mm, degrees = _error(self._truth, self._request.T_place_pick, self._middle)
        self._arm.right.append(mm < 20 and degrees < 5)
        return seen

    def _note(self, what: str, expected: Float, seen: Float | Failure) -> None:
        found = (expected, expected if isinstance(seen, Failure) else seen)
        self._arm.errors[what].append(np.array([_error(T, self._truth, self._middle) for T in found]))
        self._arm.unseen[what] += [seen.reason] if isinstance(seen, Failure) else []

    @property
    def _truth(self) -> Float:
        return self._arm.state()[self._number] @ invert(self._before)

    @property
    def _middle(self) -> Float:
        return self._request.points.mean(axis=0)


class Judged(Arm):
    """An arm whose looks are compared with the truth."""

    def __init__(self, config: ArmConfig) -> None:
        super().__init__(config)
        self.errors: dict[str, list[Float]] = defaultdict(list)
        """(2, 2) a look: mm and degrees, as planned and as seen."""
        self.unseen: dict[str, list[str]] = defaultdict(list)
        self.right: list[bool] = []

    def _eye(self, number: int, request: PickPlace, reach: Reach) -> Eye:
        plain = Look(self._driver, self._bench.robot, request, reach)
        return Judge(self, number, request, super()._eye(number, request, reach), plain)


def _error(T: Float, truth: Float, middle: Float) -> list[float]:
    shift = np.linalg.norm(transform_points(T, middle) - transform_points(truth, middle))
    return [1e3 * float(shift), float(np.degrees(rotation_angle(T[:3, :3] @ truth[:3, :3].T)))]


def moves(arm: Arm, scene: TabletopScene, pipeline: Pipeline) -> Iterator[Outcome]:
    """Take every object to its goal and back, with all others where they were at first."""
    database = pipeline.build_database(arm.observe())
    clouds = {i: points for i, (points, _) in pipeline.scene(database).clouds().items()}
    hidden, unknown = hidden_space(database.frames, clouds)
    for instance, points in clouds.items():
        others = [hidden[i] for i in clouds if i != instance] + [clouds[i] for i in clouds if i != instance]
        around = np.concatenate([unknown, *others])
        number = min(arm.state(), key=lambda n: float(np.linalg.norm(arm.state()[n][:2, 3] - points.mean(axis=0)[:2])))
        T = scene.goal[number] @ invert(scene.current[number])
        outcome = arm.pick_place(PickPlace(points, T, around))
        yield outcome
        if outcome.T_moved is not None:
            back = transform_points(outcome.T_moved, points)
            yield arm.pick_place(PickPlace(back, invert(outcome.T_moved), around))


def main() -> None:
    """Run the benchmark and print its table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", type=int, default=8)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--robots", nargs="+", default=["gen3", "panda"])
    options = parser.parse_args()

    cell = expand(load_experiment("arm", {"pipeline.associator": ["oracle"]}))[0]
    pipeline = make_runner(cell, None).pipeline
    config = TabletopConfig.model_validate({**cell.dataset, "scenes": options.scenes, "seed": options.seed})
    objects = load_object_set(config.objects, cache_root())
    reasons: Counter[str] = Counter()
    looks = [
        "| robot | look | looks | seen | 95 % | as planned: mm | 90th | deg | 90th | seen: mm | 90th | deg | 90th |"
    ]
    looks.append("| --- " * 13 + "|")
    ended = ["| robot | look | moves | right | 95 % | with a contact |", "| --- " * 6 + "|"]
    for robot in options.robots:
        for how in ("seen", "measured"):
            arm = Judged(ArmConfig(robot=robot, look=how))
            touched = 0
            for number in track(range(options.scenes), console=Console(stderr=True)):
                scene = draw_scene(config, objects, number, cache_root())
                with closing(arm):
                    arm.begin(scene)
                    touched += sum(outcome.touched for outcome in moves(arm, scene, pipeline))
            count, right = len(arm.right), sum(arm.right)
            low, high = wilson_interval(right, count)
            ended.append(f"| {robot} | {how} | {count} | {right} | {low:.0%} to {high:.0%} | {touched} |")
            if how == "measured":
                continue
            for what, errors in arm.errors.items():
                looks.append(_line(robot, what, np.array(errors), len(arm.unseen[what])))
                reasons.update(f"{robot}, {what}: {reason}" for reason in arm.unseen[what])
    print("\n".join([*looks, "", *ended, "", "Not seen, and left as planned:"]))
    for reason, count in reasons.most_common():
        print(f"- {count}: {reason}")


def _line(robot: str, what: str, errors: Float, unseen: int) -> str:
    """A line of the table, from (N, 2, 2) errors."""
    count = len(errors)
    low, high = wilson_interval(count - unseen, count)
    figures = np.percentile(errors, [50, 90], axis=0).transpose(1, 2, 0).ravel()
    cells = [robot, what, count, count - unseen, f"{low:.0%} to {high:.0%}", *(f"{value:.1f}" for value in figures)]
    return "| " + " | ".join(map(str, cells)) + " |"


if __name__ == "__main__":
    main()
