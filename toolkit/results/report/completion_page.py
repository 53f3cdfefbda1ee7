"""report.html of a rearrangement: completion, moves, and what kept objects from their goals."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from toolkit.results.completion import CompletionSummary, MoveRow, summarize_completion
from toolkit.results.paper_figures import paper_completion
from toolkit.results.report.page import failures, rows_to_report, write_page
from toolkit.results.tables import Column, FigureTable, Line, completion_table


def write_completion_report(run: Path) -> Path:
    """Write run/report.html from the run's rows and settings; nothing in it is fetched from elsewhere.

    Its table stands beside it as summary.md, and so do the reasons of failures.

    Raises:
        ToolkitError: the run has no rows.
    """
    rows = rows_to_report(run, MoveRow)
    summaries = summarize_completion(rows)
    best = max(summaries, key=lambda summary: summary.completion_sym.value)
    return write_page(
        run,
        "completion_page.html.j2",
        completion_table(summaries).markdown() + "\n" + _failure_table(rows).markdown(),
        rows,
        best.cell,
        headline=_headline(best),
        summaries=summaries,
        paper={summary.cell: paper_completion(summary.settings) for summary in summaries},
    )


def _failure_table(rows: Sequence[MoveRow]) -> FigureTable:
    columns = tuple(map(Column, ("cell", "stage", "reason", "objects")))
    lines = tuple(Line(tuple(map(str, failure))) for failure in failures(rows))
    return FigureTable("What kept objects from their goals", columns, lines)


def _headline(best: CompletionSummary) -> str:
    low, high = best.completion_sym.interval
    return (
        f"{best.cell} sets {best.completion_sym.value:.0%} of {best.scenes} scenes right "
        f"(95 % interval {low:.0%} to {high:.0%}) with {best.moves_per_object.value:.2f} moves per object."
    )
