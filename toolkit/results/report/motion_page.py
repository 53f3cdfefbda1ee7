"""report.html of an ablation: words first, then the table, the curves, what may be said, and the worst cases."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from toolkit.results.comparisons import remainder
from toolkit.results.figure_table import Column, Figure, FigureTable, Line
from toolkit.results.report.page import rows_to_report, write_page
from toolkit.results.report.plots import cell_colors, confidence_curves, error_curves, time_by_stage
from toolkit.results.rows import CellSummary, Row, summarize
from toolkit.results.tables import motion_table, plain_motion_table


def write_report(run: Path) -> Path:
    """Write run/report.html from the run's rows, settings and pictures; nothing in it is fetched from elsewhere.

    Raises:
        ToolkitError: the run has no rows.
    """
    rows = rows_to_report(run, Row)
    summaries = summarize(rows)
    best = max(summaries, key=lambda summary: summary.success_sym.value)
    colors = cell_colors([summary.cell for summary in summaries])
    confidences = confidence_curves(rows, colors)
    return write_page(
        run,
        "motion_page.html.j2",
        rows,
        best.cell,
        {
            "results": motion_table(summaries),
            "plain": plain_motion_table(summaries),
            "ambiguity": _ambiguity_table(rows),
        },
        [error_curves(rows, colors), time_by_stage(summaries), *([confidences] if confidences else [])],
        headline=_headline(summaries, best),
        one_sided=any(summary.absent for summary in summaries),
        attribution=remainder(summaries),
    )


def _headline(summaries: Sequence[CellSummary], best: CellSummary) -> str:
    share, (low, high) = best.success_sym.value, best.success_sym.interval
    said = (
        f"{best.cell} puts {share:.0%} of {best.objects} objects within 5° and 2 cm "
        f"(95 % interval {low:.0%} to {high:.0%})"
    )
    if len(summaries) == 1:
        return said + "."
    worst = min(summaries, key=lambda summary: summary.success_sym.value)
    return f"{said}; {worst.cell}, the least, {worst.success_sym.value:.0%}."


def _ambiguity_table(rows: Sequence[Row]) -> FigureTable:
    """Of the objects of each kind of ambiguity, how many are right, and of how many an equivalent motion is."""
    groups: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        if row.ambiguity is not None:
            groups.setdefault((row.cell, row.ambiguity), []).append(row)
    lines: list[Line] = []
    for key, own in groups.items():
        counts = (len(own), sum(row.success_sym for row in own), sum(row.success_equivalent for row in own))
        lines.append(Line((*key, *(Figure(count, form="d") for count in counts))))
    columns = ("objects", "right", "one of the set right")
    named = (Column("cell"), Column("ambiguity", kind="words"), *map(Column, columns))
    return FigureTable("What the goal image does not tell", named, tuple(lines))
