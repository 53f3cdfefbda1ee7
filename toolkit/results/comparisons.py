"""Compares cells on the same scenes, object by object: the difference, and how sure it is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

from toolkit.results.rows import CellSummary, Row, summarize
from toolkit.results.stats import (
    PairedDifference,
    holm,
    mcnemar,
    objects_for_mcnemar,
    paired_difference,
    resolvable_difference,
    scenes_to_resolve,
)
from toolkit.results.tables import motion_table

AS_IT_IS = "as it is"
"""The cell that others are compared with in an attribution: the experiment without any truth put in."""

ALL_TRUE = "all of these true"
"""The cell of an attribution with every truth put in at once."""

_ALPHA = 0.05
_MANY_SCENES = 100_000
"""Nobody runs more scenes than this."""


@dataclass(frozen=True)
class Comparison:
    """A cell against another one of the same dataset, on the objects both have.

    Attributes:
        cell: its name.
        against: the cell it is compared with: the best one, or AS_IT_IS where that is among them.
        success: difference in success (5 deg, 2 cm, symmetry-aware), -1..1; below 0 where the cell is worse.
        completion: difference in scenes of which every object is right.
        objects: how many both cells have.
        discordant: share of them on which the cells disagree.
        p: McNemar's exact p-value of success, adjusted for all comparisons of the run (Holm).
        comparisons: how many those are.
    """

    cell: str
    against: str
    success: PairedDifference
    completion: PairedDifference
    objects: int
    discordant: float
    p: float
    comparisons: int

    @property
    def shown(self) -> bool:
        """The scenes show a difference: its interval leaves out 0, and p is below 0.05."""
        low, high = self.success.interval
        return not low <= 0 <= high and self.p < _ALPHA

    @property
    def verdict(self) -> str:
        """What the comparison shows, in words."""
        seen = self.success
        if self.shown:
            return f"{abs(100 * seen.mean):.1f} points {'worse' if seen.mean < 0 else 'better'}"
        if seen.scenes == 1:
            return "one scene shows nothing"
        if self.discordant == 0:
            return "the same on every object"
        said, points_seen, visible = "no difference shown", 100 * abs(seen.mean), 100 * self._visible
        if points_seen < visible:
            said += f"; a difference of {visible:.0f} points would most likely have shown"
        needed = self._needed
        if needed > _MANY_SCENES:
            return said
        return f"{said}; if the {points_seen:.1f} points seen are real, about {_rounded(needed)} scenes show it"

    @property
    def _alpha(self) -> float:
        """What a p-value before adjustment must be below, at worst."""
        return _ALPHA / self.comparisons

    @property
    def _visible(self) -> float:
        """The smallest difference, 0..1, that interval and p-value would most likely show."""
        scenes, a = self.success.scenes, self._alpha
        by_objects = resolvable_difference(self.objects, float(np.sqrt(self.discordant)), a)
        return min(1.0, max(resolvable_difference(scenes, self.success.deviation, a), by_objects))

    @property
    def _needed(self) -> float:
        """How many scenes would show the difference that was seen, by interval and by p-value; more than there were."""
        seen, a = self.success, self._alpha
        by_objects = objects_for_mcnemar(seen.mean, self.discordant, a) * seen.scenes / self.objects
        return max(scenes_to_resolve(seen.mean, seen.deviation, a), by_objects, seen.scenes + 1)


def compare_cells(rows: Sequence[Row]) -> list[Comparison]:
    """Every cell against AS_IT_IS, or without that against the best one of its dataset, in the order of the rows.

    Where the reference is the best cell, which is known only afterwards, the p-values are adjusted for all pairs.
    """
    outcomes: dict[str, dict[str, Outcomes]] = {}
    for row in rows:
        outcomes.setdefault(row.dataset, {}).setdefault(row.cell, {})[row.scene_id, row.object] = row.success_sym
    tests: dict[tuple[str, ...], float] = {}
    for data, cells in outcomes.items():
        for a, b in combinations(cells, 2):
            if AS_IT_IS not in cells or AS_IT_IS in (a, b):
                tests[data, *sorted((a, b))] = mcnemar(*_shared(cells[a], cells[b])[:2])
    adjusted = dict(zip(tests, holm(list(tests.values())), strict=True))
    comparisons: list[Comparison] = []
    for data, cells in outcomes.items():
        best = max(cells, key=lambda cell: float(np.mean(list(cells[cell].values()))))
        against = AS_IT_IS if AS_IT_IS in cells else best
        for cell, own in cells.items():
            mine, other, scenes = _shared(own, cells[against])
            if cell != against and scenes:
                success = paired_difference(mine, other, scenes)
                completion = paired_difference(*_by_scene(mine, other, scenes))
                p = adjusted[data, *sorted((cell, against))]
                discordant = float(np.mean(np.array(mine) != np.array(other)))
                found = Comparison(cell, against, success, completion, len(mine), discordant, p, len(tests))
                comparisons.append(found)
    return comparisons


def print_comparisons(comparisons: Sequence[Comparison], console: Console) -> None:
    """Print one line per comparison; nothing where there is none. A narrow console leaves out the scenes done."""
    if not comparisons:
        return
    wide = console.width >= 110
    attributes = comparisons[0].against == AS_IT_IS
    title = (
        "What each stage costs: the truth in its place" if attributes else "Against the best cell, on the same objects"
    )
    title += "; points [95 % interval over scenes], p by McNemar and Holm"
    table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, padding=(0, 1), pad_edge=False)
    table.add_column("cell", overflow="fold")
    for column in ("5 deg 2 cm", *(("scenes done",) if wide else ()), "p"):
        table.add_column(column, no_wrap=True)
    table.add_column("in words")
    for c in comparisons:
        done = (_show(c.completion),) if wide else ()
        table.add_row(c.cell, _show(c.success), *done, f"{c.p:.2g}", c.verdict)
    console.print(table)


def _show(difference: PairedDifference) -> str:
    low, high = difference.interval
    return f"{points(difference.mean)} [{points(low)}, {points(high)}]"


def print_results(rows: Sequence[Row], console: Console) -> None:
    """Print a run's table, its comparisons, and what an attribution leaves."""
    summaries = summarize(rows)
    motion_table(summaries).print(console)
    print_comparisons(compare_cells(rows), console)
    if left := remainder(summaries):
        console.print(left, highlight=False)


