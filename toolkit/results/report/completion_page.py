"""Writes report.html of a rearrangement: completion, moves, and what kept objects from their goals."""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jinja2
import yaml

from toolkit.errors import ToolkitError
from toolkit.files import write_text
from toolkit.results.completion import CompletionSummary, MoveRow, summarize_completion
from toolkit.results.paper_figures import paper_completion
from toolkit.results.report.plots import cell_colors, success_by
from toolkit.results.rows import Estimate, read_rows_as
from toolkit.results.tables import Column, FigureTable, Line, completion_table


def write_completion_report(run: Path) -> Path:
    """Write run/report.html from the run's rows and settings; nothing in it is fetched from elsewhere.

    Its table stands beside it as summary.md, and so do the reasons of failures.

    Raises:
        ToolkitError: the run has no rows.
    """
    rows = read_rows_as(MoveRow, run / "rows.jsonl")
    if not rows:
        raise ToolkitError(f"'{run}' has no rows to report")
    summaries = summarize_completion(rows)
    colors = cell_colors([summary.cell for summary in summaries])
    sizes = Counter((row.cell, row.scene_id) for row in rows)
    settings: Any = yaml.safe_load(_read(run / "experiment.resolved.yaml") or "{}")
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("toolkit.results.report", "."), autoescape=True, undefined=jinja2.StrictUndefined
    )
    page = environment.get_template("completion.html.j2").render(
        title=settings.get("experiment", run.name),
        headline=_headline(summaries),
        summaries=summaries,
        colors=colors,
        paper={summary.cell: paper_completion(summary.settings) for summary in summaries},
        by_count=success_by(rows, colors, lambda row: sizes[row.cell, row.scene_id], "objects in the scene"),
        by_symmetry=success_by(rows, colors, lambda row: row.symmetry, "symmetry of the object"),
        failures=failure_table(rows),
        settings=_read(run / "experiment.resolved.yaml"),
        meta=json.loads(_read(run / "meta.json") or "{}"),
        share=_share,
        mean=_mean,
    )
    path = run / "report.html"
    write_text(path, page)
    write_text(run / "summary.md", completion_table(summaries).markdown() + "\n" + _failures_markdown(rows))
    return path


def _failures_markdown(rows: Sequence[MoveRow]) -> str:
    """The reasons of failures, below the table of the cells."""
    columns = tuple(map(Column, ("cell", "stage", "reason", "objects")))
    lines = tuple(Line(tuple(map(str, failure))) for failure in failure_table(rows))
    return FigureTable("What kept objects from their goals", columns, lines).markdown()


def failure_table(rows: Sequence[MoveRow]) -> list[tuple[str, str, str, int]]:
    """Cell, stage, reason (numbers left out, so that like ones are counted together) and count; most frequent first."""
    failed = [row for row in rows if not row.success_sym]
    counts = Counter((row.cell, row.stage or "", re.sub(r"\d+(\.\d+)?", "N", row.reason or "")) for row in failed)
    return [(*key, count) for key, count in counts.most_common(24)]


def _headline(summaries: Sequence[CompletionSummary]) -> str:
    best = max(summaries, key=lambda summary: summary.completion_sym.value)
    low, high = best.completion_sym.interval
    return (
        f"{best.cell} sets {best.completion_sym.value:.0%} of {best.scenes} scenes right "
        f"(95 % interval {low:.0%} to {high:.0%}) with {best.moves_per_object.value:.2f} moves an object."
    )


def _read(path: Path) -> str:
    return path.read_text() if path.exists() else ""


def _share(estimate: Estimate) -> str:
    low, high = estimate.interval
    return f"{estimate.value:.1%} <small>{low:.0%} – {high:.0%}</small>"


def _mean(estimate: Estimate | None) -> str:
    if estimate is None:
        return "–"
    low, high = estimate.interval
    return f"{estimate.value:.2f} <small>{low:.2f} – {high:.2f}</small>"
