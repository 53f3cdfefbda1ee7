"""Compare planners on puzzles that need objects to stand aside: moves, lower bound, time; prints Markdown.

python experiments/benchmarks/planners.py
"""

from __future__ import annotations

import argparse
import time
from collections import defaultdict
from dataclasses import dataclass

import numpy as np
from rich.console import Console
from rich.progress import track

from toolkit.rearrangement.moves import Plan
from toolkit.rearrangement.planners.puzzles.rollout import rollout
from toolkit.rearrangement.planners.puzzles.suite import suite
from toolkit.stages import PLANNERS


@dataclass(frozen=True)
class Result:
    """One planner on one puzzle."""

    plan: Plan
    ms: float

    @property
    def ratio(self) -> float:
        """Moves over the lower bound; infinite where an object did not get to its goal."""
        return np.inf if self.plan.failures else len(self.plan.moves) / self.plan.lower_bound


def main() -> None:
    """Run the benchmark and print its table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--repeats", type=int, default=10, help="puzzles of every kind and size")
    options = parser.parse_args()

    planners = {name: PLANNERS.create(name) for name in PLANNERS.names()}
    results: dict[tuple[str, str], list[Result]] = defaultdict(list)
    for puzzle in track(suite(options.seed, options.repeats), console=Console(stderr=True)):
        for name, planner in planners.items():
            start = time.perf_counter()
            plan = rollout(planner, puzzle.layout, options.seed)
            results[puzzle.name, name].append(Result(plan, 1e3 * (time.perf_counter() - start)))
    print("| puzzle, objects | planner | moves | lower bound | ratio | worst | proven optimal | unsolved | median ms |")
    print("| --- | --- | --- | --- | --- | --- | --- | --- | --- |")
    for (puzzle, planner), own in results.items():
        ratios = [result.ratio for result in own]
        print(
            f"| {puzzle} | {planner} | {np.mean([len(r.plan.moves) for r in own]):.1f} "
            f"| {np.mean([r.plan.lower_bound for r in own]):.1f} | {np.mean(ratios):.2f} | {max(ratios):.2f} "
            f"| {sum(r.plan.proven_optimal for r in own)} of {len(own)} | {sum(bool(r.plan.failures) for r in own)} "
            f"| {np.median([r.ms for r in own]):.0f} |"
        )


if __name__ == "__main__":
    main()