def remainder(summaries: Sequence[CellSummary]) -> str:
    """What an attribution leaves when every truth is put in at once, in a sentence; empty for other runs."""
    done = {summary.cell: summary.completion_sym for summary in summaries}
    if AS_IT_IS not in done or ALL_TRUE not in done:
        return ""
    left = done[ALL_TRUE]
    low, high = left.interval
    return (
        f"{done[AS_IT_IS].value:.0%} of scenes are done as it is, {left.value:.0%} ({low:.0%} to {high:.0%}) with "
        f"all of that true: the other {100 * (1 - left.value):.0f} points are lost in matching, PnP and refinement."
    )


def points(share: float) -> str:
    """A difference of shares in points, signed."""
    return f"{100 * share:+.1f}" if np.isfinite(share) else ("+∞" if share > 0 else "-∞")


Outcomes = dict[tuple[int, int], bool]
"""Success by (scene, object)."""


def _shared(a: Outcomes, b: Outcomes) -> tuple[list[bool], list[bool], list[int]]:
    """Both cells' outcomes on the objects they share, and the objects' scenes."""
    keys = sorted(a.keys() & b.keys())
    return [a[key] for key in keys], [b[key] for key in keys], [scene for scene, _ in keys]


def _by_scene(a: Sequence[bool], b: Sequence[bool], scenes: Sequence[int]) -> tuple[list[bool], list[bool], list[int]]:
    """The same with one outcome per scene: every object is right."""
    names = sorted(set(scenes))
    done = [[all(x for x, s in zip(cell, scenes, strict=True) if s == name) for name in names] for cell in (a, b)]
    return done[0], done[1], names


def _rounded(scenes: float) -> int:
    """Two figures: more would claim more than is known."""
    size = 10 ** max(0, len(str(int(scenes))) - 2)
    return int(np.ceil(scenes / size) * size)
