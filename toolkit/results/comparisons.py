"""Compares cells on the same scenes, object by object: the difference, and how sure it is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from rich.console import Console

from toolkit.results.figure_table import Column, Figure, FigureTable, Line
from toolkit.results.rows import CellSummary, Judged
from toolkit.results.stats import (
    PairedDifference,
    holm,
    mcnemar,
    newcombe_interval,
    objects_for_mcnemar,
    paired_difference,
    resolvable_difference,
    scenes_to_resolve,
)

AS_IT_IS = "as it is"
"""The cell that others are compared with in an attribution: the experiment without any truth put in."""

ALL_TRUE = "all of these true"
"""The cell of an attribution with every truth put in at once."""

_ALPHA = 0.05
_WIDE = 110
_MANY_SCENES = 100_000
"""Nobody runs more scenes than this."""


@dataclass(frozen=True)
class Comparison:
    """A cell against another one of the same dataset, on the objects both have.

    Attributes:
        cell: its name.
        against: the cell it is compared with.
        success: difference in success (5 deg, 2 cm, symmetry-aware), -1..1; below 0 where the cell is worse. Its
            interval is found by resampling scenes, and holds Newcombe's for independent objects.
        completion: difference in scenes of which every object is right, with Newcombe's interval.
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
        said, points_seen, visible = self._unshown, 100 * abs(seen.mean), 100 * self._visible
        if points_seen < visible:
            said += f"; a difference of {visible:.0f} points would most likely have shown"
        needed = self._needed
        if needed > _MANY_SCENES:
            return said
        return f"{said}; if the {points_seen:.1f} points seen are real, about {_rounded(needed)} scenes show it"

    @property
    def _unshown(self) -> str:
        """Which of the two, the interval over scenes and the p-value over objects, shows no difference."""
        low, high = self.success.interval
        if self.p < _ALPHA:
            return "not shown over scenes: their interval holds 0 (p takes objects of one scene for independent)"
        if not low <= 0 <= high:
            return f"not shown object by object: p is not below {_ALPHA:g}"
        return "no difference shown"

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


def is_called(reference: str, cell: str, settings: Mapping[str, Any]) -> bool:
    """Whether a reference is a cell's name, or that of the `cells:` entry that its settings are of."""
    return reference in (cell, settings.get("cell"))


def compare_cells(rows: Sequence[Judged], reference: str = "") -> list[Comparison]:
    """Every cell of a dataset against the reference, in the order of the rows; p-values are adjusted for all of them.

    Args:
        rows: of a whole run.
        reference: a cell's name, or that of the `cells:` entry it is of; where a dataset has no such cell, its first.
    """
    outcomes: dict[str, dict[str, Outcomes]] = {}
    named: set[str] = set()
    for row in rows:
        outcomes.setdefault(row.dataset, {}).setdefault(row.cell, {})[row.scene_id, row.object] = row.success_sym
        if is_called(reference, row.cell, row.settings):
            named.add(row.cell)
    asked: list[tuple[str, str, list[bool], list[bool], list[int]]] = []
    for cells in outcomes.values():
        against = next((cell for cell in cells if cell in named), next(iter(cells)))
        for cell, own in cells.items():
            mine, other, scenes = _shared(own, cells[against])
            if cell != against and scenes:
                asked.append((cell, against, mine, other, scenes))
    adjusted = holm([mcnemar(mine, other) for _, _, mine, other, _ in asked])
    return [
        Comparison(
            cell,
            against,
            _over_objects(mine, other, scenes),
            _over_scenes(mine, other, scenes),
            len(mine),
            float(np.mean(np.array(mine) != np.array(other))),
            p,
            len(asked),
        )
        for (cell, against, mine, other, scenes), p in zip(asked, adjusted, strict=True)
    ]


def comparison_table(comparisons: Sequence[Comparison]) -> FigureTable:
    """One line per comparison, with what it shows in words."""
    against = dict.fromkeys(c.against for c in comparisons)
    named = f"Against '{next(iter(against))}', on the same objects" if len(against) == 1 else "On the same objects"
    title = "What each stage costs: the truth in its place" if AS_IT_IS in against else named
    asked = f"{len(comparisons)} comparison{'s' if len(comparisons) > 1 else ''}"
    lines = tuple(
        Line((c.cell, c.against, points(c.success), points(c.completion), Figure(c.p, form=".2g"), c.verdict))
        for c in comparisons
    )
    columns = (
        Column("cell"),
        Column("against", _WIDE if len(against) == 1 else 0, kind="words"),
        Column("5 deg 2 cm", name="within 5 deg and 2 cm, points"),
        Column("scenes done", _WIDE, name="scenes done, points"),
        Column("p"),
        Column("in words", kind="words"),
    )
    return FigureTable(f"{title}; points [95 % interval], p by McNemar, Holm over {asked}", columns, lines)


def shown_in_words(comparisons: Sequence[Comparison]) -> str:
    """Whether the comparisons of a run show a difference, in a sentence; empty where nothing is compared."""
    if not comparisons:
        return ""
    if len(comparisons) == 1:
        (only,) = comparisons
        return f"{only.cell} against {only.against}: {only.verdict}."
    shown = sum(comparison.shown for comparison in comparisons)
    return f"Of {len(comparisons)} comparisons, {shown or 'none'} show{'s' * (shown < 2)} a difference."


def print_tables(figures: FigureTable, comparisons: Sequence[Comparison], console: Console) -> None:
    """Print a run's figures, and its comparisons where there are any."""
    figures.print(console)
    if comparisons:
        comparison_table(comparisons).print(console)


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


def points(difference: PairedDifference) -> Figure:
    """A difference of shares in points, signed."""
    low, high = difference.interval
    return Figure(100 * difference.mean, (100 * low, 100 * high), "+.1f")


Outcomes = dict[tuple[int, int], bool]
"""Success by (scene, object)."""


def _shared(a: Outcomes, b: Outcomes) -> tuple[list[bool], list[bool], list[int]]:
    """Both cells' outcomes on the objects they share, and the objects' scenes."""
    keys = sorted(a.keys() & b.keys())
    return [a[key] for key in keys], [b[key] for key in keys], [scene for scene, _ in keys]


def _over_objects(a: Sequence[bool], b: Sequence[bool], scenes: Sequence[int]) -> PairedDifference:
    """The difference over objects. Few scenes that all say the same leave resampling nothing to vary."""
    found = paired_difference(a, b, scenes)
    (low, high), (least, most) = found.interval, newcombe_interval(a, b)
    return replace(found, interval=(min(low, least), max(high, most)))


def _over_scenes(a: Sequence[bool], b: Sequence[bool], scenes: Sequence[int]) -> PairedDifference:
    """The difference in scenes of which every object is right."""
    names = sorted(set(scenes))
    own, other = (
        [all(x for x, scene in zip(cell, scenes, strict=True) if scene == name) for name in names] for cell in (a, b)
    )
    return replace(paired_difference(own, other, names), interval=newcombe_interval(own, other))


def _rounded(scenes: float) -> int:
    """Two figures: more would claim more than is known."""
    size = 10 ** max(0, len(str(int(scenes))) - 2)
    return int(np.ceil(scenes / size) * size)
