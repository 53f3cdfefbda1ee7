"""Views needed until as many objects are right as with all views, by the order of the views. Prints Markdown.

    toolkit dataset build scenes --objects ../shared/objects --scenes 10 --seed 0
    python plugins/active_view/measure.py scenes --scenes 10

Masks, association and retrieval are the truth's, so that what is left to find is each object's motion. Every order
starts with the home view, the first. `ring`: one after the other around the table; `spread`: each as far as can be from
those before; `random`: seeded by the scene. A second table shows the end where every object is sure.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path

import numpy as np
from toolkit_active_view import doubt, gains

from toolkit.data.bop import load_capture
from toolkit.data.dataset import read_dataset
from toolkit.perception.pipeline import Pipeline, PipelineSettings, Stages
from toolkit.results.scoring import score
from toolkit.results.stats import PairedDifference, bootstrap_interval, paired_difference
from toolkit.slots import SLOTS
from toolkit.stages import REGISTRIES
from toolkit.types import Capture

CHOICES = {
    "registration": "none",
    "segmenter": "oracle",
    "goal_segmenter": "oracle",
    "associator": "oracle",
    "descriptor": "color_hist",
    "index": "numpy",
    "retriever": "instance_vote",
    "matcher": "sift",
    "pnp": "poselib",
    "refiner": "render_compare",
}
Next = Callable[[list[int], list[int]], int]
"""Takes the views so far and those left; returns one of these."""


class Scene:
    """A capture, and what its views say; every set of views is looked at once."""

    def __init__(self, capture: Capture, number: int, pipeline: Pipeline) -> None:
        self.capture, self.number, self.pipeline = capture, number, pipeline
        self.perceive = cache(self._perceive)

    def _perceive(self, views: frozenset[int]):
        scene = self.pipeline.scene(self.pipeline.build_database([self.capture.current[i] for i in sorted(views)]))
        estimates = scene.estimate(self.capture.goal)
        return scene.database, estimates

    def right(self, views: frozenset[int]) -> int:
        """Objects right with these views."""
        return sum(row.success_sym for row in score(self.capture, self.perceive(views)[1]))

    def active(self, taken: list[int], left: list[int]) -> int:
        """The order that is measured."""
        database, estimates = self.perceive(frozenset(taken))
        cameras = [self.capture.current[i].camera for i in left]
        return left[int(np.argmax(gains(database, self.capture.goal, estimates, cameras)))]

    def sure(self, views: frozenset[int]) -> float:
        """Least confidence of all objects."""
        return 1 - max((doubt(estimate) for estimate in self.perceive(views)[1]), default=1.0)


def ring(taken: list[int], left: list[int]) -> int:
    """The next one around the table."""
    return left[0]


def spread(taken: list[int], left: list[int]) -> int:
    """The one furthest from those taken, on the ring; of equals the first."""
    count = len(taken) + len(left)
    return max(left, key=lambda i: (min(min((i - j) % count, (j - i) % count) for j in taken), -i))


def needed(scene: Scene, choose: Next, target: int) -> tuple[int, list[int]]:
    """Views until `target` objects are right; and the objects right after each of them."""
    taken, left = [0], list(range(1, len(scene.capture.current)))
    counts = [scene.right(frozenset(taken))]
    while counts[-1] < target and left:
        taken.append(choose(taken, left))
        left.remove(taken[-1])
        counts.append(scene.right(frozenset(taken)))
    return len(taken), counts


def until_sure(scene: Scene, levels: Sequence[float]) -> list[tuple[int, int]]:
    """(views, objects right) where the active order ends, by the confidence that every object must have."""
    taken, left = [0], list(range(1, len(scene.capture.current)))
    ends: dict[float, tuple[int, int]] = {}
    while len(ends) < len(levels):
        views = frozenset(taken)
        for level in levels:
            if level not in ends and (scene.sure(views) >= level or not left):
                ends[level] = len(taken), scene.right(views)
        if left:
            taken.append(scene.active(taken, left))
            left.remove(taken[-1])
    return [ends[level] for level in levels]


def signed(difference: PairedDifference, factor: float, digits: int) -> str:
    """A difference with its interval."""
    mean, low, high = (factor * v for v in (difference.mean, *difference.interval))
    return f"{mean:+.{digits}f} [{low:+.{digits}f}, {high:+.{digits}f}]"


def main() -> None:
    """Measure every scene in every order."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("dataset", type=Path)
    parser.add_argument("--scenes", type=int, default=10)
    parser.add_argument("--sure", type=float, nargs="+", default=[0.5, 0.7, 0.9])
    options = parser.parse_args()
    stages = Stages(**{slot: REGISTRIES[stage].create(CHOICES[slot]) for slot, stage in SLOTS.items()})
    views: dict[str, list[int]] = {}
    first: list[float] = []
    second: dict[str, list[float]] = {}
    objects, right_with_all = 0, 0
    ends: list[list[tuple[int, int]]] = []
    for number, folder in enumerate(read_dataset(options.dataset)[: options.scenes]):
        scene = Scene(load_capture(folder), number, Pipeline(stages, PipelineSettings(assignment="truth")))
        rng = np.random.default_rng(number)
        count = len(scene.capture.truth or {})
        target = scene.right(frozenset(range(len(scene.capture.current))))
        objects, right_with_all = objects + count, right_with_all + target
        orders: dict[str, Next] = {
            "active": scene.active,
            "ring": ring,
            "spread": spread,
            "random": lambda taken, left, rng=rng: int(rng.choice(left)),
        }
        for name, choose in orders.items():
            number_of_views, counts = needed(scene, choose, target)
            views.setdefault(name, []).append(number_of_views)
            second.setdefault(name, []).append(counts[min(1, len(counts) - 1)] / count)
        first.append(counts[0] / count)
        ends.append(until_sure(scene, options.sure))
        said = ", ".join(f"{name} {of[-1]}" for name, of in views.items())
        print(
            f"scene {number}: {target} of {count} with all views; needs {said}; ends {ends[-1]}",
            file=sys.stderr,
            flush=True,
        )
    scenes = np.arange(len(first))
    print(
        f"{len(scenes)} scenes, {objects} objects; {np.mean(first):.0%} of a scene's objects are right with one view.\n"
    )
    print("| order | views needed | more than active | right after two views | active gains, points |")
    print("| --- | --- | --- | --- | --- |")
    for name, of in views.items():
        low, high = bootstrap_interval(np.array(of, np.float64), scenes, lambda v: float(v.mean()))
        more = less = ""
        if name != "active":
            more = signed(paired_difference(of, views["active"], scenes.tolist()), 1, 2)
            less = signed(paired_difference(second["active"], second[name], scenes.tolist()), 100, 0)
        needs = f"{np.mean(of):.2f} [{low:.2f}, {high:.2f}]"
        print(f"| {name} | {needs} | {more} | {np.mean(second[name]):.0%} | {less} |")
    print(f"\nWith all views {right_with_all / objects:.1%} of the objects are right.\n")
    print("| every object at least this sure | views taken | objects right |")
    print("| --- | --- | --- |")
    for level, of_level in zip(options.sure, zip(*ends, strict=True), strict=True):
        took = np.array([n for n, _ in of_level], np.float64)
        low, high = bootstrap_interval(took, scenes, lambda v: float(v.mean()))
        share = sum(right for _, right in of_level) / objects
        print(f"| {level:g} | {took.mean():.2f} [{low:.2f}, {high:.2f}] | {share:.1%} |")


if __name__ == "__main__":
    main()
