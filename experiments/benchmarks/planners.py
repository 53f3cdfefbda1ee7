"""Compare planners on puzzles that need objects to stand aside: success, moves, travel and time; prints Markdown.

python experiments/benchmarks/planners.py --repeats 5

Shares have Wilson's 95 % intervals, means have bootstrap intervals over puzzles. Means are over the puzzles that a
planner solves, but for "moves / optimal's", which is over those that both solve.
"""

from __future__ import annotations

import argparse
import time
from collections import defaultdict
from dataclasses import dataclass

import numpy as np
from rich.console import Console
from rich.progress import track

from toolkit.rearrangement.moves import Layout, Plan
from toolkit.rearrangement.planners.ordering.order import travelled
from toolkit.rearrangement.planners.puzzles.rollout import rollout
from toolkit.rearrangement.planners.puzzles.suite import suite
from toolkit.results.stats import bootstrap_interval, wilson_interval
from toolkit.stages import PLANNERS

FAMILIES = {"swaps": "swaps, cycles", "cycles of 3": "swaps, cycles", "cycles of 4": "swaps, cycles"}
"""Kinds of puzzles that share a row; all others have their own."""

REFERENCE = "optimal"


@dataclass(frozen=True)
class Result:
    """One planner on one puzzle; metres per object of the way with the hand empty, and carrying."""

    plan: Plan
    ms: float
    empty: float
    loaded: float

    @classmethod
    def of(cls, name: str, layout: Layout, seed: int) -> Result:
        """Run a planner; processor time."""
        planner = PLANNERS.create(name)
        start = time.process_time()
        plan = rollout(planner, layout, seed)
        ms = 1e3 * (time.process_time() - start)
        count = sum(item.wanted for item in layout.items)
        picks = np.zeros((len(plan.moves), 2))
        for pick, move in zip(picks, plan.moves, strict=True):
            pick[:] = layout.item(move.object).footprint.center
            layout = layout.after(move)
        places = np.array([move.footprint.center for move in plan.moves]).reshape(-1, 2)
        loaded = float(np.linalg.norm(places - picks, axis=1).sum())
        return cls(plan, ms, travelled(range(len(picks)), picks, places) / count, loaded / count)


def main() -> None:
    """Run the benchmark and print its table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--repeats", type=int, default=10, help="puzzles of every kind and size")
    parser.add_argument("--most", type=int, default=60, help="objects; larger puzzles are left out")
    options = parser.parse_args()

    results: dict[str, dict[str, list[Result]]] = defaultdict(lambda: defaultdict(list))
    for puzzle in track(suite(options.seed, options.repeats, options.most), console=Console(stderr=True)):
        for name in PLANNERS.names():
            found = Result.of(name, puzzle.layout, options.seed)
            results[FAMILIES.get(puzzle.kind, puzzle.kind)][name].append(found)
    print("| puzzles | planner | solved | proven | moves / bound | moves / optimal's | empty, m | loaded, m | ms |")
    print("| --- | --- | --- | --- | --- | --- | --- | --- | --- |")
    for family, by_planner in results.items():
        for name, own in by_planner.items():
            print(f"| {family} ({len(own)}) | {name} | {row(own, by_planner[REFERENCE])} |")


def row(own: list[Result], reference: list[Result]) -> str:
    """What a planner made of a family of puzzles, beside what the reference made of the same ones."""
    solved = [r for r in own if not r.plan.failures]
    both = [(r, o) for r, o in zip(own, reference, strict=True) if not r.plan.failures and not o.plan.failures]
    low, high = wilson_interval(len(solved), len(own))
    cells = (
        f"{100 * len(solved) / len(own):.0f}% [{100 * low:.0f}, {100 * high:.0f}]",
        f"{sum(r.plan.proven_optimal for r in own)}",
        mean([len(r.plan.moves) / r.plan.lower_bound for r in solved]),
        mean([len(r.plan.moves) / len(o.plan.moves) for r, o in both]),
        mean([r.empty for r in solved]),
        mean([r.loaded for r in solved]),
        f"{np.median([r.ms for r in own]):.0f}",
    )
    return " | ".join(cells)


def mean(values: list[float]) -> str:
    """With its interval; a dash where there is none."""
    if not values:
        return "-"
    low, high = bootstrap_interval(np.array(values), np.arange(len(values)), lambda drawn: float(drawn.mean()))
    return f"{np.mean(values):.2f} [{low:.2f}, {high:.2f}]"


if __name__ == "__main__":
    main()
