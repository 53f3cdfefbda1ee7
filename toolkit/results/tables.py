"""The tables that runs print: how well motions were estimated, and how often scenes were set right."""

from __future__ import annotations

from collections.abc import Sequence

from toolkit.results.completion import CompletionSummary
from toolkit.results.figure_table import Column, Figure, FigureTable, Line
from toolkit.results.paper_figures import paper_completion, paper_medians
from toolkit.results.rows import CellSummary, Estimate

_WIDE, _WIDEST = 110, 140


def motion_table(summaries: Sequence[CellSummary]) -> FigureTable:
    """How well motions were estimated, with the paper's figures under the cells of its Table I.

    False alarms are shown where some objects are in the goal only.
    """
    lines: list[Line] = []
    one_sided = any(s.absent for s in summaries)
    for s in summaries:
        cells = (
            s.cell,
            number(s.rotation_median_deg_sym),
            Figure(s.rotation_p90_deg_sym),
            number(s.translation_median_cm_sym),
            Figure(s.translation_p90_cm_sym),
            share(s.success_sym),
            share(s.completion_sym),
            *([share(s.false_alarms) if s.false_alarms else ""] if one_sided else []),
            Figure(s.objects, form="d"),
            Figure(s.matcher_calls, form=".1f"),
            Figure(s.total_ms, form=".0f"),
        )
        lines.append(Line(cells))
        if paper := paper_medians(s.settings):
            rotation, translation = map(Figure, paper)
            lines.append(Line(("paper, Table I", rotation, "", translation), is_paper=True))
    columns = (
        Column("cell"),
        Column("rotation, deg"),
        Column("p90", _WIDEST, name="rotation p90, deg"),
        Column("translation, cm"),
        Column("p90", _WIDEST, name="translation p90, cm"),
        Column("5 deg 2 cm", name="within 5 deg and 2 cm, %"),
        Column("scenes done", _WIDE, name="scenes done, %"),
        *([Column("false alarms", _WIDE, name="false alarms, %")] if one_sided else []),
        Column("objects", _WIDE),
        Column("matcher calls", _WIDE),
        Column("ms / object", _WIDE),
    )
    return FigureTable("Motion of every object, symmetry-aware; median [95 % interval]", columns, tuple(lines))


def plain_motion_table(summaries: Sequence[CellSummary]) -> FigureTable:
    """How well motions were estimated where an object's symmetry is no excuse."""
    lines = tuple(
        Line(
            (
                s.cell,
                number(s.rotation_median_deg),
                number(s.translation_median_cm),
                share(s.success),
                share(s.completion),
            )
        )
        for s in summaries
    )
    columns = (
        *map(Column, ("cell", "rotation, deg", "translation, cm")),
        Column("5 deg 2 cm", name="within 5 deg and 2 cm, %"),
        Column("scenes done", name="scenes done, %"),
    )
    return FigureTable("Motion of every object, symmetry not counted; median [95 % interval]", columns, lines)


def completion_table(summaries: Sequence[CompletionSummary]) -> FigureTable:
    """How often scenes were set right, with the paper's figures under the cells of its Table II; moves per object."""
    lines: list[Line] = []
    for s in summaries:
        cells = (
            s.cell,
            share(s.completion_sym),
            share(s.completion_sym_one_step),
            share(s.success_sym),
            number(s.moves_per_object),
            Figure(s.buffer_moves_per_scene, form=".2f"),
            Figure(s.rounds, form=".1f"),
            Figure(s.perception_s, form=".1f"),
            Figure(s.planning_ms, form=".0f"),
            Figure(s.motion_s, form=".0f"),
        )
        lines.append(Line(cells))
        if (paper := paper_completion(s.settings)) is not None:
            lines.append(Line(("paper, Table II", Figure(100 * paper, form=".1f", unit="%")), is_paper=True))
    columns = (
        Column("cell"),
        Column("scenes done", name="scenes done, %"),
        Column("in one step", name="scenes done in one step, %"),
        Column("objects right", name="objects right, %"),
        Column("moves", name="moves per object"),
        *(Column(heading, _WIDE) for heading in ("aside", "rounds", "see, s", "plan, ms", "move, s")),
    )
    title = "Scenes with every object within 2 cm and 5 deg, symmetry-aware; [95 % interval]"
    return FigureTable(title, columns, tuple(lines))


def moves_table(summaries: Sequence[CompletionSummary]) -> FigureTable:
    """What it took to set the scenes right, and how that is where no object has to stand aside."""
    lines = tuple(
        Line(
            (
                s.cell,
                Figure(s.scenes, form="d"),
                Figure(s.objects, form="d"),
                share(s.completion),
                number(s.moves_per_object_unforced) if s.moves_per_object_unforced else "",
                Figure(s.forced_buffers_per_scene, form=".2f"),
                Figure(s.touching_moves, form="d"),
            )
        )
        for s in summaries
    )
    columns = (
        *map(Column, ("cell", "scenes", "objects")),
        Column("scenes done, symmetry not counted", name="scenes done, symmetry not counted, %"),
        Column("moves, where none has to stand aside"),
        Column("aside at least, per scene"),
        Column("moves with a contact"),
    )
    return FigureTable("Symmetry not counted, moves per object, and contacts that were not meant", columns, lines)


def number(estimate: Estimate) -> Figure:
    """A figure in its own unit."""
    return Figure(estimate.value, estimate.interval)


def share(estimate: Estimate) -> Figure:
    """A share in percent."""
    low, high = estimate.interval
    return Figure(100 * estimate.value, (100 * low, 100 * high), ".0f", "%")
