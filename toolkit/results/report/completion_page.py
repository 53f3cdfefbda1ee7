"""report.html of a rearrangement: completion, moves, and what kept objects from their goals."""

from __future__ import annotations

from pathlib import Path

from toolkit.results.completion import CompletionSummary, MoveRow, most_complete, summarize_completion
from toolkit.results.report.page import rows_to_report, write_page
from toolkit.results.tables import completion_table, moves_table


def write_completion_report(run: Path) -> Path:
    """Write run/report.html from the run's rows and settings; nothing in it is fetched from elsewhere.

    Raises:
        ToolkitError: the run has no rows.
    """
    rows = rows_to_report(run, MoveRow)
    summaries = summarize_completion(rows)
    best = most_complete(summaries)
    tables = {"results": completion_table(summaries), "moves": moves_table(summaries)}
    return write_page(run, "completion_page.html.j2", rows, best.cell, tables, headline=_headline(best))


def _headline(best: CompletionSummary) -> str:
    low, high = best.completion_sym.interval
    return (
        f"{best.cell} sets {best.completion_sym.value:.0%} of {best.scenes} scenes right "
        f"(95 % interval {low:.0%} to {high:.0%}) with {best.moves_per_object.value:.2f} moves per object."
    )
