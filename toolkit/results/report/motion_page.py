"""Writes report.html: words first, then the table, the curves, the failures and the worst cases."""

from __future__ import annotations

import base64
import json
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import jinja2
import numpy as np
import yaml

from toolkit.errors import ToolkitError
from toolkit.files import write_text
from toolkit.results.comparisons import compare_cells, points, remainder
from toolkit.results.paper_figures import paper_medians
from toolkit.results.report.plots import cell_colors, confidence_curves, error_curves, success_by, time_by_stage
from toolkit.results.rows import CellSummary, Estimate, Row, read_rows, summarize
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
    rows = read_rows(run / "rows.jsonl")
    if not rows:
        raise ToolkitError(f"'{run}' has no rows to report")
    summaries = summarize(rows)
    colors = cell_colors([summary.cell for summary in summaries])
    best = max(summaries, key=lambda summary: summary.success_sym.value)
    sizes = Counter((row.cell, row.scene_id) for row in rows)
    page = _template().render(
        title=_name(run),
        headline=_headline(summaries, best),
        best=best,
        summaries=summaries,
        colors=colors,
        paper={summary.cell: paper_medians(summary.settings) for summary in summaries},
        curves=error_curves(rows, colors),
        by_count=success_by(rows, colors, lambda row: sizes[row.cell, row.scene_id], "objects in the scene"),
        by_symmetry=success_by(rows, colors, lambda row: row.symmetry, "symmetry of the object"),
        confidences=confidence_curves(rows, colors),
        ambiguous=_ambiguous(rows),
        times=time_by_stage(summaries),
        comparisons=compare_cells(rows),
        attribution=remainder(summaries),
        hardest=_hardest(rows, best.cell),
        failures=_failures(rows),
        cases=_cases(run),
        settings=_read(run / "experiment.resolved.yaml"),
        meta=json.loads(_read(run / "meta.json") or "{}"),
        show=_show,
        points=points,
        number=_number,
        share=_show_share,
    )
    path = run / "report.html"
    write_text(path, page)
    write_text(run / "summary.md", motion_table(summaries).markdown())
    return path


def _template() -> jinja2.Template:
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("toolkit.results.report", "."), autoescape=True, undefined=jinja2.StrictUndefined
    )
    return environment.get_template("report.html.j2")


def _name(run: Path) -> str:
    settings: Any = yaml.safe_load(_read(run / "experiment.resolved.yaml") or "{}")
    return str(settings.get("experiment", run.name))


def _read(path: Path) -> str:
    return path.read_text() if path.exists() else ""


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


def _hardest(rows: Sequence[Row], cell: str, count: int = 10) -> list[tuple[str, int, int, str]]:
    """The objects the cell gets wrong most often: name, right, seen, median rotation error."""
    by_name: dict[str, list[Row]] = {}
    for row in rows:
        if row.cell == cell:
            by_name.setdefault(row.object_name, []).append(row)
    ranked = sorted(by_name.items(), key=lambda item: (np.mean([r.success_sym for r in item[1]]), item[0]))
    return [
        (name, sum(r.success_sym for r in own), len(own), _median_rotation(own))
        for name, own in ranked[:count]
        if not all(r.success_sym for r in own)
    ]


def _median_rotation(rows: Sequence[Row]) -> str:
    values = [row.rotation_error_deg_sym for row in rows if row.rotation_error_deg_sym is not None]
    return f"{np.median(values):.1f}°" if values else "no pose"


def _failures(rows: Sequence[Row]) -> list[tuple[str, str, str, int]]:
    """Cell, stage, reason (numbers left out, so that like ones are counted together) and count; most frequent first."""
    counts: Counter[tuple[str, str, str]] = Counter()
    for row in rows:
        if row.success_sym:
            continue
        general = re.sub(r"\d+", "N", row.reason) if row.reason else "the pose is off by more than 5° or 2 cm"
        counts[row.cell, row.stage or "pose", general] += 1
    return [(*key, count) for key, count in counts.most_common(16)]


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
        caption = path.with_suffix(".txt")
        if image is not None:
            data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])[1]
            cases.append(_Case(base64.b64encode(data.tobytes()).decode(), _read(caption)))
    return cases


def _show(estimate: Estimate, digits: int = 2) -> str:
    low, high = estimate.interval
    return f"{_number(estimate.value, digits)} <small>{_number(low, digits)} – {_number(high, digits)}</small>"


def _number(value: float, digits: int) -> str:
    return f"{value:.{digits}f}" if np.isfinite(value) else "∞"


def _show_share(estimate: Estimate) -> str:
    low, high = estimate.interval
    return f"{estimate.value:.1%} <small>{low:.0%} – {high:.0%}</small>"
