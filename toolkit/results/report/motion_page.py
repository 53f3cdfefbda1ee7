"""report.html of an ablation: words first, then the table, the curves, what may be said, and the worst cases."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2

from toolkit.results.comparisons import compare_cells, points, remainder
from toolkit.results.paper_figures import paper_medians
from toolkit.results.report.page import read_if_there, rows_to_report, write_page
from toolkit.results.report.plots import cell_colors, confidence_curves, error_curves, time_by_stage
from toolkit.results.rows import CellSummary, Row, summarize
from toolkit.results.tables import motion_table

_JPEG_QUALITY = 82


@dataclass(frozen=True)
class _Case:
    picture: str
    caption: str


def write_report(run: Path) -> Path:
    """Write run/report.html from the run's rows, settings and pictures; nothing in it is fetched from elsewhere.

    Its table stands beside it as summary.md.

    Raises:
        ToolkitError: the run has no rows.
    """
    rows = rows_to_report(run, Row)
    summaries = summarize(rows)
    best = max(summaries, key=lambda summary: summary.success_sym.value)
    colors = cell_colors([summary.cell for summary in summaries])
    return write_page(
        run,
        "motion_page.html.j2",
        motion_table(summaries).markdown(),
        rows,
        best.cell,
        headline=_headline(summaries, best),
        best=best,
        summaries=summaries,
        paper={summary.cell: paper_medians(summary.settings) for summary in summaries},
        curves=error_curves(rows, colors),
        confidences=confidence_curves(rows, colors),
        ambiguous=_ambiguous(rows),
        times=time_by_stage(summaries),
        one_sided=any(summary.absent for summary in summaries),
        comparisons=compare_cells(rows),
        attribution=remainder(summaries),
        cases=_cases(run),
        points=points,
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


def _ambiguous(rows: Sequence[Row]) -> list[tuple[str, str, int, int, int]]:
    """Cell, kind of ambiguity, objects, right ones, and those of which one of the equivalent motions is right."""
    groups: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        if row.ambiguity is not None:
            groups.setdefault((row.cell, row.ambiguity), []).append(row)
    return [
        (cell, kind, len(own), sum(r.success_sym for r in own), sum(r.success_equivalent for r in own))
        for (cell, kind), own in groups.items()
    ]


def _cases(run: Path) -> list[_Case]:
    cases: list[_Case] = []
    for path in sorted((run / "pictures").glob("*.png")):
        image = cv2.imread(str(path))
        if image is not None:
            data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])[1]
            cases.append(_Case(base64.b64encode(data.tobytes()).decode(), read_if_there(path.with_suffix(".txt"))))
    return cases
